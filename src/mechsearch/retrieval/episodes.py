"""Graspability and retrieval of the target before and after recorded episodes."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation, GraspRecord
from mechsearch.grasp.graspability import graspability
from mechsearch.grasp.network import SHIPPED_GRASP_NETWORK, GraspNetwork
from mechsearch.objects.model import ObjectSet
from mechsearch.processes import Progress, silent
from mechsearch.retrieval.assessment import (
    GraspAssessment,
    GraspTask,
    assess_all,
    settled,
    shared_network,
)
from mechsearch.types import Floats


class EpisodeAssessor:
    """Assesses the targets of evaluations; what they have in common is assessed once."""

    def __init__(self, network: Path | None = None, objects: str = "", workers: int = 1) -> None:
        """Choose how to assess.

        Args:
            network: File of the grasp network; None takes the shipped one.
            objects: Object set; empty takes the one that an evaluation names.
            workers: Processes; the results do not depend on their number.

        Raises:
            MechSearchError: If the network is no good.
        """
        self._network = network or SHIPPED_GRASP_NETWORK
        shared_network(self._network)
        self._objects, self._workers = objects, workers
        self._first: dict[bytes, GraspAssessment] = {}

    def assessed(self, evaluation: Evaluation, progress: Progress = silent) -> Evaluation:
        """Return an evaluation with graspability and retrieval of every episode's target."""
        spec = self._objects or str(evaluation.header["object_set"])
        records = evaluation.episodes
        # All policies start from the same heaps, and an idle one ends there too.
        new = {_start(r): r for r in records if _start(r) not in self._first}
        moved = [r for r in records if not _still(r)]
        tasks = [self._task(record, spec, 0) for record in new.values()]
        tasks += [self._task(record, spec, -1) for record in moved]
        found = iter(assess_all(tasks, self._workers, progress))
        self._first |= dict(zip(new, found, strict=False))
        episodes = []
        for record in records:
            first = self._first[_start(record)]
            last = first if _still(record) else next(found)
            episodes.append(replace(record, grasp=_recorded(first, last)))
        header = {**evaluation.header, "grasp_network": self._network.name}
        return Evaluation(header, tuple(episodes))

    def _task(self, record: EpisodeRecord, spec: str, state: int) -> GraspTask:
        poses, first = record.poses[state], state == 0
        return GraspTask(
            spec, record.objects, poses, record.target, self._network, at_rest=first, alone=first
        )


def assess_evaluation(evaluation: Evaluation, network: Path | None = None) -> Evaluation:
    """Return an evaluation with graspability and retrieval of every episode's target.

    Each process keeps what its evaluations have in common.

    Args:
        evaluation: What was recorded.
        network: File of the grasp network; None takes the shipped one.
    """
    return _assessor(network).assessed(evaluation)


def mean_graspability(evaluation: Evaluation) -> tuple[float, float, float]:
    """Return the means before, after, and before with all clutter removed."""
    grasps = [record.grasp for record in evaluation.episodes if record.grasp is not None]
    before, after, alone = np.mean([(g.before, g.after, g.alone) for g in grasps], axis=0)
    return float(before), float(after), float(alone)


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


@cache
def _assessor(network: Path | None) -> EpisodeAssessor:
    return EpisodeAssessor(network)


def _start(record: EpisodeRecord) -> bytes:
    return b"".join((repr((record.objects, record.target)).encode(), record.poses[0].tobytes()))


def _still(record: EpisodeRecord) -> bool:
    return np.array_equal(record.poses[-1], record.poses[0])


def _recorded(first: GraspAssessment, last: GraspAssessment) -> GraspRecord:
    alone = first.now if first.alone is None else first.alone
    lifts = str(first.retrieved or ""), str(last.retrieved or "")
    return GraspRecord(first.now.score, last.now.score, alone.score, *lifts)
