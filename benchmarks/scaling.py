"""`objects-N-...`, `side-N-...`: time and memory as heaps and images grow.

Every size is measured in a process of its own, where no memory of another is used again.
"""

import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import machine
from benchmarks.action import PEER, time_ours, time_peer
from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Workload
from mechsearch.heaps.dataset import Heap
from mechsearch.heaps.generate import GenerateConfig, generate

_LARGE = (20, 30, 40)
_SIDES = (32, 64, 128, 256)


def measure(settings: Settings) -> Iterator[Figure]:
    """Time heaps of 5 to 40 objects, and images of 32 to 256 pixels."""
    with tempfile.TemporaryDirectory() as folder:
        number = 4 if settings.full else 1
        small = [heap for count in (5, 10, 15) for heap in settings.workload.heaps(count, 4)]
        large = _large_heaps(settings, number, Path(folder) / "large.parquet")
        by_count: dict[int, list[Heap]] = {}
        for heap in [*small, *large]:
            by_count.setdefault(heap.count, []).append(heap)
        for count, heaps in by_count.items():
            yield from _sized(settings, f"objects-{count}", heaps, 64, Path(folder))
        for side in _SIDES:
            yield from _sized(settings, f"side-{side}", by_count[15], side, Path(folder))


def _large_heaps(settings: Settings, number: int, path: Path) -> Sequence[Heap]:
    workload = settings.workload
    counts = tuple(count for count in _LARGE if count <= len(workload.object_set.models))
    config = GenerateConfig(
        heaps=number * len(counts), objects=workload.objects, counts=counts, seed=40
    )
    heaps = generate(config, path, machine.cores()).heaps
    settings.say(f"scaling: {len(heaps)} heaps of {counts} objects")
    return heaps


def _sized(
    settings: Settings, name: str, heaps: Sequence[Heap], side: int, folder: Path
) -> Iterator[Figure]:
    workload = settings.workload.written(heaps, folder / f"{name}.parquet")
    context = multiprocessing.get_context("spawn")
    answers = context.SimpleQueue()
    process = context.Process(target=_work, args=(workload, side, answers))
    process.start()
    process.join()
    if process.exitcode != 0:
        raise SystemExit(f"the measurement of {name} ended with {process.exitcode}")
    ours, theirs, memory = answers.get()
    settings.say(f"{name}: {ours:.1f} ms, the peer {theirs:.1f} ms, {memory:.0f} MB")
    yield Figure(f"{name}-time", ours, "ms", PEER, theirs)
    yield Figure(f"{name}-memory", memory, "MB", note="an environment, without its object set")


def _work(workload: Workload, side: int, answers: Any) -> None:
    """Answer with the time of an action, ours and the peer's [ms], and our memory [MB]."""
    heaps = list(workload.heap_set.heaps)
    memory = _env_memory(workload, heaps[0], side)
    episodes = workload.episodes(heaps)
    ours = [1e3 * time_ours(workload, episode, side).mean() for episode in episodes]
    theirs = [1e3 * time_peer(workload, episode, side, rigid=False).mean() for episode in episodes]
    answers.put((float(np.median(ours)), float(np.median(theirs)), memory))


def _env_memory(workload: Workload, heap: Heap, side: int) -> float:
    """Return the memory [MB] of an environment in the middle of an episode."""
    before = machine.memory()
    env = workload.env([heap], side)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros(3))
    return machine.memory() - before
