"""What an episode did for the grasp: graspability and retrieval of its target, before and after."""

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
from mechsearch.parallel import map_in_order
from mechsearch.sim.lift import Outcome
from mechsearch.sim.settle import AWAKE, settle
from mechsearch.sim.world import World
from mechsearch.types import Floats


@dataclass(frozen=True, eq=False)
class Change:
    """One target at the beginning and at the end of an episode.

    Attributes:
        before: Its graspability at the beginning.
        after: Its graspability at the end.
        alone: Its graspability at the beginning, all clutter removed.
        retrieved_before: What its best grasp came to at the beginning, executed as planned; None
            where there is no grasp to try.
        retrieved_after: Likewise at the end.
    """

    before: Graspability
    after: Graspability
    alone: Graspability
    retrieved_before: Outcome | None
    retrieved_after: Outcome | None


@dataclass(frozen=True, eq=False)
class ChangeTask:
    """An episode's first and last state.

    Attributes:
        network: File of the grasp network.
        objects: Object set, as given to `load_object_set`.
        names: Of the objects (N,).
        target: Index of the target.
        first: Poses (N, 7).
        last: Poses (N, 7).
    """

    network: Path
    objects: str
    names: tuple[str, ...]
    target: int
    first: Floats
    last: Floats


def measure_all(tasks: Iterable[ChangeTask], workers: int = 1) -> Iterator[Change]:
    """Yield the change of each episode, in order, whatever the number of workers."""
    yield from map_in_order(_measure, tasks, workers)


def measure(network: GraspNetwork, models: Sequence[ObjectModel], task: ChangeTask) -> Change:
    """Return the change of one episode; its end is measured at rest, the robot out of the way."""
    first, last = task.first, at_rest(models, task.last)
    before = graspability(network, models, first, task.target)
    after = graspability(network, models, last, task.target)
    alone = ceiling(network, models[task.target], first[task.target])
    return Change(
        before, after, alone, _tried(models, task, first, before), _tried(models, task, last, after)
    )


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
    models: Sequence[ObjectModel], task: ChangeTask, poses: Floats, now: Graspability
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


def _measure(task: ChangeTask) -> Change:
    models = object_set(task.objects).models
    return measure(shared_network(task.network), [models[name] for name in task.names], task)
