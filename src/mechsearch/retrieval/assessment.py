"""What a gripper could do with targets, in one state or before and after episodes.

That is their graspability, and what becomes of the best grasps when they are executed.
"""

import multiprocessing
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np
import torch

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation, GraspRecord
from mechsearch.grasp.graspability import (
    Graspability,
    ceiling,
    graspability,
    on_table,
    rate_target,
)
from mechsearch.grasp.network import SHIPPED_GRASP_NETWORK, GraspNetwork, load_network
from mechsearch.grippers import Gripper, check_opening
from mechsearch.heaps.dataset import Heap, object_set, open_heaps
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.processes import Progress, map_in_order, silent
from mechsearch.sim import (
    AWAKE,
    LiftFrame,
    LiftWorld,
    Perturbation,
    World,
    perturbed,
    settle,
)
from mechsearch.types import Floats, Outcome


@dataclass(frozen=True, eq=False)
class GraspTask:
    """One state of a heap, such as an episode's first or last, and what to find out about it.

    Attributes:
        objects: Object set, as given to `load_object_set`.
        names: Of the objects (N,).
        poses: Of theirs (N, 7).
        target: Index of the object to lift.
        network: File of the grasp network; None takes the shipped one.
        at_rest: Whether they lie still, as a heap does; otherwise they come to rest first, the
            robot out of the way.
        alone: Whether to rate the target with all clutter removed too.
        best: How many of the best grasps to lift it with.
        drawn: How many more, drawn uniformly from all others.
        repeats: Perturbed executions of each grasp.
        heap_seed: Seed of the heap, which the grasps that are drawn depend on.
        seed: Of the perturbations.
        opening: Of the gripper [m].
    """

    objects: str
    names: tuple[str, ...]
    poses: Floats
    target: int
    network: Path | None = None
    at_rest: bool = True
    alone: bool = False
    best: int = 1
    drawn: int = 0
    repeats: int = 0
    heap_seed: int = 0
    seed: int = 0
    opening: float = 0.056

    @property
    def models(self) -> list[ObjectModel]:
        """The objects (N,)."""
        models = object_set(self.objects).models
        return [models[name] for name in self.names]

    @property
    def gripper(self) -> Gripper:
        """The gripper."""
        return Gripper(opening=self.opening)


@dataclass(frozen=True)
class LiftResult:
    """What became of one grasp.

    Attributes:
        planned: Outcome when it is executed exactly.
        repeats: Outcomes of its perturbed executions.
    """

    planned: Outcome
    repeats: tuple[Outcome, ...] = ()

    @property
    def tried(self) -> tuple[Outcome, ...]:
        """Outcomes of the perturbed executions; without any, of the exact one."""
        return self.repeats or (self.planned,)

    @property
    def wins(self) -> int:
        """How many of those succeed."""
        return self.tried.count(Outcome.SUCCESS)

    @property
    def probability(self) -> float:
        """Share of those that succeeds."""
        return self.wins / len(self.tried)


@dataclass(frozen=True, eq=False)
class GraspAssessment:
    """What a gripper can do with one target in one state.

    Attributes:
        now: Its graspability.
        alone: Its graspability with all clutter removed; None where it was not asked for.
        quality: As rated, of the grasps that were tried (K,), the best first; none where there is
            no grasp to try.
        lifts: What became of each.
    """

    now: Graspability
    alone: Graspability | None
    quality: Floats
    lifts: tuple[LiftResult, ...]

    @property
    def retrieved(self) -> Outcome | None:
        """What the best grasp came to, executed as planned; None where none was tried."""
        return self.lifts[0].planned if self.lifts else None


@dataclass(frozen=True)
class AssessmentSummary:
    """Means over some targets.

    Attributes:
        graspability: Mean.
        ceiling: Mean with all clutter removed; NaN where it was not asked for.
        hidden: How many targets are not visible.
        retrieved: Share that the best grasp lifts, executed as planned.
        probability: Mean share of the perturbed executions of the best grasp that lift it.
        outcomes: Of those executions, how many came to what, the most frequent first.
    """

    graspability: float
    ceiling: float
    hidden: int
    retrieved: float
    probability: float
    outcomes: Mapping[str, int]


