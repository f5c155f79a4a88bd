"""What beat what, in words: paired differences on the same heaps, with their intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.evaluation.metrics import HIGHER_IS_BETTER, METRICS, Estimate
from mechsearch.findings.experiment import Condition
from mechsearch.findings.questions import ShareOfGap, difference
from mechsearch.findings.tables import Table, cell, display, number, percent

_OPENINGS = {
    "better": "beats",
    "undecided": "shows no clear difference from",
    "worse": "loses to",
}
_AMOUNTS = {"better": "less than", "undecided": "about as much as", "worse": "more than"}
_SIGNS = {"better": "▲ ", "worse": "▼ ", "undecided": "≈ "}


@dataclass(frozen=True)
class Difference:
    """How one policy compares with another on the same heaps.

    Attributes:
        metric: Name in `METRICS`.
        estimate: The one minus the other.
    """

    metric: str
    estimate: Estimate

    @property
    def outcome(self) -> str:
        """Either "better", "worse" or "undecided": the last if the interval holds zero."""
        if not (self.estimate.ci_low > 0 or self.estimate.ci_high < 0):
            return "undecided"
        higher = self.estimate.mean > 0
        return "better" if higher == HIGHER_IS_BETTER[self.metric] else "worse"


@dataclass(frozen=True)
class Comparison:
    """One policy held against every other of its condition.

    Attributes:
        condition: Its name.
        ours: The policy.
        against: Differences in each of `METRICS`, by the name of the other policy.
        sentences: In reward against all, and against doing nothing useful and the teachers.
    """

    condition: str
    ours: str
    against: Mapping[str, Sequence[Difference]]
    sentences: tuple[str, ...]


def compare_with_others(condition: Condition, ours: str) -> Comparison:
    """Return how a policy compares with every other of its condition."""
    against = {
        theirs: [Difference(m, difference(condition, m, ours, theirs)) for m in METRICS]
        for theirs in condition.policies
        if theirs != ours
    }
    sentences = [_in_reward(ours, against)] if against else []
    sentences += _against_teachers(condition, ours, against)
    return Comparison(condition.name, ours, against, tuple(sentences))


def comparison_table(comparison: Comparison) -> Table:
    """Return the differences to every other policy, each marked with what it means."""
    rows = tuple(
        (theirs, *(_SIGNS[d.outcome] + cell(d.metric, d.estimate, signed=True) for d in found))
        for theirs, found in comparison.against.items()
    )
    marks = [
        [d.outcome.replace("undecided", "") for d in found] for found in comparison.against.values()
    ]
    labels = [display(metric).label.replace("[%]", "[points]") for metric in METRICS]
    caption = f"{comparison.ours} minus each other policy: ▲ better, ▼ worse, ≈ no clear difference"
    return Table(caption, ("against", *labels), rows, marks)


def _in_reward(ours: str, against: Mapping[str, Sequence[Difference]]) -> str:
    """Return whom a policy beats in reward, whom it does not, and to whom it loses."""
    groups: dict[str, list[str]] = {outcome: [] for outcome in _OPENINGS}
    for theirs, found in against.items():
        reward = found[METRICS.index("reward")]
        shown = cell("reward", reward.estimate, signed=True).replace("\n", ", ")
        groups[reward.outcome].append(f"{theirs} ({shown})")
    parts = [f"{_OPENINGS[outcome]} {_listed(names)}" for outcome, names in groups.items() if names]
    return f"In reward, {ours} {'; it '.join(parts)}."


def _against_teachers(
    condition: Condition, ours: str, against: Mapping[str, Sequence[Difference]]
) -> list[str]:
    """Return where a policy stands between doing nothing useful and the best teacher.

    Three sentences, since reward alone can be won by hovering: the share of the gap in reward that
    it closes, its share of the best teacher's change in visibility, and the clutter it moves.
    Nothing is returned without a passive policy and a teacher to compare with.
    """
    teachers = tuple(condition.teachers)
    gap = ShareOfGap(condition.name, "reward", ours, 1.0, teachers=teachers)
    change = ShareOfGap(
        condition.name, "visibility_change", ours, 1.0, from_nothing=True, teachers=teachers
    )
    _, floor, best = gap.names(condition)
    if not condition.measured("reward", floor, best):
        return []
    clearest = change.names(condition)[2]

    def mean(metric: str, name: str) -> str:
        return number(metric, float(condition.matrices([name], metric)[0].mean()))

    groups: dict[str, list[str]] = {outcome: [] for outcome in _AMOUNTS}
    for teacher in teachers:
        if teacher != ours:
            clutter = against[teacher][METRICS.index("clutter_moved_m")]
            groups[clutter.outcome].append(teacher)
    amounts = [
        f"{_AMOUNTS[outcome]} {_listed(names)}" for outcome, names in groups.items() if names
    ]
    return [
        f"Of the gap in reward between the better of doing nothing useful ({floor}, "
        f"{mean('reward', floor)}) and the best teacher ({best}, {mean('reward', best)}), {ours} "
        f"closes {_share(gap.share(condition))}.",
        f"It reaches {_share(change.share(condition))} of the change in visibility of {clearest} "
        f"({mean('visibility_change', clearest)}).",
        f"It moves every other object by {mean('clutter_moved_m', ours)} cm on average"
        f"{': ' if amounts else ''}{', '.join(amounts)}.",
    ]


def _share(estimate: Estimate) -> str:
    if np.isnan(estimate.mean):
        return "a share that is not defined (there is no gap)"
    return percent(estimate)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
