"""What beat what, in words: paired differences on the same heaps, with their intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.metrics import (
    HIGHER_IS_BETTER,
    METRICS,
    Estimate,
    measure,
    paired_difference,
)
from mechsearch.report.tables import MINUS, Table, cell, number
from mechsearch.types import Floats, MechSearchError

PASSIVE = ("random", "idle")
TEACHER_PREFIX = "teacher-"

NOTE = (
    "Differences are paired heap by heap, with 95 % intervals for each comparison by itself: among "
    "many comparisons some intervals miss the truth. “No clear difference” means that the interval "
    "holds zero, not that two policies are alike."
)


@dataclass(frozen=True)
class Verdict:
    """How one policy compares with another on the same heaps.

    Attributes:
        ours: Name of the first.
        theirs: Name of the second.
        metric: Name in `METRICS`.
        difference: Ours minus theirs.
    """

    ours: str
    theirs: str
    metric: str
    difference: Estimate

    @property
    def outcome(self) -> str:
        """Either "better", "worse" or "undecided": the last if the interval holds zero."""
        if not (self.difference.ci_low > 0 or self.difference.ci_high < 0):
            return "undecided"
        higher = self.difference.mean > 0
        return "better" if higher == HIGHER_IS_BETTER[self.metric] else "worse"


def compare(ours: str, theirs: str, evaluations: Mapping[str, Evaluation]) -> list[Verdict]:
    """Return a verdict for each metric.

    Raises:
        MechSearchError: If the two did not run on the same heaps.
    """
    left, right = evaluations[ours].episodes, evaluations[theirs].episodes
    return [
        Verdict(ours, theirs, metric, paired_difference(left, right, metric)) for metric in METRICS
    ]


def sentence(ours: str, evaluations: Mapping[str, Evaluation]) -> str:
    """Return whom a policy beats in reward, whom it does not, and to whom it loses."""
    groups: dict[str, list[str]] = {"better": [], "undecided": [], "worse": []}
    for theirs in evaluations:
        if theirs != ours:
            reward = compare(ours, theirs, evaluations)[METRICS.index("reward")]
            difference = cell("reward", reward.difference, signed=True).replace("\n", ", ")
            groups[reward.outcome].append(f"{theirs} ({difference})")
    openings = {
        "better": "beats",
        "undecided": "shows no clear difference from",
        "worse": "loses to",
    }
    parts = [f"{openings[key]} {_listed(names)}" for key, names in groups.items() if names]
    return f"In reward, {ours} {'; it '.join(parts)}." if parts else ""


def standing(ours: str, evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Return where a policy stands between doing nothing useful and the best teacher.

    Three sentences, since reward alone can be won by hovering: the share of the gap in reward that
    it closes, its share of the best teacher's change in visibility, and the clutter it moves.
    Nothing is returned without a passive policy and a teacher to compare with.
    """
    _require_same_heaps(evaluations)
    means = {name: {m: _values(e, m).mean() for m in METRICS} for name, e in evaluations.items()}
    passive = [name for name in PASSIVE if name in means]
    teachers = [name for name in means if name.startswith(TEACHER_PREFIX)]
    if not passive or not teachers:
        return []
    floor = max(passive, key=lambda name: means[name]["reward"])
    best = max(teachers, key=lambda name: means[name]["reward"])
    clearest = max(teachers, key=lambda name: means[name]["visibility_change"])
    reward, low, high = (_values(evaluations[name], "reward") for name in (ours, floor, best))
    change, clear = (_values(evaluations[name], "visibility_change") for name in (ours, clearest))
    return [
        f"Of the gap in reward between the better of doing nothing useful ({floor}, "
        f"{number('reward', means[floor]['reward'])}) and the best teacher ({best}, "
        f"{number('reward', means[best]['reward'])}), {ours} closes "
        f"{_percentage(*_ratio(reward - low, high - low))}.",
        f"It reaches {_percentage(*_ratio(change, clear))} of the change in visibility of "
        f"{clearest} ({number('visibility_change', means[clearest]['visibility_change'])}).",
        _clutter(ours, teachers, evaluations),
    ]


