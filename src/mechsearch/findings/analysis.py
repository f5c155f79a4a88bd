"""All that is found of an experiment, once: claims, or what beat what; tables; rows of numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from mechsearch.evaluation.episodes import (
    GRASP_METRICS,
    HIGHER_IS_BETTER,
    SHARES,
    Estimate,
    share_interval,
)
from mechsearch.files import mixed
from mechsearch.findings import claims, tables
from mechsearch.findings.experiment import CURVE_COLUMNS, Condition, Experiment, curve_rows
from mechsearch.findings.failure_modes import RETRIEVAL_MODES, UNCOVERING_MODES
from mechsearch.findings.scores import ScoredPolicy
from mechsearch.findings.tables import Scores, Table

COUNTED = ("reward", "visibility_change", "uncovered_rate")
RETRIEVAL_COUNTED = ("retrieved_within_1", "retrieved_within_5", "clutter_moved_m")
SCORES_NOTE = (
    "Means with 95 % intervals over training seeds and heaps (heaps alone where there is one seed)."
    f" {tables.EPISODES_NOTE}"
)
_MADE = ("policy", "seeds", "trained for", "tried besides", "heaps", "left out", "observes")
_MADE_WIDTHS = (20, 13, 14, 15, 9, 11, 40)
_ENGINES = {"mujoco": "MuJoCo", "bullet": "PyBullet"}
_OPENINGS = {"better": "beats", "undecided": "shows no clear difference from", "worse": "loses to"}
_RANKED_IN = {
    "reward": "In reward",
    "retrieved_within_1": "In targets retrieved at the first attempt",
    "retrieved_within_5": "In targets retrieved within five attempts",
}
_AMOUNTS = {"better": "less than", "undecided": "about as much as", "worse": "more than"}
_SIGNS = {"better": "▲ ", "worse": "▼ ", "undecided": "≈ "}


@dataclass(frozen=True)
class Comparison:
    """One policy held against every other of its condition.

    Attributes:
        heaps: What it is of in words; see `Condition`.
        ours: The policy.
        against: Ours minus theirs by each of the condition's metrics, by the other policy's name.
        sentences: In reward against all, and against doing nothing useful and the teachers; of
            retrieval in the targets that were retrieved.
    """

    heaps: str
    ours: str
    against: Mapping[str, Scores]
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class Analysis:
    """What an experiment says.

    Attributes:
        experiment: What was measured.
        paper: The paper's claims with their verdicts, where a plan was made to test them.
        as_printed: The paper's, of its own loss, where that was trained.
        goals: The project's own, likewise.
        comparisons: Of each policy that learnt with all others, where there was no plan.
    """

    experiment: Experiment
    paper: Sequence[claims.Ruling]
    as_printed: Sequence[claims.Ruling]
    goals: Sequence[claims.Ruling]
    comparisons: Sequence[Comparison]

    @property
    def rulings(self) -> list[claims.Ruling]:
        """All claims with their verdicts."""
        return [*self.paper, *self.as_printed, *self.goals]

    @property
    def lines(self) -> list[str]:
        """The findings as lines for a terminal."""
        if self.experiment.plan is None:
            return [line for comparison in self.comparisons for line in comparison.sentences]
        return [f"{ruling.verdict:>14}: {ruling.words}" for ruling in self.rulings]

    @property
    def numbers(self) -> dict[str, list[tuple[str, ...]]]:
        """Rows behind claims and figures, by a name for their file; headings first."""
        conditions = self.experiment.conditions.values()
        curves = (curve_rows(c.name, chain.from_iterable(c.runs.values())) for c in conditions)
        return {
            "claims": claims.claim_rows(self.rulings),
            "learning": [CURVE_COLUMNS, *chain.from_iterable(curves)],
            "tradeoff": tradeoff_rows(self.experiment),
        }


def analyse(experiment: Experiment) -> Analysis:
    """Return what an experiment says: of a sweep its claims, of others what beat what."""
    if experiment.plan is not None:
        trained = {name for c in experiment.conditions.values() for name in c.policies}
        printed = claims.AS_PRINTED if "as-printed" in trained else ()
        paper, as_printed, goals = (
            claims.rule(asked, experiment) for asked in (claims.PAPER, printed, claims.GOALS)
        )
        return Analysis(experiment, paper, as_printed, goals, ())
    comparisons = [
        compare_with_others(condition, name)
        for condition in experiment.conditions.values()
        for name in condition.subjects
    ]
    return Analysis(experiment, (), (), (), comparisons)


def tradeoff_rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Return actions and clutter moved of every policy and number of objects, headings first."""
    places = ("condition", "objects", "policy", "seeds")
    rows: list[tuple[str, ...]] = [(*places, "metric", "mean", "ci_low", "ci_high", "heaps")]
    for condition in experiment.conditions.values():
        for count in (None, *condition.counts):
            for name, seeds in condition.policies.items():
                place = (condition.name, str(count or "all"), name, str(len(seeds)))
                found = condition.scores_of(name, condition.tradeoff, count)
                for metric, mean in found.items():
                    rows.append((*place, metric, *tables.plain_numbers(mean), str(mean.heaps)))
    return rows


