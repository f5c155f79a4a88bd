"""What `mechsearch evaluate` prints of graspability and retrieval, once they were measured."""

from collections.abc import Mapping

import numpy as np

from mechsearch.evaluation.episodes import Evaluation, score
from mechsearch.findings.tables import Table, cell


def retrieval_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieved before [%]", "after [%]",
    )  # fmt: skip
    rows = tuple(_row(name, evaluation) for name, evaluation in evaluations.items())
    return Table("Graspability and retrieval of the target", columns, rows)


def _row(name: str, evaluation: Evaluation) -> tuple[str, ...]:
    grasps = [record.grasp for record in evaluation.episodes if record.grasp is not None]
    before, after, alone = np.mean([(g.before, g.after, g.alone) for g in grasps], axis=0)
    scores = score(evaluation.episodes)
    return (
        name, f"{before:.2f}", f"{after:.2f}",
        cell("graspability_change", scores["graspability_change"], signed=True), f"{alone:.2f}",
        cell("retrieval_before", scores["retrieval_before"]),
        cell("retrieval_after", scores["retrieval_after"]),
    )  # fmt: skip
