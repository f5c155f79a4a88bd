"""`frames-64`, `frames-128`, `frames-256`: depth, ids and whole projections, without physics."""

import time
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.action import PEER
from benchmarks.peer import PeerWorld
from benchmarks.peer_camera import PeerCamera
from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Episode
from mechsearch.camera import Camera, preset
from mechsearch.render.renderer import Renderer
from mechsearch.sim.scene import Pusher, pusher_model

_STATES = 8
"""States of each heap: those after pushes that moved something, so nothing can be reused."""


def measure(settings: Settings) -> Iterator[Figure]:
    """Render the same states of 15-object heaps in both stacks, state by state."""
    workload = settings.workload
    episodes = workload.episodes(workload.heaps(15, settings.heaps))
    for size in (64, 128, 256):
        camera = preset(workload.heap_set.camera, size)
        times = [_frame_times(episode, camera) for episode in episodes]
        ours, theirs = (float(np.median([pair[i] for pair in times])) for i in (0, 1))
        settings.say(f"frames-{size}: {len(episodes)} heaps")
        yield Figure(f"frames-{size}", 1 / ours, "frames/s", PEER, 1 / theirs, "more")


def _frame_times(episode: Episode, camera: Camera) -> tuple[float, float]:
    """Return the mean time of a frame [s], ours and the peer's."""
    pusher = Pusher()
    renderer = Renderer(episode.models, pusher_model(pusher))
    states = [i + 1 for i in episode.moving[:_STATES]] or [0]
    ours: list[float] = []
    theirs: list[float] = []
    with PeerWorld(episode.models) as world:
        view = PeerCamera(world, episode.models, episode.heap.target, camera)
        for warm, index in _warmed(states):
            poses, tip = episode.poses[index], episode.ee_positions[index]
            world.reset(poses, tip)
            began = time.perf_counter()
            _ = renderer.frame(camera, poses, pusher.pose(tip)).amodal
            between = time.perf_counter()
            view.images()
            view.amodal()
            ended = time.perf_counter()
            if warm:
                ours.append(between - began)
                theirs.append(ended - between)
        view.close()
    return float(np.mean(ours)), float(np.mean(theirs))


def _warmed(states: Sequence[int]) -> Iterator[tuple[bool, int]]:
    yield False, states[-1]
    for state in states:
        yield True, state
