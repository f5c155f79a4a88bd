"""A great many actions, most of them rough: does anything crash, leak, or pass unexplained?"""

import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.workload import Workload
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.heaps.dataset import Heap
from mechsearch.types import Array

ENDS = ("uncovered", "action limit", "lost")
_LOOK = 1000
"""Actions between two looks at memory and files."""


def soak(workload: Workload, actions: int, heaps: int) -> dict[str, Any]:
    """Push through heaps with random and with aimed commands, images included.

    Args:
        workload: Heaps and objects.
        actions: In all.
        heaps: Spread evenly over the set; each has its share of the actions, in several episodes.

    Returns:
        Counts of ends by name, of what no rule explains, and how memory and open files grew.
    """
    everything = workload.heap_set.heaps
    heaps = min(heaps, len(everything))
    rng = np.random.default_rng(0)
    # In random order, as memory would else grow with the number of objects in a heap.
    chosen = [everything[i * len(everything) // heaps] for i in rng.permutation(heaps)]
    ends: Counter[str] = Counter()
    strange: Counter[str] = Counter()
    looks = []
    began, done = time.perf_counter(), 0
    for number, heap in enumerate(chosen):
        share = actions * (number + 1) // heaps - actions * number // heaps
        for _ in _rough(workload, heap, share, rng, ends, strange):
            done += 1
            if done % _LOOK == 0:
                looks.append((done, _memory(), _files()))
        if number % 50 == 49:
            print(f"{done:,} actions on {number + 1} heaps, {dict(ends)}", flush=True)
    steps, memory, files = np.array(looks[len(looks) // 2 :], np.float64).T
    slope = np.polyfit(steps, memory, 1)[0] if len(steps) > 2 else 0.0
    return {
        "actions": done,
        "heaps": heaps,
        "minutes": (time.perf_counter() - began) / 60,
        "ends": dict(ends),
        "unexplained": dict(strange),
        "memory_mb": float(memory[-1]),
        "memory_kb_per_1000_actions": float(1000 * 1024 * slope),
        "open_files": [int(files.min()), int(files.max())],
    }


def _rough(
    workload: Workload,
    heap: Heap,
    actions: int,
    rng: np.random.Generator,
    ends: Counter[str],
    strange: Counter[str],
) -> Any:
    """Yield after each action on one heap."""
    env = HeapEnv([heap], workload.object_set, HeapEnvConfig(privileged=True))
    obs, over = None, True
    for _ in range(actions):
        if over or obs is None:
            obs, _ = env.reset(seed=int(rng.integers(2**31)))
        obs, reward, terminated, truncated, info = env.step(_command(obs, rng))
        over = terminated or truncated
        if over:
            ends[info["end"]] += 1
        for what in _unexplained(obs, reward, info, over):
            strange[what] += 1
        yield


def _command(obs: dict[str, Array], rng: np.random.Generator) -> Array:
    """Return full speed in any direction, or towards the target or another object."""
    draw = rng.random()
    if draw < 0.4:
        direction = rng.normal(size=3)
    elif draw < 0.7:
        direction = obs["target_offset"] + rng.normal(0, 0.02, 3)
    else:
        there = np.flatnonzero(obs["clutter_mask"])
        index = rng.choice(there) if len(there) else 0
        direction = obs["clutter_offsets"][index] + rng.normal(0, 0.02, 3)
    longest = max(float(np.abs(direction).max()), 1e-6)
    return np.asarray(direction / longest, np.float32)


def _unexplained(obs: dict[str, Array], reward: float, info: dict[str, Any], over: bool) -> Any:
    """Yield the names of what no rule of the environment allows."""
    if not all(np.isfinite(value).all() for value in obs.values()):
        yield "an observation is not finite"
    if not np.isfinite(reward) or abs(reward - sum(info["reward_terms"].values())) > 1e-9:
        yield "the reward is not the sum of its terms"
    if not 0.0 <= info["occlusion"] <= 1.0:
        yield "occlusion is outside [0, 1]"
    if info["failure"] and reward:
        yield "a failed simulation was rewarded"
    if over != (info["end"] is not None):
        yield "an end without a name"
    if over and info["end"] not in ENDS and not info["end"].startswith("failure: "):
        yield f"an unknown end: {info['end']}"


def _memory() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))
