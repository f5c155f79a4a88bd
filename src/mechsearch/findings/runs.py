"""What training runs logged, and their learning curves as numbers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.evaluation.episodes import GRASP_METRICS, METRICS, Estimate, mean_interval
from mechsearch.files import CONFIG_FILE, INPUTS_FILE, METRICS_FILE, read_lines, read_record
from mechsearch.types import Floats, MechSearchError

EVALUATIONS = {"held_out": "held-out heaps", "validation": "validation heaps"}
"""What a run scores itself on while it learns, those of more weight first."""

CURVE_COLUMNS = (
    *("condition", "variant", "seed", "scored_on", "step", "metric"),
    *("mean", "ci_low", "ci_high", "heaps"),
)


@dataclass(frozen=True)
class Run:
    """What a training run logged.

    Attributes:
        name: Of the run's configuration.
        seed: Likewise.
        records: Lines of the log by their kind, such as "validation" or "episode".
        heap_set: Digest of the heaps that it learnt from; empty if it does not say.
    """

    name: str
    seed: int
    records: Mapping[str, Sequence[Mapping[str, Any]]]
    heap_set: str = ""

    def series(self, kind: str, key: str, over: str = "step") -> tuple[Floats, Floats]:
        """Return steps, or another number, and values (n,) of one number in one kind of record."""
        pairs = [(r[over], r[key]) for r in self.records.get(kind, ()) if key in r]
        steps, values = np.array(pairs, np.float64).reshape(-1, 2).T
        return steps, values

    def keys(self, kind: str) -> list[str]:
        """Return the names of all numbers in one kind of record, in their first order."""
        names: dict[str, None] = {}
        for record in self.records.get(kind, ()):
            names |= {k: None for k, v in record.items() if isinstance(v, int | float)}
        return [name for name in names if name != "step"]


@dataclass(frozen=True)
class LearningCurve:
    """One metric of one variant while it learns.

    Attributes:
        steps: Training actions at each evaluation (K,).
        seeds: Value of each training seed (S, K).
    """

    steps: Floats
    seeds: Floats

    @property
    def means(self) -> list[Estimate]:
        """Mean over seeds at each step (K), with Student's t interval where there are several."""
        return [mean_interval(values) for values in self.seeds.T]


def read_run(directory: Path) -> Run:
    """Read a run directory.

    Raises:
        MechSearchError: If it holds no run, or its log is damaged.
    """
    config = read_record(directory / CONFIG_FILE, "training configuration")
    inputs, heap_set = directory / INPUTS_FILE, ""
    if inputs.exists():
        heap_set = str(read_record(inputs, "record of a run's inputs").get("heap_set", ""))
    records: dict[str, list[Mapping[str, Any]]] = {}
    try:
        for record in read_lines(directory / METRICS_FILE):
            records.setdefault(record["kind"], []).append(record)
    except (ValueError, KeyError, TypeError) as error:
        raise MechSearchError(
            f"the log at {directory / METRICS_FILE} is damaged: {error}"
        ) from None
    name, seed = str(config.get("name", directory.name)), int(config.get("seed", 0))
    return Run(name, seed, records, heap_set)


def learning_curve(runs: Sequence[Run], metric: str, kind: str) -> LearningCurve | None:
    """Return one metric at the actions that all runs were scored at; None if there are none."""
    series = [run.series(kind, metric) for run in runs]
    shared = set(series[0][0]) if series else set()
    for steps, _ in series:
        shared &= set(steps)
    if not shared:
        return None
    order = np.array(sorted(shared))
    rows = []
    for steps, values in series:
        # A run that went on from a checkpoint may have scored a step again.
        last = dict(zip(steps, values, strict=True))
        rows.append([last[step] for step in order])
    return LearningCurve(order, np.array(rows))


def curve_rows(condition: str, runs: Sequence[Run]) -> Iterator[tuple[str, ...]]:
    """Yield every point of every curve of some runs, with its interval over heaps if it has one."""
    for run in runs:
        for kind, heaps in EVALUATIONS.items():
            for record in run.records.get(kind, ()):
                place = (condition, run.name, str(run.seed), heaps, str(record["step"]))
                for metric in (*METRICS, *GRASP_METRICS):
                    if metric in record:
                        ends = (record.get(metric + end, "") for end in ("", "_ci_low", "_ci_high"))
                        cells = [f"{value:.6g}" if value != "" else "" for value in ends]
                        yield (*place, metric, *cells, str(record.get("heaps", "")))
