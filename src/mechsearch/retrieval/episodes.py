"""Graspability and retrieval of the target before and after recorded episodes."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
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
        network: File of the grasp network; None takes the shipped one.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes; the results do not depend on their number.
        progress: Told after each state.
    """
    records, spec = evaluation.episodes, objects or str(evaluation.header["object_set"])

    def task(record: EpisodeRecord, state: int) -> GraspTask:
        poses, first = record.poses[state], state == 0
        return GraspTask(
            spec, record.objects, poses, record.target, network, at_rest=first, alone=first
        )

    # All policies start from the same heaps, and an idle one ends there too.
    starts = _starts(network, spec)
    new = {_start(r): task(r, 0) for r in records if _start(r) not in starts}
    ends = [task(r, -1) for r in records if not _still(r)]
    found = iter(assess_all([*new.values(), *ends], workers, progress))
    starts |= dict(zip(new, found, strict=False))
    episodes = []
    for record in records:
        first = starts[_start(record)]
        grasp = _recorded(first, first if _still(record) else next(found))
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


@cache
def _starts(network: Path | None, objects: str) -> dict[bytes, GraspAssessment]:
    """Return where a process keeps what starts of episodes were assessed as."""
    return {}


def _start(record: EpisodeRecord) -> bytes:
    return b"".join((repr((record.objects, record.target)).encode(), record.poses[0].tobytes()))


def _still(record: EpisodeRecord) -> bool:
    return np.array_equal(record.poses[-1], record.poses[0])


def _recorded(first: GraspAssessment, last: GraspAssessment) -> GraspRecord:
    alone = first.now if first.alone is None else first.alone
    lifts = str(first.retrieved or ""), str(last.retrieved or "")
    return GraspRecord(first.now.score, last.now.score, alone.score, *lifts)
