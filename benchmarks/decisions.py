"""`physics-15-...`, `frame-64-...`: what the decisions behind the speed are worth."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Episode
from mechsearch.camera import preset
from mechsearch.render.renderer import Renderer
from mechsearch.sim.scene import PhysicsConfig, Pusher, Workspace, pusher_model
from mechsearch.sim.world import World

PHYSICS = {
    "": PhysicsConfig(),
    "-awake": replace(PhysicsConfig(), sleep_speed=0.0),
    "-whole": replace(
        PhysicsConfig(), sleep_speed=0.0, clearance=float("inf"), stops_when_still=False
    ),
}
"""What is left out: all that cannot matter; the same but for sleep; nothing."""


def measure(settings: Settings) -> Iterator[Figure]:
    """Repeat the recorded pushes in each physics, heap by heap in turns; render moved objects."""
    episodes = settings.workload.episodes(settings.workload.heaps(15, settings.heaps))
    times = {name: [_pushing(e, config) for e in episodes] for name, config in PHYSICS.items()}
    found = {name: 1e3 * float(np.median(seconds)) for name, seconds in times.items()}
    settings.say(f"physics-15: {found} ms")
    whole = found["-whole"]
    yield Figure("physics-15", found[""], "ms", "nothing left out", whole)
    yield Figure("physics-15-awake", found["-awake"], "ms", "nothing left out", whole)
    fresh, kept = (1e3 * float(np.median(_rendering(episodes, moved))) for moved in (True, False))
    yield Figure("frame-64-kept", kept, "ms", "every object moved", fresh)


def _pushing(episode: Episode, config: PhysicsConfig) -> float:
    """Return the mean time of an action [s], physics alone."""
    workspace = Workspace()
    world = World(episode.models, workspace, Pusher(), config=config)
    world.reset(episode.heap.poses, episode.ee_positions[0])
    began = time.perf_counter()
    for offset in episode.offsets:
        world.push(workspace.clip(world.pusher_position + offset))
    return (time.perf_counter() - began) / len(episode.offsets)


def _rendering(episodes: Sequence[Episode], moved: bool) -> list[float]:
    """Return the time of a frame on each heap [s], of objects that all moved or none did."""
    camera, pusher, seconds = preset("overhead"), Pusher(), []
    for episode in episodes:
        renderer = Renderer(episode.models, pusher_model(pusher))
        poses, tip = episode.heap.poses.copy(), pusher.pose(episode.ee_positions[0])
        renderer.frame(camera, poses, tip)
        began = time.perf_counter()
        for _ in range(20):
            if moved:
                poses[:, 2] += 1e-6
            renderer.frame(camera, poses, tip)
        seconds.append((time.perf_counter() - began) / 20)
    return seconds