def outcome(metric: str, difference: Estimate) -> str:
    """Return "better", "worse" or "undecided": the last if the interval holds zero."""
    if not (difference.ci_low > 0 or difference.ci_high < 0):
        return "undecided"
    return "better" if (difference.mean > 0) == HIGHER_IS_BETTER[metric] else "worse"


def compare_with_others(condition: Condition, ours: str) -> Comparison:
    """Return how a policy compares with every other of its condition."""
    against = {
        theirs: {m: claims.difference(condition, m, ours, theirs) for m in condition.metrics}
        for theirs in condition.policies
        if theirs != ours
    }
    sentences = []
    for metric in filter(condition.metrics.__contains__, _RANKED_IN if against else ()):
        shown = {
            theirs: f"{theirs} ({_difference(metric, found[metric])})"
            for theirs, found in against.items()
        }
        groups = "; it ".join(_grouped_in_words(_OPENINGS, metric, against, shown))
        sentences.append(f"{_RANKED_IN[metric]}, {ours} {groups}.")
    if not condition.retrieves:
        sentences += _against_teachers(condition, ours, against)
    return Comparison(condition.heaps, ours, against, tuple(sentences))


def _difference(metric: str, estimate: Estimate) -> str:
    """Return a difference in words; shares differ by points."""
    text = tables.cell(metric, estimate, signed=True).replace("\n", ", ")
    return f"{text} points" if metric in SHARES else text


def comparison_table(comparison: Comparison) -> Table:
    """Return the differences to every other policy, each marked with what it means."""
    rows, marks = [], []
    for theirs, found in comparison.against.items():
        outcomes = [outcome(*one) for one in found.items()]
        cells = [tables.cell(*one, signed=True) for one in found.items()]
        rows.append((theirs, *(_SIGNS[o] + text for o, text in zip(outcomes, cells, strict=True))))
        marks.append([one.replace("undecided", "") for one in outcomes])
    metrics = next(iter(comparison.against.values()))
    labels = [tables.display(metric).label.replace("[%]", "[points]") for metric in metrics]
    caption = f"{comparison.ours} minus each other policy: ▲ better, ▼ worse, ≈ no clear difference"
    return Table(caption, ("against", *labels), tuple(rows), marks)


