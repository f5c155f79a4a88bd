"""What `mechsearch evaluate --grasp-network` adds: graspability and retrieval, before and after."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.metrics import (
    GRASP_METRICS,
    Estimate,
    mean_interval,
    share_interval,
)
from mechsearch.grasp.change import Change, ChangeTask, measure_all
from mechsearch.parallel import Progress
from mechsearch.report.tables import Table


@dataclass(frozen=True, eq=False)
class Grasped:
    """The targets of one evaluation, as a gripper sees them.

    Attributes:
        changes: One for each episode.
    """

    changes: tuple[Change, ...]

    @property
    def scores(self) -> dict[str, Estimate]:
        """Each of `GRASP_METRICS` over the episodes."""
        values = [change.metrics for change in self.changes]
        columns = {name: [value[name] for value in values] for name in GRASP_METRICS}
        return {
            name: (share_interval if name.startswith("retrieval") else mean_interval)(column)
            for name, column in columns.items()
        }


def measured(
    evaluation: Evaluation, network: Path, objects: str, workers: int, progress: Progress
) -> Grasped:
    """Return graspability and retrieval of every episode's target.

    Args:
        evaluation: The episodes.
        network: File of the grasp network.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes; the results do not depend on their number.
        progress: Told after each episode.
    """
    spec = objects or str(evaluation.header["object_set"])
    tasks = [
        ChangeTask(network, spec, r.objects, r.target, r.poses[0], r.poses[-1])
        for r in evaluation.episodes
    ]
    changes = []
    for i, change in enumerate(measure_all(tasks, workers)):
        changes.append(change)
        progress("grasped", i + 1, len(tasks))
    return Grasped(tuple(changes))


def table(names: Sequence[str], grasped: Sequence[Grasped]) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieval before", "after", "lost",
    )  # fmt: skip
    rows = tuple(_row(name, found) for name, found in zip(names, grasped, strict=True))
    return Table("Graspability and retrieval of the target", columns, rows)


def _row(name: str, grasped: Grasped) -> tuple[str, ...]:
    changes, scores = grasped.changes, grasped.scores
    means = [
        float(np.mean([change.before.score for change in changes])),
        float(np.mean([change.after.score for change in changes])),
    ]
    alone = float(np.mean([change.alone.score for change in changes]))
    lost = sum(change.after.lost for change in changes)
    return (
        name,
        *(f"{mean:.2f}" for mean in means),
        _text(scores["graspability_change"], signed=True),
        f"{alone:.2f}",
        _text(scores["retrieval_before"]),
        _text(scores["retrieval_after"]),
        str(lost),
    )


def _text(estimate: Estimate, signed: bool = False) -> str:
    sign = "+" if signed else ""
    mean = f"{estimate.mean:{sign}.2f}"
    if np.isnan(estimate.ci_low):
        return mean
    return f"{mean}\n{estimate.ci_low:{sign}.2f} to {estimate.ci_high:{sign}.2f}"