def summarise(assessments: Sequence[GraspAssessment]) -> AssessmentSummary:
    """Return means over at least one target; one without a grasp is not retrieved."""
    best, count = [found.lifts[0] for found in assessments if found.lifts], len(assessments)
    alone = [found.alone.score for found in assessments if found.alone is not None]
    return AssessmentSummary(
        float(np.mean([found.now.score for found in assessments])),
        float(np.mean(alone)) if alone else float("nan"),
        sum(not found.now.visible for found in assessments),
        sum(lift.planned is Outcome.SUCCESS for lift in best) / count,
        sum(lift.probability for lift in best) / count,
        dict(Counter(str(outcome) for lift in best for outcome in lift.tried).most_common()),
    )


def tasks_of_heaps(
    path: Path, objects: str, split: str, limit: int, network: Path | None, opening: float
) -> tuple[list[Heap], list[GraspTask]]:
    """Return heaps of a set, and for each the task to try the best grasp on its target.

    Args:
        path: File of the heap set.
        objects: Object set; empty takes the one that the heaps were made with.
        split: As for `HeapSet.choose`.
        limit: Likewise.
        network: As in a `GraspTask`.
        opening: Likewise [m].

    Raises:
        MechSearchError: If the network is no good, it cannot speak for the gripper, heaps and
            objects do not fit, or there are not so many heaps.
    """
    check_opening(opening)
    shared_network(network)
    heap_set, _ = open_heaps(path, objects)
    heaps = [heap_set.heaps[i] for i in heap_set.choose(split, limit)]
    spec = objects or heap_set.objects
    return heaps, [
        GraspTask(spec, h.objects, h.poses, h.target, network, heap_seed=h.seed, opening=opening)
        for h in heaps
    ]


def assess_all(
    tasks: Sequence[GraspTask], workers: int = 1, progress: Progress = silent
) -> list[GraspAssessment]:
    """Return what a gripper can do with each target, in order, whatever the number of workers."""
    found: list[GraspAssessment] = []
    for assessment in map_in_order(_assess, tasks, workers):
        found.append(assessment)
        progress("targets assessed", len(found), len(tasks))
    return found


def assess(
    network: GraspNetwork, models: Sequence[ObjectModel], task: GraspTask
) -> GraspAssessment:
    """Rate the target's grasps in one state, and lift it with the best and some of the others."""
    poses = task.poses if task.at_rest else settled(models, task.poses)
    alone = ceiling(network, models[task.target], poses[task.target]) if task.alone else None
    ratings = rate_target(network, models, poses, task.target)
    now = Graspability(lost=True) if ratings is None else ratings.graspability
    if ratings is None or not ratings.visible:
        return GraspAssessment(now, alone, np.empty(0), ())
    rng = np.random.default_rng([task.heap_seed, len(on_table(poses, task.target)[0])])
    chosen = ratings.best(task.best) + ratings.drawn(rng, task.drawn)
    grasps = [grasp.pose(ratings.camera) for grasp in chosen]
    lifts = lift_grasps(
        models, poses, task.target, grasps, task.repeats, seed=task.seed, gripper=task.gripper
    )
    return GraspAssessment(now, alone, np.array([g.quality for g in chosen]), tuple(lifts))


def lift_grasps(
    models: Sequence[ObjectModel],
    poses: Floats,
    target: int,
    grasps: Sequence[Floats],
    repeats: int = 0,
    seed: int = 0,
    gripper: Gripper | None = None,
) -> list[LiftResult]:
    """Return what became of grasps on one heap at rest, each from the same state.

    Args:
        models: The objects.
        poses: Of theirs (N, 7).
        target: Index of the object to lift.
        grasps: Poses (7,) of the gripper's frame.
        repeats: Perturbed executions of each grasp.
        seed: Of the perturbations.
        gripper: The gripper.
    """
    present, index = on_table(poses, target)
    if index is None or not len(grasps):
        return [LiftResult(Outcome.MISSED, (Outcome.MISSED,) * repeats) for _ in grasps]
    world, states = LiftWorld([models[i] for i in present], gripper), poses[present]
    results = []
    for i, grasp in enumerate(grasps):
        rng = np.random.default_rng([seed, i])
        planned = world.lift(states, index, grasp)
        draws = [perturbed(grasp, rng, Perturbation()) for _ in range(repeats)]
        results.append(LiftResult(planned, tuple(world.lift(states, index, *d) for d in draws)))
    return results


def film_lift(
    models: Sequence[ObjectModel], poses: Floats, target: int, grasp: Floats, gripper: Gripper
) -> tuple[Outcome, list[LiftFrame]]:
    """Return what became of a grasp that is executed exactly, and the film of it."""
    film: list[LiftFrame] = []
    return LiftWorld(models, gripper).lift(poses, target, grasp, film=film), film


