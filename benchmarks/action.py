"""`action-5`, `action-10`, `action-15`: one action with images and occlusion, beside the peer."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.peer import PeerWorld
from benchmarks.peer_camera import PeerCamera
from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Episode, Workload
from mechsearch.camera import preset
from mechsearch.types import Floats

PEER = "PyBullet 3.2.7 and TinyRenderer"
RIGID_PEER = "the same with maximal coordinates (experimental)"


@dataclass(frozen=True)
class EpisodeTimes:
    """Times of each action of one episode [s].

    Attributes:
        ours: Of our environment (T,).
        peer: Of the peer (T,).
        rigid: Of the peer with plain rigid bodies (T,).
        moving: The actions that moved an object of ours.
    """

    ours: Floats
    peer: Floats
    rigid: Floats
    moving: list[int]


def measure(settings: Settings) -> Iterator[Figure]:
    """Time the same pushes in both stacks, heap by heap, one thread each."""
    for count in (5, 10, 15):
        episodes = settings.workload.episodes(settings.workload.heaps(count, settings.heaps))
        times = []
        for number, episode in enumerate(episodes):
            times.append(compare(settings.workload, episode, ours_first=number % 2 == 0))
            settings.say(f"action-{count}: heap {number + 1} of {len(episodes)}")
        yield from _figures(f"action-{count}", times)


def compare(
    workload: Workload, episode: Episode, size: int = 64, ours_first: bool = True
) -> EpisodeTimes:
    """Time one episode in all stacks, one after the other."""
    if ours_first:
        ours = time_ours(workload, episode, size)
    peer = time_peer(workload, episode, size, rigid=False)
    rigid = time_peer(workload, episode, size, rigid=True)
    if not ours_first:
        ours = time_ours(workload, episode, size)
    return EpisodeTimes(ours, peer, rigid, episode.moving)


def time_ours(workload: Workload, episode: Episode, size: int = 64) -> Floats:
    """Return the time of each action [s]: physics, images, occlusion, reward and observation."""
    env = workload.env([episode.heap], size)
    env.reset(options={"heap": 0, "fixed_start": True})
    env.step(episode.actions[0])
    env.reset(options={"heap": 0, "fixed_start": True})
    times = []
    for action in episode.actions:
        began = time.perf_counter()
        env.step(action)
        times.append(time.perf_counter() - began)
    final = env.state.poses
    if not np.array_equal(final, episode.poses[-1]):
        raise SystemExit(f"heap {episode.heap.seed}: our environment did not repeat the push")
    return np.array(times)


def time_peer(workload: Workload, episode: Episode, size: int, rigid: bool) -> Floats:
    """Return the peer's times [s]: physics, depth, ids and occlusion; no reward or observation."""
    camera = preset(workload.heap_set.camera, size)
    times = []
    with PeerWorld(episode.models, rigid=rigid) as world:
        view = PeerCamera(world, episode.models, episode.heap.target, camera)
        view.images()
        view.amodal()
        world.reset(episode.heap.poses, episode.ee_positions[0])
        for offset in episode.offsets:
            began = time.perf_counter()
            world.displace(offset)
            _, ids = view.images()
            view.occlusion(ids, view.amodal())
            times.append(time.perf_counter() - began)
        view.close()
    return np.array(times)


def _figures(name: str, times: Sequence[EpisodeTimes]) -> Iterator[Figure]:
    """Return medians over heaps of the mean over an episode's actions [ms]."""

    def median(rows: Sequence[Floats]) -> float:
        return 1e3 * float(np.median([row.mean() for row in rows if len(row)]))

    ours = median([row.ours for row in times])
    yield Figure(name, ours, "ms", PEER, median([row.peer for row in times]))
    moving = median([row.ours[row.moving] for row in times])
    peer = median([row.peer[row.moving] for row in times])
    note = "actions that move an object"
    yield Figure(f"{name}-moving", moving, "ms", PEER, peer, note=note)
    rigid = median([row.rigid for row in times])
    yield Figure(f"{name}-maximal", ours, "ms", RIGID_PEER, rigid)
