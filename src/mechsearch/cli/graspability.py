"""What `mechsearch evaluate` adds: graspability and retrieval of each target, before and after."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation, GraspRecord
from mechsearch.evaluation.metrics import score
from mechsearch.findings.tables import Table, cell
from mechsearch.grasp.network import SHIPPED
from mechsearch.grasp.standing import Standing, StandingTask, measure_all
from mechsearch.processes import Progress


class Grasping:
    """Measures the targets of evaluations; what they have in common is measured once."""

    def __init__(self, network: Path | None, objects: str, workers: int) -> None:
        """Choose how to measure.

        Args:
            network: File of the grasp network; None takes the shipped one.
            objects: Object set; empty takes the one that an evaluation names.
            workers: Processes; the results do not depend on their number.
        """
        self._network = network or SHIPPED
        self._objects, self._workers = objects, workers
        self._first: dict[bytes, Standing] = {}

    def measured(self, evaluation: Evaluation, progress: Progress) -> Evaluation:
        """Return an evaluation with graspability and retrieval of every episode's target."""
        spec = self._objects or str(evaluation.header["object_set"])
        records = evaluation.episodes
        # All policies start from the same heaps, and an idle one ends there too.
        new = {_key(r): r for r in records if _key(r) not in self._first}
        still = [np.array_equal(r.poses[-1], r.poses[0]) for r in records]
        tasks = [self._task(record, spec, 0) for record in new.values()]
        tasks += [
            self._task(record, spec, -1)
            for record, same in zip(records, still, strict=True)
            if not same
        ]
        found = []
        for standing in measure_all(tasks, self._workers):
            found.append(standing)
            progress("grasped", len(found), len(tasks))
        self._first |= dict(zip(new, found, strict=False))
        last = iter(found[len(new) :])
        episodes = []
        for record, same in zip(records, still, strict=True):
            first = self._first[_key(record)]
            episodes.append(replace(record, grasp=_record(first, first if same else next(last))))
        return Evaluation(
            {**evaluation.header, "grasp_network": self._network.name}, tuple(episodes)
        )

    def _task(self, record: EpisodeRecord, spec: str, state: int) -> StandingTask:
        first = state == 0
        return StandingTask(
            self._network, spec, record.objects, record.target, record.poses[state], first, first
        )


def table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieved before [%]", "after [%]",
    )  # fmt: skip
    rows = tuple(_row(name, evaluation) for name, evaluation in evaluations.items())
    return Table("Graspability and retrieval of the target", columns, rows)


def _key(record: EpisodeRecord) -> bytes:
    return b"".join((repr((record.objects, record.target)).encode(), record.poses[0].tobytes()))


def _record(first: Standing, last: Standing) -> GraspRecord:
    alone = first.now if first.alone is None else first.alone
    return GraspRecord(
        first.now.score,
        last.now.score,
        alone.score,
        str(first.retrieved or ""),
        str(last.retrieved or ""),
    )


def _row(name: str, evaluation: Evaluation) -> tuple[str, ...]:
    grasps = [record.grasp for record in evaluation.episodes if record.grasp is not None]
    before, after, alone = np.mean([(g.before, g.after, g.alone) for g in grasps], axis=0)
    scores = score(evaluation.episodes)
    return (
        name,
        f"{before:.2f}",
        f"{after:.2f}",
        cell("graspability_change", scores["graspability_change"], signed=True),
        f"{alone:.2f}",
        cell("retrieval_before", scores["retrieval_before"]),
        cell("retrieval_after", scores["retrieval_after"]),
    )
