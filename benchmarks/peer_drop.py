"""The same drop in the peer: wall, fall, settle, rest for a second, choose a target."""

from collections.abc import Sequence

import numpy as np

from benchmarks.peer import PeerWorld
from benchmarks.peer_camera import PeerCamera
from mechsearch.camera import preset
from mechsearch.geometry import random_quaternion, rotation_from_quaternion
from mechsearch.heaps.generate import GenerateConfig
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.sim.bullet import RATE
from mechsearch.sim.world import REST_LIMIT
from mechsearch.types import Floats

_PAUSE, _FALL, _LONGEST, _LOOK = 0.16, 0.5, 4.0, 0.25
_SPEED = np.array([0.004, 0.004, 0.004, 0.04, 0.04, 0.04])


def attempt(
    config: GenerateConfig, objects: ObjectSet, count: int, rng: np.random.Generator
) -> bool:
    """Drop one heap of `count` objects; return whether it is accepted."""
    radius = 0.1 * float(np.cbrt(count / 5))
    x, y = (float(value) for value in rng.uniform(-0.05, 0.05, 2))
    chosen = rng.choice(len(objects.models), count, replace=False)
    models = [list(objects.models.values())[i] for i in chosen]
    with PeerWorld(models, pusher=False) as world:
        poses = _drop(world, models, (x, y, radius), config.height, rng)
        if poses is None or world.workspace.table_half < np.abs(poses[:, :2]).max():
            return False
        world.reset(poses)
        world.step(RATE)
        if np.linalg.norm(world.poses[:, :3] - poses[:, :3], axis=1).max() > REST_LIMIT:
            return False
        world.reset(poses)
        return _has_target(world, models, config, rng)


def _drop(
    world: PeerWorld,
    models: Sequence[ObjectModel],
    wall: tuple[float, float, float],
    least_height: float,
    rng: np.random.Generator,
) -> Floats | None:
    """Drop all objects one after another; return their poses at rest, or None."""
    x, y, radius = wall
    walls = world.add_walls(x, y, radius)
    for i in range(len(models)):
        world.place(i, np.array([0.0, 0.0, 100.0 + 3.0 * i, 1.0, 0.0, 0.0, 0.0]))
    for i, model in enumerate(models):
        quaternion, low, offset = _orientation(model, radius, rng)
        height = max(least_height, world.poses[:i, 2].max(initial=0.0) + 0.1) - low
        world.place(i, np.array([x + offset[0], y + offset[1], height, *quaternion]))
        world.step(round(_PAUSE * RATE))
    world.step(round(_FALL * RATE))
    world.remove_walls(walls)
    for _ in range(int(_LONGEST / _LOOK)):
        world.step(round(_LOOK * RATE))
        if (np.abs(world.velocities) < _SPEED).all():
            return world.poses
    return None


def _orientation(
    model: ObjectModel, reach: float, rng: np.random.Generator
) -> tuple[Floats, float, Floats]:
    """Return an orientation (4,), its lowest point [m], and an offset (2,) that fits the wall."""
    points = np.concatenate(model.parts)
    fits = []
    for _ in range(30):
        quaternion, offset = random_quaternion(rng), rng.uniform(-0.04, 0.04, 2)
        turned = points @ rotation_from_quaternion(quaternion).T
        width = float(np.linalg.norm(turned[:, :2] + offset, axis=1).max())
        fits.append((width, quaternion, float(turned[:, 2].min()), offset))
        if width < reach:
            break
    return min(fits, key=lambda fit: fit[0])[1:]


def _has_target(
    world: PeerWorld,
    models: Sequence[ObjectModel],
    config: GenerateConfig,
    rng: np.random.Generator,
) -> bool:
    """Return whether some object is hidden as far as a target must be."""
    camera = preset(config.camera)
    for target in rng.permutation(len(models)):
        view = PeerCamera(world, models, int(target), camera)
        hidden = view.occlusion(view.images()[1], view.amodal())
        view.close()
        if config.least <= hidden <= config.most:
            return True
    return False
