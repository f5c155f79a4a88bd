"""Parts of a run from a heap set: environment, teachers and evaluators."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mechsearch.algorithm import Evaluator, RunConfig, TrainingSetup
from mechsearch.evaluation.episodes import EpisodeRecord, logged, mean_interval, score
from mechsearch.evaluation.rollout import AnyEnv, make_environment, run
from mechsearch.grasp.network import load_network
from mechsearch.heaps.dataset import HeapSet
from mechsearch.objects.model import ObjectSet
from mechsearch.retrieval.assessment import GraspabilityChange
from mechsearch.teachers import make_teacher
from mechsearch.types import MechSearchError, Policy

SHIPPED_NETWORK = "shipped"
"""Names the grasp network that comes with the package."""


@dataclass(frozen=True)
class HeapEvaluator:
    """Scores a policy on some heaps, from each heap's own start.

    Attributes:
        env: The task, with the actor's observations only.
        heaps: Indices of the heaps.
        intervals: Whether to return the mean's confidence interval too.
        grasped: Returns the change in graspability of an episode's target, where it is measured.
    """

    env: AnyEnv
    heaps: tuple[int, ...]
    intervals: bool = False
    grasped: Callable[[EpisodeRecord], float] | None = None

    def __call__(self, policy: Policy) -> dict[str, float]:
        """Return the mean of every metric; with intervals what `episodes.logged` returns."""
        records = run(policy, self.env, self.heaps)
        scores = score(records)
        if self.grasped:
            scores["graspability_change"] = mean_interval([self.grasped(r) for r in records])
        if self.intervals:
            return logged(scores)
        return {name: estimate.mean for name, estimate in scores.items()}


def assemble(config: RunConfig[Any], heap_set: HeapSet, objects: ObjectSet) -> TrainingSetup:
    """Return what a run needs of the training heaps of a set.

    Validation heaps are taken out of the training heaps, evenly over the object counts, the same
    ones for every configuration. Held-out heaps are watched only where the schedule asks.

    Raises:
        MechSearchError: If the set has too few heaps.
    """
    schedule, algorithm = config.schedule, config.algorithm
    validation = _some(heap_set, "train", schedule.validation_heaps, "validation")
    watched = _some(heap_set, "held-out", schedule.held_out_heaps, "held-out")
    learnt = [i for i in heap_set.choose("train") if i not in set(validation)]
    if not learnt:
        raise MechSearchError(
            f"{len(validation)} training heaps, of which {len(validation)} are kept for "
            "validation, leave none to learn on"
        )
    env, quiet = (
        make_environment(heap_set.heaps, objects, config.task, algorithm.keys, privileged)
        for privileged in (True, False)
    )
    evaluators: dict[str, Evaluator] = {}
    if validation:
        evaluators["validation"] = HeapEvaluator(quiet, validation)
    if watched:
        grasped = _grasped(schedule.grasp_network, objects)
        evaluators["held_out"] = HeapEvaluator(quiet, watched, True, grasped)
    teachers = {name: make_teacher(name) for name in algorithm.teachers}
    return TrainingSetup(env, learnt, teachers, evaluators)


def _grasped(network: str, objects: ObjectSet) -> GraspabilityChange | None:
    if not network:
        return None
    file = None if network == SHIPPED_NETWORK else Path(network)
    return GraspabilityChange(load_network(file), objects)


def _some(heap_set: HeapSet, split: str, count: int, what: str) -> tuple[int, ...]:
    if not count:
        return ()
    there = len(heap_set.train if split == "train" else heap_set.held_out)
    if count > there:
        raise MechSearchError(
            f"{count} {what} heaps asked for; the set has {there} to take them from"
        )
    return heap_set.choose(split, count)
