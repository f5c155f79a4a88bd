"""Whether grasps retrieve the target: lift tests, repeated under perturbation, in parallel."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from mechsearch.heaps.dataset import object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import map_in_order
from mechsearch.sim.gripper import Gripper
from mechsearch.sim.lift import LiftConfig, LiftWorld, Outcome, Perturbation, perturbed
from mechsearch.sim.workspace import Workspace
from mechsearch.types import Floats


@dataclass(frozen=True, eq=False)
class LiftTask:
    """Grasps to try on one heap at rest, each from the same state.

    Attributes:
        objects: Object set, as given to `load_object_set`.
        names: Of the objects (N,).
        poses: Of theirs (N, 7).
        target: Index of the object to lift.
        grasps: Poses (K, 7) of the gripper's frame.
        repeats: Perturbed executions of each grasp.
        seed: Of the perturbations.
        gripper: The gripper.
        spread: Of the perturbations.
        config: How the gripper moves.
    """

    objects: str
    names: tuple[str, ...]
    poses: Floats
    target: int
    grasps: Floats
    repeats: int = 5
    seed: int = 0
    gripper: Gripper = field(default_factory=Gripper)
    spread: Perturbation = field(default_factory=Perturbation)
    config: LiftConfig = field(default_factory=LiftConfig)


@dataclass(frozen=True)
class Lifted:
    """What became of one grasp.

    Attributes:
        planned: Outcome when it is executed exactly.
        repeats: Outcomes of its perturbed executions.
    """

    planned: Outcome
    repeats: tuple[Outcome, ...]

    @property
    def probability(self) -> float:
        """Share of the perturbed executions that succeed; without any, of the exact one."""
        tried = self.repeats or (self.planned,)
        return sum(outcome is Outcome.SUCCESS for outcome in tried) / len(tried)


def lift_all(tasks: Iterable[LiftTask], workers: int = 1) -> Iterator[list[Lifted]]:
    """Yield what became of each task's grasps, in the order of the tasks.

    The results do not depend on the number of workers.
    """
    yield from map_in_order(_lift, tasks, workers)


def lift_grasps(models: Sequence[ObjectModel], task: LiftTask) -> list[Lifted]:
    """Return what became of a task's grasps on the objects that it names."""
    poses, target = on_table(task.poses, task.target)
    if target is None:
        return [Lifted(Outcome.MISSED, (Outcome.MISSED,) * task.repeats) for _ in task.grasps]
    world = LiftWorld([models[i] for i in poses], task.gripper, task.config)
    states = task.poses[poses]
    results = []
    for i, grasp in enumerate(task.grasps):
        rng = np.random.default_rng([task.seed, i])
        planned = world.lift(states, target, grasp)
        draws = [perturbed(grasp, rng, task.spread) for _ in range(task.repeats)]
        repeats = tuple(world.lift(states, target, pose, friction) for pose, friction in draws)
        results.append(Lifted(planned, repeats))
    return results


def on_table(poses: Floats, target: int) -> tuple[list[int], int | None]:
    """Return which objects are on the table, and the target's place among them, or None."""
    gone = Workspace().off_table(poses)
    present = [i for i in range(len(poses)) if not gone[i]]
    return present, present.index(target) if target in present else None


def _lift(task: LiftTask) -> list[Lifted]:
    models = object_set(task.objects).models
    return lift_grasps([models[name] for name in task.names], task)
