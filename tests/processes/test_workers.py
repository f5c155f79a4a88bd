"""One worker process: what it answers, and when it ends."""

import os
import subprocess
import sys
import time

import pytest

from mechsearch.processes import (
    Failure,
    Worker,
    replies,
)
from mechsearch.types import MechSearchError


def sleeper():
    return time.sleep


def talk(worker, count):
    """Return so many replies, by their keys."""
    told = {}
    while len(told) < count:
        told.update({reply.key: reply.value for reply in replies([worker])})
    return told


def test_requests_are_answered_in_turn_and_a_request_has_its_own_limit():
    worker = Worker(sleeper)
    pid = worker.pid
    worker.ask(1, 0.01)
    worker.ask(2, 600, limit=0.5)
    worker.ask(3, 0.01)
    began = time.monotonic()
    assert talk(worker, 2) == {1: None, 2: Failure("worker hung")}
    assert time.monotonic() - began < 60
    assert not worker.alive
    assert [asked.key for asked in worker.asked] == [3]
    assert not os.path.exists(f"/proc/{pid}")
    after = worker.replace()
    after.ask(3, 0.01)
    assert talk(after, 1) == {3: None}
    after.stop()


def test_a_worker_that_raises_lives_on_and_says_what_it_raised():
    worker = Worker(sleeper)
    worker.ask(1, "an hour")
    worker.ask(2, 0)
    told = talk(worker, 2)
    assert told[1].reason.startswith("worker raised: TypeError")
    assert isinstance(told[1].error, TypeError)
    assert told[2] is None
    worker.stop()


def test_an_exception_that_does_not_pickle_is_told_by_its_text():
    worker = Worker(unpicklable)
    worker.ask(1, None)
    told = talk(worker, 1)
    assert told[1].reason == "worker raised: OddError: 1 2"
    assert isinstance(told[1].error, RuntimeError)
    worker.stop()


class OddError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def unpicklable():
    def answer(request):
        raise OddError(1, 2)

    return answer


def broken():
    raise MechSearchError("no such thing")


def test_a_worker_that_never_starts_blames_no_request_and_is_replaced_a_few_times_only():
    worker = Worker(broken)
    worker.ask(1, None)
    for _ in range(2):
        told = [reply for reply in replies([worker])]
        assert [reply.key for reply in told] == [None]
        worker = worker.replace()
        worker.ask(1, None)
    list(replies([worker]))
    with pytest.raises(MechSearchError, match="do not start, tried 3 times, exit code 1"):
        worker.replace()


SCRIPT = """
import os, signal, time
from mechsearch.processes import Worker, replies

def sleeper():
    return time.sleep

if __name__ == "__main__":
    busy, idle = Worker(sleeper), Worker(sleeper)
    for worker in busy, idle:
        worker.ask(0, 0)
        while not list(replies([worker])):
            pass
    busy.ask(1, 600)
    print(busy.pid, idle.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc to see processes")
def test_workers_end_with_the_process_that_asks_even_if_that_is_killed(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    pids = done.stdout.split()
    assert len(pids) == 2, done.stderr
    deadline = time.monotonic() + 20
    while any(running(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(running(pid) for pid in pids)


def running(pid):
    """Whether a process is there and no zombie that its adopter has yet to reap."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
