"""Memory that is freed stays, and is used again without a fault of a page."""

import subprocess
import sys

import pytest

FAULTS = """
import ctypes, resource, sys
import numpy as np
from mechsearch.actor_critic.freed_memory import keep_freed_memory

kept = keep_freed_memory() if sys.argv[1] == "keep" else None
def allocate():
    for _ in range(3):
        arrays = [np.ones(2**20, np.uint8) for _ in range(50)]
        del arrays
allocate()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
allocate()
print(kept, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how):
    answer = subprocess.run(
        [sys.executable, "-c", FAULTS, how], capture_output=True, text=True, check=True
    )
    kept, count = answer.stdout.split()
    return kept, int(count)


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc can be told")
def test_arrays_are_made_anew_without_page_faults():
    kept, few = faults("keep")
    if kept == "False":
        pytest.skip("this C library is not glibc")
    _, many = faults("default")
    assert few < 100 < 1000 < many


def test_elsewhere_nothing_changes(monkeypatch):
    from mechsearch.actor_critic import freed_memory

    monkeypatch.setattr(freed_memory.sys, "platform", "other")
    assert freed_memory.keep_freed_memory() is False
    monkeypatch.setattr(freed_memory.sys, "platform", "linux")
    monkeypatch.setattr(freed_memory.ctypes, "CDLL", lambda name: object())
    assert freed_memory.keep_freed_memory() is False
