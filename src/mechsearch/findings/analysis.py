"""All that is found of an experiment, once: claims or comparisons, tables, and rows of numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mechsearch.evaluation.episodes import GRASP_METRICS, METRICS, share_interval
from mechsearch.files import mixed
from mechsearch.findings.claims import GOALS, PAPER, Ruling, claim_rows, rule
from mechsearch.findings.comparisons import Comparison, compare_with_others
from mechsearch.findings.experiment import Condition, Experiment
from mechsearch.findings.failure_modes import EPISODE_MODES
from mechsearch.findings.runs import CURVE_COLUMNS, curve_rows
from mechsearch.findings.scores import ScoredPolicy
from mechsearch.findings.tables import Table, count_table, score_table, terms_table

TRADEOFF = ("episode_actions", "clutter_moved_m")
COUNTED = ("reward", "visibility_change", "uncovered_rate")
SCORES_NOTE = (
    "Means with 95 % intervals over training seeds and heaps (heaps alone where there is one seed)."
    " Every episode counts, lost targets and failed simulations included; an unfinished one counts "
    "all its actions. Clutter moved is the path length of a non-target object."
)
_MADE = ("policy", "seeds", "trained for", "tried besides", "heaps", "left out", "observes")
_MADE_WIDTHS = (20, 13, 14, 15, 9, 11, 40)


@dataclass(frozen=True)
class Analysis:
    """What an experiment says.

    Attributes:
        experiment: What was measured.
        paper: The paper's claims with their verdicts, where a plan was made to test them.
        goals: The project's own, likewise.
        comparisons: Of each policy that learnt with all others, where there was no plan.
    """

    experiment: Experiment
    paper: Sequence[Ruling]
    goals: Sequence[Ruling]
    comparisons: Sequence[Comparison]

    @property
    def lines(self) -> list[str]:
        """The findings as lines for a terminal."""
        if self.experiment.plan is None:
            return [line for comparison in self.comparisons for line in comparison.sentences]
        return [f"{ruling.verdict:>14}: {ruling.words}" for ruling in (*self.paper, *self.goals)]

    @property
    def numbers(self) -> dict[str, list[tuple[str, ...]]]:
        """Rows behind claims and figures, by a name for their file; headings first."""
        curves = (
            row
            for condition in self.experiment.conditions.values()
            for runs in condition.runs.values()
            for row in curve_rows(condition.name, runs)
        )
        return {
            "claims": claim_rows((*self.paper, *self.goals)),
            "learning": [CURVE_COLUMNS, *curves],
            "tradeoff": tradeoff_rows(self.experiment),
        }


def analyse(experiment: Experiment) -> Analysis:
    """Return what an experiment says: of a sweep its claims, of others what beat what."""
    if experiment.plan is not None:
        return Analysis(experiment, rule(PAPER, experiment), rule(GOALS, experiment), ())
    comparisons = [
        compare_with_others(condition, name)
        for condition in experiment.conditions.values()
        for name in condition.subjects
    ]
    return Analysis(experiment, (), (), comparisons)


def tradeoff_rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Return actions and clutter moved of every policy and number of objects, headings first."""
    places = ("condition", "objects", "policy", "seeds")
    rows: list[tuple[str, ...]] = [(*places, "metric", "mean", "ci_low", "ci_high", "heaps")]
    for condition in experiment.conditions.values():
        for count in (None, *condition.counts):
            for name, seeds in condition.policies.items():
                place = (condition.name, str(count or "all"), name, str(len(seeds)))
                for metric, estimate in condition.scores_of(name, TRADEOFF, count).items():
                    ends = (estimate.mean, estimate.ci_low, estimate.ci_high)
                    numbers = (*(f"{value:.6g}" for value in ends), str(estimate.heaps))
                    rows.append((*place, metric, *numbers))
    return rows


def lead(experiment: Experiment) -> str:
    """Return what was scored on what, and what is missing."""
    parts = []
    for condition in experiment.conditions.values():
        heaps = max(len(one.heaps) for one in condition.scored)
        split = str(condition.scored[0].header["split"])
        kinds = f"{split} " if split != "all" else ""
        parts.append(f"{len(condition.policies)} policies on {heaps} {kinds}{condition.name} heaps")
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
    where = f" in {condition.name} heaps"
    scores = {
        name: condition.scores_of(name, (*METRICS, *GRASP_METRICS, *condition.terms))
        for name in condition.policies
    }
    by_count = {
        name: {count: condition.scores_of(name, COUNTED, count) for count in condition.counts}
        for name in condition.policies
    }
    facts = {
        "seeds": [str(len(seeds)) for seeds in condition.policies.values()],
        "heaps": [str(row[METRICS[0]].heaps) for row in scores.values()],
    }
    return [
        score_table(scores, f"Scores{where}", facts),
        *(count_table(by_count, metric, where) for metric in COUNTED),
        terms_table(scores, f"Reward terms{where}"),
    ]


def mode_table(condition: Condition) -> Table:
    """Return the share of each way to end [%] with Wilson intervals."""
    rows = []
    for name, seeds in condition.policies.items():
        found = [episode.mode for one in seeds for episode in one.modes]
        shares = [share_interval([float(f == mode) for f in found]) for mode in EPISODE_MODES]
        cells = [
            f"{100 * s.mean:.0f}\n{100 * s.ci_low:.0f} to {100 * s.ci_high:.0f}" for s in shares
        ]
        rows.append((name, str(len(found)), *cells))
    columns = ("policy", "episodes", *(f"{mode} [%]" for mode in EPISODE_MODES))
    caption = (
        f"How the episodes of {condition.name} heaps end, all training seeds together, with "
        "Wilson's 95 % intervals over episodes"
    )
    return Table(caption, columns, tuple(rows))


def made_table(condition: Condition) -> Table:
    """Return how each scored policy came about."""
    rows = []
    for name, seeds in condition.policies.items():
        rows.append(
            (
                name,
                ", ".join(str(one.seed) for one in seeds),
                _range([one.actions for one in seeds if one.trained]),
                _range([_tried(condition, one) for one in seeds]),
                _range([len(one.heaps) for one in seeds]),
                _range([len(one.header.get("quarantined", ())) for one in seeds]),
                ", ".join(map(str, seeds[0].header.get("keys", ()))),
            )
        )
    first = condition.scored[0].header
    facts = {
        "heap set": first.get("heap_set"),
        "objects": Path(str(first.get("object_set", ""))).name,
        "mechsearch": first.get("version"),
        "MuJoCo": first.get("engine"),
    }
    said = "; ".join(f"{key} {value}" for key, value in facts.items() if value)
    caption = f"{condition.name.capitalize()} heaps: {said}"
    return Table(caption, _MADE, tuple(rows), words=True, widths=_MADE_WIDTHS)


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


def _tried(condition: Condition, scored: ScoredPolicy) -> int:
    """Return how many actions were simulated to learn, and to plan while it was scored."""
    learnt = 0
    if scored.trained:
        runs = [run for run in condition.runs.get(scored.name, ()) if run.seed == scored.seed]
        fits = [record for run in runs for record in run.records.get("fit", ())]
        learnt = max((int(record["simulated"]) for record in fits), default=0)
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
