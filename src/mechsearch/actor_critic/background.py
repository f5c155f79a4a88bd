"""One thread beside the main one, in which the world turns while the networks learn."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

_TURN = 0.0005
"""Longest turn of one thread while another waits [s]. With Python's 5 ms, each of a gradient step's
many short calls would wait for the world's next long one."""


@contextmanager
def background() -> Iterator[ThreadPoolExecutor]:
    """Offer a thread; what it still does when the main thread leaves is finished first."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(_TURN)
    try:
        with ThreadPoolExecutor(1, thread_name_prefix="collector") as thread:
            yield thread
    finally:
        sys.setswitchinterval(usual)