def settled(models: Sequence[ObjectModel], poses: Floats) -> Floats:
    """Return poses (N, 7) after the objects on the table have come to rest without a robot."""
    states, (present, _) = np.array(poses, np.float64), on_table(poses, 0)
    if present:
        world = World([models[i] for i in present], config=AWAKE)
        world.reset(states[present])
        settle(world)
        if world.failure() is None:
            states[present] = world.poses
    return states


@lru_cache(maxsize=1)
def shared_network(path: Path | None = None) -> GraspNetwork:
    """Return the network of a file, or the shipped one, loaded once in each process.

    Raises:
        MechSearchError: If the file is missing, damaged, or holds another network.
    """
    if multiprocessing.parent_process() is not None:
        # Workers share the processors; more threads in each would only get in their way.
        torch.set_num_threads(1)
    return load_network(path)


def assess_evaluation(
    evaluation: Evaluation,
    network: Path | None = None,
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
) -> Evaluation:
    """Return an evaluation with graspability and retrieval of every episode's target.

    What a process's evaluations have in common is assessed once.

    Args:
        evaluation: What was recorded.
        network: As in a `GraspTask`.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes; the results do not depend on their number.
        progress: Told after each state.
    """
    records, spec = evaluation.episodes, objects or str(evaluation.header["object_set"])

    def task(r: EpisodeRecord, state: int) -> GraspTask:
        first = state == 0
        return GraspTask(spec, r.objects, r.poses[state], r.target, network, first, alone=first)

    # All policies start from the same heaps, and an idle one ends there too.
    starts = _starts(network, spec)
    new = {_start(r): task(r, 0) for r in records if _start(r) not in starts}
    ends = [task(r, -1) for r in records if not _still(r)]
    found = iter(assess_all([*new.values(), *ends], workers, progress))
    starts |= dict(zip(new, found, strict=False))
    episodes = []
    for record in records:
        first = starts[_start(record)]
        grasp = _grasp_record(first, first if _still(record) else next(found))
        episodes.append(replace(record, grasp=grasp))
    header = {**evaluation.header, "grasp_network": (network or SHIPPED_GRASP_NETWORK).name}
    return Evaluation(header, tuple(episodes))


def assessor(
    network: Path | None = None, objects: str = "", workers: int = 1
) -> Callable[..., Evaluation]:
    """Return `assess_evaluation` with these arguments.

    Raises:
        MechSearchError: If the network is no good.
    """
    shared_network(network)
    return partial(assess_evaluation, network=network, objects=objects, workers=workers)


class GraspabilityChange:
    """How much more graspable the target of an episode becomes (paper, section IV-C)."""

    def __init__(self, network: GraspNetwork, objects: ObjectSet) -> None:
        """Choose whose judgement it is, and of which objects the heaps are."""
        self._network, self._models = network, objects.models
        # Every policy begins with the same heaps.
        self._first: dict[int, float] = {}

    def __call__(self, record: EpisodeRecord) -> float:
        """Return the graspability at the end, when all has come to rest, minus that of the heap."""
        if _still(record):
            return 0.0
        models = [self._models[name] for name in record.objects]

        def rated(poses: Floats) -> float:
            return graspability(self._network, models, poses, record.target).score

        if record.heap_seed not in self._first:
            self._first[record.heap_seed] = rated(record.poses[0])
        return rated(settled(models, record.poses[-1])) - self._first[record.heap_seed]


def _assess(task: GraspTask) -> GraspAssessment:
    return assess(shared_network(task.network), task.models, task)


@cache
def _starts(network: Path | None, objects: str) -> dict[bytes, GraspAssessment]:
    """Return where a process keeps what starts of episodes were assessed as."""
    return {}


def _start(record: EpisodeRecord) -> bytes:
    return b"".join((repr((record.objects, record.target)).encode(), record.poses[0].tobytes()))


def _still(record: EpisodeRecord) -> bool:
    return np.array_equal(record.poses[-1], record.poses[0])


def _grasp_record(first: GraspAssessment, last: GraspAssessment) -> GraspRecord:
    lifts = str(first.retrieved or ""), str(last.retrieved or "")
    return GraspRecord(first.now.score, last.now.score, (first.alone or first.now).score, *lifts)