def verdict_table(
    ours: str, evaluations: Mapping[str, Evaluation]
) -> tuple[Table, list[list[str]]]:
    """Return differences to every other policy, and the outcome in each cell."""
    rows, marks = [], []
    signs = {"better": "▲ ", "worse": "▼ ", "undecided": "≈ "}
    for theirs in evaluations:
        if theirs == ours:
            continue
        verdicts = compare(ours, theirs, evaluations)
        marks.append([verdict.outcome for verdict in verdicts])
        cells = [signs[v.outcome] + cell(v.metric, v.difference, signed=True) for v in verdicts]
        rows.append((theirs, *cells))
    columns = ("against", *(_DIFFERENCES[metric] for metric in METRICS))
    caption = f"{ours} minus each other policy: ▲ better, ▼ worse, ≈ no clear difference"
    return Table(caption, columns, tuple(rows)), marks


_DIFFERENCES = {
    "reward": "reward",
    "visibility_change": "visibility gained",
    "uncovered_rate": "uncovered [points]",
    "episode_actions": "actions",
    "clutter_moved_m": "clutter moved [cm]",
    "target_moved_m": "target moved [cm]",
}


def _clutter(ours: str, teachers: Sequence[str], evaluations: Mapping[str, Evaluation]) -> str:
    verdicts = {
        teacher: Verdict(
            ours,
            teacher,
            "clutter_moved_m",
            paired_difference(
                evaluations[ours].episodes, evaluations[teacher].episodes, "clutter_moved_m"
            ),
        )
        for teacher in teachers
    }
    moved = number("clutter_moved_m", float(_values(evaluations[ours], "clutter_moved_m").mean()))
    words = {"better": "less than", "undecided": "about as much as", "worse": "more than"}
    parts = [
        f"{words[outcome]} {_listed(names)}"
        for outcome in words
        if (names := [name for name, v in verdicts.items() if v.outcome == outcome])
    ]
    return f"It moves every other object by {moved} cm on average: {', '.join(parts)}."


def _require_same_heaps(evaluations: Mapping[str, Evaluation]) -> None:
    heaps = {
        name: sorted((record.condition, record.heap_seed) for record in evaluation.episodes)
        for name, evaluation in evaluations.items()
    }
    first = next(iter(heaps))
    for name, others in heaps.items():
        if others != heaps[first]:
            raise MechSearchError(
                f"{first} ran on {len(heaps[first])} heaps and {name} on {len(others)}, not the "
                "same ones; a comparison needs the same"
            )


def _values(evaluation: Evaluation, metric: str) -> Floats:
    """Return one metric of every episode, in the order of the heaps' seeds."""
    ordered = sorted(evaluation.episodes, key=lambda record: (record.condition, record.heap_seed))
    return np.array([measure(record)[metric] for record in ordered])


def _ratio(
    numerator: Floats,
    denominator: Floats,
    samples: int = 4000,
) -> tuple[float, float, float]:
    """Return a ratio of means over heaps with its bootstrap percentile interval (seed 0)."""
    if denominator.mean() <= 0:
        return float("nan"), float("nan"), float("nan")
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(numerator), (samples, len(numerator)))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = numerator[chosen].mean(axis=1) / denominator[chosen].mean(axis=1)
    low, high = np.nanpercentile(ratios, [2.5, 97.5])
    return float(numerator.mean() / denominator.mean()), float(low), float(high)


def _percentage(share: float, low: float, high: float) -> str:
    if np.isnan(share):
        return "a share that is not defined (there is no gap)"
    return f"{share:.0%} (95 % interval {low:.0%} to {high:.0%})".replace("-", MINUS)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
