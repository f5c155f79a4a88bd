"""`worker-start`, `worker-memory`: what a worker costs before it decides with networks."""

import multiprocessing
import time
from collections.abc import Iterator
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.evaluation.policies import make_policy
from mechsearch.processes import process_context

PEER = "a new interpreter"
WORKERS = 4


def measure(settings: Settings) -> Iterator[Figure]:
    """Start four workers at once, ours and new interpreters by turns, until each holds a policy."""
    make_policy("uncover")  # What a command has imported by its first worker.
    contexts = {"": process_context(), PEER: multiprocessing.get_context("spawn")}
    found: dict[str, list[tuple[float, float]]] = {who: [] for who in contexts}
    for turn in range(5):
        for who, context in contexts.items():
            found[who].append(started(context))
            seconds, memory = found[who][-1]
            settings.say(
                f"starts: round {turn + 1}, {who or 'ours'} {seconds:.2f} s, {memory:.0f} MB"
            )
    ours, theirs = (np.median(found[who], axis=0) for who in contexts)
    note = f"{WORKERS} at once"
    yield Figure("worker-start", ours[0], "s", PEER, theirs[0], note=note)
    yield Figure("worker-memory", ours[1], "MB", PEER, theirs[1], note=note)


def started(context: Any) -> tuple[float, float]:
    """Return the time until workers hold their policies [s], and the memory of each [MB].

    What several processes share is counted in parts, to each its own.
    """
    barrier, answers = context.Barrier(WORKERS + 1), context.SimpleQueue()
    began = time.perf_counter()
    processes = [context.Process(target=_hold, args=(barrier, answers)) for _ in range(WORKERS)]
    for process in processes:
        process.start()
    barrier.wait(timeout=300)
    seconds = time.perf_counter() - began
    barrier.wait(timeout=300)
    for process in processes:
        process.join()
    return seconds, float(np.mean([answers.get() for _ in processes]))


def _hold(barrier: Barrier, answers: Any) -> None:
    """Open a policy, and answer with this process's part of the memory [MB] while all have."""
    policy = make_policy("uncover")
    barrier.wait(timeout=300)
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    (part,) = (int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    barrier.wait(timeout=300)
    answers.put(part / 1024)
    del policy
