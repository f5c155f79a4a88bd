"""Whether objects lie still."""

from collections.abc import Sequence

import numpy as np

from mechsearch.objects.model import ObjectModel
from mechsearch.sim.scene import PhysicsConfig
from mechsearch.sim.world import World
from mechsearch.types import Array

REST_LIMIT = 0.001
"""At rest, no object moves farther than this [m] in one more simulated second."""

_LOOK = 0.25
"""Time between two looks at a settling heap [s]."""

AWAKE = PhysicsConfig(sleep_speed=0.0)
"""Physics in which nothing sleeps: rest is measured, not assumed."""


def settle(world: World, seconds: float = 4.0, limit: float = REST_LIMIT) -> bool:
    """Step until no object's centre moves faster than `limit` [m/s], or give up.

    What counts is the way from one look to the next: contacts may tremble in place.

    Returns:
        Whether all objects came to rest on the table; it ends when the first has left that.
    """
    chunk = max(1, round(_LOOK / world.config.time_step))
    before = world.poses
    for _ in range(round(seconds / _LOOK)):
        world.step(chunk)
        poses = world.poses
        if world.workspace.off_table(poses).any():
            return False
        way = np.linalg.norm(poses[:, :3] - before[:, :3], axis=1)
        if float(way.max(initial=0.0)) < limit * _LOOK:
            return True
        before = poses
    return False


def drift(models: Sequence[ObjectModel], poses: Array) -> float:
    """Return how far the most restless object moves [m] in one second, started at `poses`.

    A fresh world without sleep is used; a failed simulation drifts infinitely far.
    """
    world = World(models, config=AWAKE)
    world.reset(poses)
    world.step(round(1.0 / world.config.time_step))
    if world.failure() is not None:
        return float("inf")
    moved = world.poses[:, :3] - np.asarray(poses)[:, :3]
    return float(np.linalg.norm(moved, axis=1).max(initial=0.0))