def lead(experiment: Experiment) -> str:
    """Return what was scored on what, and what is missing."""
    parts = []
    for condition in experiment.conditions.values():
        heaps = max(len(one.heaps) for one in condition.scored)
        split = str(condition.scored[0].header["split"])
        kinds = f"{split} " if split != "all" else ""
        kind = condition.scored[0].header["condition"] if condition.retrieves else condition.name
        count = len(condition.policies)
        who, does = ("policy", "retrieves") if count == 1 else ("policies", "retrieve")
        aim = f" that {does}" if condition.retrieves else ""
        parts.append(f"{count} {who}{aim} on {heaps} {kinds}{kind} heaps")
    text = f"{' and '.join(parts)}, all from the same starts."
    actions = [
        one.actions for c in experiment.conditions.values() for one in c.scored if one.trained
    ]
    if actions:
        text += f" Those that learnt executed {_range(actions)} actions in training."
    if experiment.missing:
        some = ", ".join(experiment.missing[:12])
        more = len(experiment.missing) - 12
        text += f" Planned and not scored yet: {some}{f' and {more} more' if more > 0 else ''}."
    return text


def score_tables(condition: Condition) -> list[Table]:
    """Return the scores of a condition's policies: in all, by number of objects, by reward term."""
    where, counted = f" in {condition.heaps}", COUNTED
    metrics, terms = condition.metrics, condition.terms
    if condition.retrieves:
        counted = RETRIEVAL_COUNTED
        terms = [*terms, "reward"]
    scores = {
        name: condition.scores_of(name, (*metrics, *GRASP_METRICS, *terms))
        for name in condition.policies
    }
    by_count = {
        name: {count: condition.scores_of(name, counted, count) for count in condition.counts}
        for name in condition.policies
    }
    facts = {
        "seeds": [str(len(seeds)) for seeds in condition.policies.values()],
        "heaps": [str(row[metrics[0]].heaps) for row in scores.values()],
    }
    return [
        tables.score_table(scores, f"Scores{where}", facts),
        *(tables.count_table(by_count, metric, where) for metric in counted),
        tables.terms_table(scores, f"Reward terms{where}"),
    ]


def mode_table(condition: Condition) -> Table:
    """Return the share of each way to end [%] with Wilson intervals; of retrieval if it occurs."""
    occurring = {episode.mode for one in condition.scored for episode in one.modes}
    modes = (
        [m for m in RETRIEVAL_MODES if m in occurring]
        if condition.retrieves
        else (UNCOVERING_MODES)
    )
    rows = []
    for name, seeds in condition.policies.items():
        found = [episode.mode for one in seeds for episode in one.modes]
        shares = [share_interval([float(f == mode) for f in found]) for mode in modes]
        rows.append((name, str(len(found)), *(tables.cell("uncovered_rate", s) for s in shares)))
    columns = ("policy", "episodes", *(f"{mode} [%]" for mode in modes))
    caption = (
        f"How the episodes of {condition.heaps} end, all training seeds together, with "
        "Wilson's 95 % intervals over episodes"
    )
    return Table(caption, columns, tuple(rows))


def made_table(condition: Condition) -> Table:
    """Return how each scored policy came about."""
    rows = tuple(
        (
            name,
            ", ".join(str(one.seed) for one in seeds),
            _range([one.actions for one in seeds if one.trained]),
            _range([_tried(condition, one) for one in seeds]),
            _range([len(one.heaps) for one in seeds]),
            _range([len(one.header.get("quarantined", ())) for one in seeds]),
            ", ".join(map(str, seeds[0].header.get("keys", ()))),
        )
        for name, seeds in condition.policies.items()
    )
    first = condition.scored[0].header
    facts = {
        "heap set": first.get("heap_set"),
        "objects": Path(str(first.get("object_set", ""))).name,
        "mechsearch": first.get("version"),
        _ENGINES[first.get("env", {}).get("engine", "mujoco")]: first.get("engine"),
    }
    said = "; ".join(f"{key} {value}" for key, value in facts.items() if value)
    caption = f"{condition.heaps.capitalize()}: {said}"
    return Table(caption, _MADE, rows, words=True, widths=_MADE_WIDTHS)


