"""`vector-1`, `vector-2`, ...: actions a second of the vector environment, beside one process."""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from benchmarks import machine
from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Workload
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.vector.vector_env import VectorHeapEnv
from mechsearch.types import Array

ENVS = 32
PEER = "the same episodes in one process"


def measure(settings: Settings) -> Iterator[Figure]:
    """Play the same episodes in one process and in several, by turns; images and 15 objects."""
    actions, rounds = (60, 5) if settings.full else (12, 3)
    numbers = [n for n in (1, 2, 4, 8, 16, 32) if n <= max(machine.cores(), 2)]
    make = partial(_make, replace(settings.workload))
    first = make()
    alone = SyncVectorEnv(
        [partial(HeapEnv, first.heaps, first.objects, first.config)] * ENVS,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    crews = {number: VectorHeapEnv(make, ENVS, number) for number in numbers}
    names = [f"vector-{number}{way}" for number in numbers for way in ("", "-step")]
    gains: dict[str, list[float]] = {name: [] for name in names}
    ones: list[float] = []
    for turn in range(rounds):
        ones.append(stepping(alone, actions))
        for number, envs in crews.items():
            gains[f"vector-{number}"].append(rolling(envs, actions) / ones[-1])
            gains[f"vector-{number}-step"].append(stepping(envs, actions) / ones[-1])
        told = ", ".join(f"{name} {gain[-1]:.2f}" for name, gain in gains.items())
        settings.say(f"round {turn + 1}: one process {ones[-1]:.1f} actions/s; {told} times that")
    for envs in crews.values():
        envs.close()
    one = float(np.median(ones))
    for name, gain in gains.items():
        yield Figure(name, float(np.median(gain)) * one, "actions/s", PEER, one, "more")


def stepping(envs: SyncVectorEnv[dict[str, Array], Array] | VectorHeapEnv, actions: int) -> float:
    """Return the actions a second where each step waits for all environments."""
    obs, _ = envs.reset(seed=0)
    rngs = [np.random.default_rng(i) for i in range(ENVS)]
    began = time.perf_counter()
    for _ in range(actions):
        obs, *_ = envs.step(_push(obs, rngs))
    return actions * ENVS / (time.perf_counter() - began)


def rolling(envs: VectorHeapEnv, actions: int) -> float:
    """Return the actions a second where environments are received one by one and sent again."""
    obs, _ = envs.reset(seed=0)
    rngs = [np.random.default_rng(i) for i in range(ENVS)]
    began = time.perf_counter()
    envs.send(_push(obs, rngs), range(ENVS))
    for _ in range((actions - 1) * ENVS):
        indices, (obs, *_) = envs.receive(1)
        envs.send(_push(obs, [rngs[indices[0]]]), indices)
    envs.receive(ENVS)
    return actions * ENVS / (time.perf_counter() - began)


def _make(workload: Workload) -> HeapEnv:
    config = HeapEnvConfig(privileged=True, camera=workload.heap_set.camera)
    return HeapEnv(workload.heaps(15, 200), workload.object_set, config)


def _push(obs: dict[str, Array], rngs: list[np.random.Generator]) -> Array:
    """Return actions (n, 3): towards the target, with noise."""
    offset = obs["target_offset"]
    towards = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    noise = np.array([rng.normal(0.0, 0.6, 3) for rng in rngs])
    actions: Array = np.clip(towards + noise, -1, 1).astype(np.float32)
    return actions
