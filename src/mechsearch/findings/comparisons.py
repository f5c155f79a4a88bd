"""What beat what, in words: paired differences on the same heaps, with their intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.evaluation.episodes import HIGHER_IS_BETTER, METRICS, Estimate
from mechsearch.findings.experiment import Condition
from mechsearch.findings.questions import ShareOfGap, difference
from mechsearch.findings.tables import Scores, Table, cell, display, number, percent

_OPENINGS = {
    "better": "beats",
    "undecided": "shows no clear difference from",
    "worse": "loses to",
}
_AMOUNTS = {"better": "less than", "undecided": "about as much as", "worse": "more than"}
_SIGNS = {"better": "▲ ", "worse": "▼ ", "undecided": "≈ "}


@dataclass(frozen=True)
class Comparison:
    """One policy held against every other of its condition.

    Attributes:
        condition: Its name.
        ours: The policy.
        against: Ours minus theirs by each of `METRICS`, by the name of the other policy.
        sentences: In reward against all, and against doing nothing useful and the teachers.
    """

    condition: str
    ours: str
    against: Mapping[str, Scores]
    sentences: tuple[str, ...]


def outcome(metric: str, difference: Estimate) -> str:
    """Return "better", "worse" or "undecided": the last if the interval holds zero."""
    if not (difference.ci_low > 0 or difference.ci_high < 0):
        return "undecided"
    return "better" if (difference.mean > 0) == HIGHER_IS_BETTER[metric] else "worse"


def compare_with_others(condition: Condition, ours: str) -> Comparison:
    """Return how a policy compares with every other of its condition."""
    against = {
        theirs: {m: difference(condition, m, ours, theirs) for m in METRICS}
        for theirs in condition.policies
        if theirs != ours
    }
    sentences = [_in_reward(ours, against)] if against else []
    sentences += _against_teachers(condition, ours, against)
    return Comparison(condition.name, ours, against, tuple(sentences))


def comparison_table(comparison: Comparison) -> Table:
    """Return the differences to every other policy, each marked with what it means."""
    rows, marks = [], []
    for theirs, found in comparison.against.items():
        outcomes = [outcome(*one) for one in found.items()]
        cells = [cell(*one, signed=True) for one in found.items()]
        rows.append((theirs, *(_SIGNS[o] + text for o, text in zip(outcomes, cells, strict=True))))
        marks.append([one.replace("undecided", "") for one in outcomes])
    labels = [display(metric).label.replace("[%]", "[points]") for metric in METRICS]
    caption = f"{comparison.ours} minus each other policy: ▲ better, ▼ worse, ≈ no clear difference"
    return Table(caption, ("against", *labels), tuple(rows), marks)


def _in_reward(ours: str, against: Mapping[str, Scores]) -> str:
    """Return whom a policy beats in reward, whom it does not, and to whom it loses."""
    shown = {
        theirs: f"{theirs} ({cell('reward', found['reward'], signed=True)})".replace("\n", ", ")
        for theirs, found in against.items()
    }
    parts = _grouped_in_words(_OPENINGS, "reward", against, shown)
    return f"In reward, {ours} {'; it '.join(parts)}."


def _against_teachers(condition: Condition, ours: str, against: Mapping[str, Scores]) -> list[str]:
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

    others = {teacher: teacher for teacher in teachers if teacher != ours}
    amounts = _grouped_in_words(_AMOUNTS, "clutter_moved_m", against, others)
    return [
        f"Of the gap in reward between the better of doing nothing useful ({floor}, "
        f"{mean('reward', floor)}) and the best teacher ({best}, {mean('reward', best)}), {ours} "
        f"closes {_share(gap.share(condition))}.",
        f"It reaches {_share(change.share(condition))} of the change in visibility of {clearest} "
        f"({mean('visibility_change', clearest)}).",
        f"It moves every other object by {mean('clutter_moved_m', ours)} cm on average"
        f"{': ' if amounts else ''}{', '.join(amounts)}.",
    ]


def _grouped_in_words(
    words: Mapping[str, str], metric: str, against: Mapping[str, Scores], shown: Mapping[str, str]
) -> list[str]:
    """Return the other policies by how ours compares with them, such as "beats idle"."""
    outcomes = {theirs: outcome(metric, against[theirs][metric]) for theirs in shown}
    groups = {o: [shown[theirs] for theirs in shown if outcomes[theirs] == o] for o in words}
    return [f"{words[o]} {_listed(names)}" for o, names in groups.items() if names]


def _share(estimate: Estimate) -> str:
    if np.isnan(estimate.mean):
        return "a share that is not defined (there is no gap)"
    return percent(estimate)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