def made_notes(experiment: Experiment) -> list[str]:
    """Return in what the policies were not computed alike, and the plan that they follow."""
    found: Mapping[str, Mapping[str, str]] = {
        f"{condition.name} {one.name}, seed {one.seed}": one.header.get("fingerprint", {})
        for condition in experiment.conditions.values()
        for one in condition.scored
    }
    plan = [f"{k.replace('_', ' ')} {_text(v)}" for k, v in (experiment.plan or {}).items()]
    follows = [f"The plan of the experiments: {'; '.join(sorted(plan))}."] if plan else []
    return [*mixed(found), *follows]


def _against_teachers(condition: Condition, ours: str, against: Mapping[str, Scores]) -> list[str]:
    """Return where a policy stands between doing nothing useful and the best teacher.

    Three sentences, since reward alone can be won by hovering: the share of the gap in reward that
    it closes, its share of the best teacher's change in visibility, and the clutter it moves.
    There is none without a passive policy and a teacher to compare with.
    """
    teachers = tuple(condition.teachers)
    gap = claims.ShareOfGap(condition.name, "reward", ours, 1.0, teachers=teachers)
    change = claims.ShareOfGap(
        condition.name, "visibility_change", ours, 1.0, from_nothing=True, teachers=teachers
    )
    _, floor, best = gap.names(condition)
    if not condition.measured("reward", floor, best):
        return []
    clearest = change.names(condition)[2]

    def mean(metric: str, name: str) -> str:
        return tables.number(metric, float(condition.matrices([name], metric)[0].mean()))

    def share(asked: claims.ShareOfGap) -> str:
        found = asked.share(condition)
        undefined = "a share that is not defined (there is no gap)"
        return undefined if np.isnan(found.mean) else tables.percent(found)

    others = {teacher: teacher for teacher in teachers if teacher != ours}
    amounts = _grouped_in_words(_AMOUNTS, "clutter_moved_m", against, others)
    return [
        f"Of the gap in reward between the better of doing nothing useful ({floor}, "
        f"{mean('reward', floor)}) and the best teacher ({best}, {mean('reward', best)}), {ours} "
        f"closes {share(gap)}.",
        f"It reaches {share(change)} of the change in visibility of {clearest} "
        f"({mean('visibility_change', clearest)}).",
        f"It moves every other object by {mean('clutter_moved_m', ours)} cm on average"
        f"{': ' if amounts else ''}{', '.join(amounts)}.",
    ]


def _grouped_in_words(
    words: Mapping[str, str],
    metric: str,
    against: Mapping[str, Scores],
    shown: Mapping[str, str],
) -> list[str]:
    """Return the other policies by how ours compares with them, such as "beats idle"."""
    outcomes = {theirs: outcome(metric, against[theirs][metric]) for theirs in shown}
    groups = {o: [shown[theirs] for theirs in shown if outcomes[theirs] == o] for o in words}
    return [f"{words[o]} {_listed(names)}" for o, names in groups.items() if names]


def _tried(condition: Condition, scored: ScoredPolicy) -> int:
    """Return how many actions were simulated to learn, and to plan while it was scored."""
    learnt = 0
    if scored.trained:
        runs = [run for run in condition.runs.get(scored.name, ()) if run.seed == scored.seed]
        fits = [record for run in runs for record in run.records.get("fit", ())]
        learnt = max((int(record.get("simulated", 0)) for record in fits), default=0)
    return learnt + int(scored.header.get("simulated_actions", 0))


def _text(value: object) -> str:
    """Return a value of the plan; of paths the last part, since machines differ in the others."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(one)}" for key, one in value.items())
    return Path(value).name if isinstance(value, str) else str(value)


def _range(numbers: Sequence[int]) -> str:
    """Return a number, or the least and the greatest; "none" for nothing."""
    if not numbers or not max(numbers):
        return "none"
    least, most = min(numbers), max(numbers)
    return f"{most:,}" if least == most else f"{least:,} to {most:,}"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
