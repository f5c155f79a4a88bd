"""States of a heap to try grasps in: as it was dropped, and as an episode may find it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.model import ObjectModel
from mechsearch.sim import Pusher, World, settle
from mechsearch.types import Floats

STATE_KINDS = ("dropped", "removed", "pushed", "alone")
"""How a state came about: as the heap was dropped; some objects removed; pushed; one left alone."""

_SWEEPS, _REACH, _TRIES = 3, 0.14, 6
"""Pushes at most, each from and to so far from an object [m]; starts tried until one is free."""

_STROKE = 0.05
"""Of one action [m]."""

_OUT = 10.0
"""Between objects that are out of the scene [m]."""


@dataclass(frozen=True, eq=False)
class State:
    """Objects at rest.

    Attributes:
        kind: Index in `STATE_KINDS`.
        poses: Of all of the heap's objects (N, 7); those that are gone are far away.
        present: Which are there (n,), indices.
    """

    kind: int
    poses: Floats
    present: NDArray[np.intp]


def states_of(
    models: Sequence[ObjectModel],
    poses: Floats,
    rng: np.random.Generator,
    removed: int,
    pushed: int,
    alone: Sequence[int],
) -> Iterator[State]:
    """Yield states of a heap: as dropped, then others; what does not come to rest is left out.

    Args:
        models: The objects (N,).
        poses: As dropped (N, 7).
        rng: Draws what is removed, and the pushes.
        removed: How many states with some objects removed.
        pushed: How many after pushes.
        alone: Objects to leave alone, each once.
    """
    everything = np.arange(len(models))
    yield State(0, np.array(poses, np.float64), everything)
    for _ in range(removed):
        size = int(rng.integers(2, len(models))) if len(models) > 2 else 1
        yield from _settled(1, models, poses, np.sort(rng.permutation(len(models))[:size]), 0, rng)
    for _ in range(pushed):
        yield from _settled(2, models, poses, everything, int(rng.integers(1, _SWEEPS + 1)), rng)
    for index in alone:
        yield from _settled(3, models, poses, everything[[index]], 0, rng)


def _settled(
    kind: int,
    models: Sequence[ObjectModel],
    poses: Floats,
    present: NDArray[np.intp],
    sweeps: int,
    rng: np.random.Generator,
) -> Iterator[State]:
    """Yield the state after some objects were pushed and came to rest, if they did."""
    world = World([models[i] for i in present], pusher=Pusher())
    world.reset(poses[present])
    for _ in range(sweeps):
        _sweep(world, rng)
    world.place_pusher(np.array([0.0, 0.0, 5.0]))
    if not settle(world) or world.failure() is not None:
        return
    states = np.array(poses, np.float64)
    states[:, 0] += _OUT * (1 + np.arange(len(states)))
    states[present] = world.poses
    yield State(kind, states, present)


def _sweep(world: World, rng: np.random.Generator) -> None:
    """Push straight through where an object lies, from a place where the pusher is free."""
    for _ in range(_TRIES):
        middle = world.poses[rng.integers(world.count), :3]
        angle, height = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.01, 0.06)
        way = _REACH * np.array([np.cos(angle), np.sin(angle), 0.0])
        start = world.workspace.clip(np.array([*middle[:2], height]) - way)
        world.place_pusher(start)
        if world.pusher_is_free():
            break
    else:
        return
    end = world.workspace.clip(start + rng.uniform(1.0, 2.0) * way)
    steps = max(int(np.ceil(np.linalg.norm(end - start) / _STROKE)), 1)
    for share in np.arange(1, steps + 1) / steps:
        world.push(start + share * (end - start))
