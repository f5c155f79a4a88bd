"""What a gripper can do with a target: its graspability, and whether it is retrieved."""

import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from mechsearch.grasp.network import GraspNetwork, load_network
from mechsearch.grasp.quality import Graspability, ceiling, graspability
from mechsearch.grasp.retrieval import LiftTask, lift_grasps, on_table
from mechsearch.heaps.dataset import object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import map_in_order
from mechsearch.sim.lift import Outcome
from mechsearch.sim.world import AWAKE, World, settle
from mechsearch.types import Floats


@dataclass(frozen=True, eq=False)
class Standing:
    """What a gripper can do with one target in one state.

    Attributes:
        now: Its graspability.
        alone: Its graspability with all clutter removed; None where it was not asked for.
        retrieved: What its best grasp came to, executed as planned; None where there is no grasp to
            try.
    """

    now: Graspability
    alone: Graspability | None
    retrieved: Outcome | None


@dataclass(frozen=True, eq=False)
class StandingTask:
    """One state of a heap, such as an episode's first or last.

    Attributes:
        network: File of the grasp network.
        objects: Object set, as given to `load_object_set`.
        names: Of the objects (N,).
        target: Index of the target.
        poses: Of the objects (N, 7).
        at_rest: Whether they lie still, as a heap does; otherwise they come to rest first, the
            robot out of the way.
        alone: Whether to rate the target with all clutter removed too.
    """

    network: Path
    objects: str
    names: tuple[str, ...]
    target: int
    poses: Floats
    at_rest: bool = False
    alone: bool = False


def measure_all(tasks: Iterable[StandingTask], workers: int = 1) -> Iterator[Standing]:
    """Yield how each target stands, in order, whatever the number of workers."""
    yield from map_in_order(_measure, tasks, workers)


def measure(network: GraspNetwork, models: Sequence[ObjectModel], task: StandingTask) -> Standing:
    """Return how the target of one state stands."""
    poses = task.poses if task.at_rest else at_rest(models, task.poses)
    now = graspability(network, models, poses, task.target)
    alone = ceiling(network, models[task.target], poses[task.target]) if task.alone else None
    return Standing(now, alone, _tried(models, task, poses, now))


def at_rest(models: Sequence[ObjectModel], poses: Floats) -> Floats:
    """Return poses (N, 7) after the objects on the table have come to rest without a robot."""
    present, _ = on_table(poses, 0)
    settled = np.array(poses, np.float64)
    if present:
        world = World([models[i] for i in present], config=AWAKE)
        world.reset(settled[present])
        settle(world)
        if world.failure() is None:
            settled[present] = world.poses
    return settled


def _tried(
    models: Sequence[ObjectModel], task: StandingTask, poses: Floats, now: Graspability
) -> Outcome | None:
    if now.best is None:
        return None
    lift = LiftTask(task.objects, task.names, poses, task.target, now.best[None], repeats=0)
    return lift_grasps(models, lift)[0].planned


@lru_cache(maxsize=1)
def shared_network(path: Path) -> GraspNetwork:
    """Return the network of a file, loaded once in each process."""
    if multiprocessing.parent_process() is not None:
        # Workers share the processors; more threads in each would only get in their way.
        torch.set_num_threads(1)
    return load_network(path)


def _measure(task: StandingTask) -> Standing:
    models = object_set(task.objects).models
    return measure(shared_network(task.network), [models[name] for name in task.names], task)
