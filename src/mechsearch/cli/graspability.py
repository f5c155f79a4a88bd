"""What `mechsearch evaluate` adds: graspability and retrieval of each target, before and after."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation, GraspRecord
from mechsearch.evaluation.metrics import score
from mechsearch.grasp.change import Change, ChangeTask, measure_all
from mechsearch.grasp.network import SHIPPED
from mechsearch.parallel import Progress
from mechsearch.report.tables import Table, cell


def measured(
    evaluation: Evaluation, network: Path | None, objects: str, workers: int, progress: Progress
) -> Evaluation:
    """Return an evaluation with the graspability and retrieval of every episode's target.

    Args:
        evaluation: The episodes.
        network: File of the grasp network; None takes the shipped one.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes; the results do not depend on their number.
        progress: Told after each episode.
    """
    network = network or SHIPPED
    spec = objects or str(evaluation.header["object_set"])
    tasks = [
        ChangeTask(network, spec, r.objects, r.target, r.poses[0], r.poses[-1])
        for r in evaluation.episodes
    ]
    episodes: list[EpisodeRecord] = []
    for change in measure_all(tasks, workers):
        episodes.append(replace(evaluation.episodes[len(episodes)], grasp=_record(change)))
        progress("grasped", len(episodes), len(tasks))
    return Evaluation({**evaluation.header, "grasp_network": network.name}, tuple(episodes))


def table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieved before [%]", "after [%]",
    )  # fmt: skip
    rows = tuple(_row(name, evaluation) for name, evaluation in evaluations.items())
    return Table("Graspability and retrieval of the target", columns, rows)


def _record(change: Change) -> GraspRecord:
    return GraspRecord(
        change.before.score,
        change.after.score,
        change.alone.score,
        str(change.retrieved_before or ""),
        str(change.retrieved_after or ""),
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
