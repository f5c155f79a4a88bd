"""`workers-1`, `workers-2`, ...: actions a second of several processes, beside one."""

import multiprocessing
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.synchronize import Barrier
from typing import Any

import numpy as np

from benchmarks import machine
from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Workload
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.rollout import run_episode
from mechsearch.teachers import make_teacher

PEER = "1 worker"


def measure(settings: Settings) -> Iterator[Figure]:
    """Let one worker and several push by turns; episodes on 15-object heaps, images included."""
    seconds, rounds = (30.0, 5) if settings.full else (12.0, 3)
    numbers = [n for n in (1, 2, 4, 8, 16, 32) if n <= max(machine.cores(), 2)]
    rates: dict[int, list[float]] = {number: [] for number in numbers}
    for turn in range(rounds):
        for number in numbers:
            rates[number].append(throughput(settings.workload, number, seconds))
            settings.say(f"workers-{number}: round {turn + 1}, {rates[number][-1]:.1f} actions/s")
    one = float(np.median(rates[1]))
    yield Figure("workers-1", one, "actions/s", better="more")
    for number in numbers[1:]:
        gain = float(np.median(np.array(rates[number]) / np.array(rates[1])))
        yield Figure(f"workers-{number}", gain * one, "actions/s", PEER, one, "more")


def throughput(workload: Workload, workers: int, seconds: float) -> float:
    """Return the actions a second of some processes, each with an environment of its own."""
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(workers), context.SimpleQueue()
    processes = [
        context.Process(target=_work, args=(replace(workload), seed, seconds, barrier, answers))
        for seed in range(workers)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(timeout=300 + seconds)
        if process.exitcode != 0:
            for other in processes:
                other.kill()
            raise SystemExit(f"a worker process ended with {process.exitcode}")
    return float(sum(answers.get() for _ in processes))


def _work(workload: Workload, seed: int, seconds: float, barrier: Barrier, answers: Any) -> None:
    """Push until the time is over, and answer with actions a second."""
    heaps = workload.heaps(15, 24)
    config = HeapEnvConfig(privileged=True, camera=workload.heap_set.camera)
    env = HeapEnv(heaps, workload.object_set, config)
    teacher = make_teacher("zigzag")
    run_episode(teacher, env, 0, seed)
    barrier.wait(timeout=300)
    began, actions, heap = time.perf_counter(), 0, 0
    while time.perf_counter() - began < seconds:
        # All begin with the same heap, so that all have the same work.
        actions += len(run_episode(teacher, env, heap % len(heaps), seed).actions)
        heap += 1
    answers.put(actions / (time.perf_counter() - began))
