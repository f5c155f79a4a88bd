"""The report of a folder of experiments: claims, figures, scores and failures, from files alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mechsearch.files.fingerprint import mixed
from mechsearch.objects.model import ObjectModel
from mechsearch.report import claims, failure_modes, learning, tradeoff
from mechsearch.report.curves import EVALUATIONS
from mechsearch.report.document import Block, Document, Grid, Paragraph, Picture, Section
from mechsearch.report.experiment import Condition, Experiment
from mechsearch.report.experiment_tables import (
    NOTE,
    count_grid,
    made_grid,
    plan_text,
    score_grid,
)
from mechsearch.report.figures import to_svg
from mechsearch.report.mode_pictures import mode_pictures
from mechsearch.report.tables import Table

_OVERVIEW_WIDTHS = (64, 15, 24)
_DETAIL_WIDTHS = (22, 44, 15, 27)
_NOTE = Paragraph(claims.NOTE, note=True)
_PANELS = (
    "One panel for all heaps and one for each number of objects in a heap. Bars: 95 % intervals."
)


@dataclass(frozen=True)
class Analysis:
    """What an experiment says.

    Attributes:
        experiment: What was measured.
        paper: The paper's claims with their verdicts.
        goals: The project's own.
        figures: SVG of every figure by a name for its file.
    """

    experiment: Experiment
    paper: Sequence[claims.Ruling]
    goals: Sequence[claims.Ruling]
    figures: Mapping[str, str]


def analyse(experiment: Experiment) -> Analysis:
    """Return claims and figures of an experiment."""
    drawn = {
        "learning": learning.draw_learning(experiment),
        "ablation": learning.draw_ablation(experiment),
    }
    for condition in experiment.conditions.values():
        drawn[f"tradeoff-{condition.name}"] = tradeoff.draw_tradeoff(condition)
    return Analysis(
        experiment,
        claims.rule(claims.PAPER, experiment),
        claims.rule(claims.GOALS, experiment),
        {name: to_svg(figure) for name, figure in drawn.items()},
    )


def document(
    analysis: Analysis,
    title: str,
    models: Mapping[str, Mapping[str, ObjectModel]] | None = None,
) -> Document:
    """Return the whole report.

    Args:
        analysis: What was found.
        title: At its head.
        models: Objects by name for each condition, to draw episodes; None leaves pictures out.
    """
    experiment = analysis.experiment
    sections = [
        Section("What the paper claims", [*_rulings(analysis.paper), _NOTE]),
        Section("What this project asks besides", _rulings(analysis.goals)),
        Section("Learning", _learning(analysis)),
        Section("Actions used against clutter moved", _tradeoff(analysis)),
        Section("Scores", _scores(experiment)),
        Section("How episodes end", _modes(experiment, models)),
        Section("How this was made", _made(experiment)),
    ]
    return Document(title, lead(experiment), sections)


def numbers(analysis: Analysis) -> dict[str, list[tuple[str, ...]]]:
    """Return rows behind claims and figures, by a name for their file; headings first."""
    return {
        "claims": claims.as_rows((*analysis.paper, *analysis.goals)),
        "learning": learning.curve_rows(analysis.experiment),
        "tradeoff": tradeoff.tradeoff_rows(analysis.experiment),
    }


def lead(experiment: Experiment) -> str:
    """Return the first paragraph: what was scored on what, and what is missing."""
    parts = []
    for condition in experiment.conditions.values():
        trials = [trial for found in condition.trials.values() for trial in found]
        heaps = max(len(trial.heaps) for trial in trials)
        split = str(trials[0].header["split"])
        kinds = f"{split} " if split != "all" else ""
        parts.append(f"{len(condition.trials)} policies on {heaps} {kinds}{condition.name} heaps")
    text = f"{' and '.join(parts)}, all from the same starts.{_training(experiment)}"
    if experiment.missing:
        some = ", ".join(experiment.missing[:12])
        more = len(experiment.missing) - 12
        text += f" Planned and not scored yet: {some}{f' and {more} more' if more > 0 else ''}."
    return text


def _training(experiment: Experiment) -> str:
    actions = [
        trial.actions
        for condition in experiment.conditions.values()
        for trials in condition.trials.values()
        for trial in trials
        if trial.trained
    ]
    if not actions:
        return ""
    least, most = min(actions), max(actions)
    number = f"{most:,}" if least == most else f"{least:,} to {most:,}"
    return f" Those that learnt executed {number} actions in training."


def _rulings(rulings: Sequence[claims.Ruling]) -> list[Block]:
    overview, marks = claims.overview(rulings)
    blocks: list[Block] = [Grid(overview, marks, True, _OVERVIEW_WIDTHS)]
    for ruling in rulings:
        table, marks = claims.detail(ruling)
        blocks.append(Grid(table, marks, True, _DETAIL_WIDTHS))
    return blocks


def _learning(analysis: Analysis) -> list[Block]:
    kind = learning.scored_on(analysis.experiment)
    where = EVALUATIONS.get(kind, "")
    scored = f"Scored without noise or teachers on {where}." if where else "No run was recorded."
    both = (
        f"{scored} Thick: mean over training seeds; thin: each seed; band: Student's 95 % interval "
        "over seeds. Diamonds: final scores, and grey levels: policies that do not learn, both on "
        "the final heaps."
    )
    return [
        Picture(
            analysis.figures["learning"],
            "Learning curves of four metrics",
            f"Learning curves. {both}",
        ),
        Picture(
            analysis.figures["ablation"],
            "Learning curves of the method and its ablations",
            "The method, and what is left of it without teachers, without the asymmetry of actor "
            f"and critic, and with colour and label instead of the position image. {both}",
        ),
    ]


def _tradeoff(analysis: Analysis) -> list[Block]:
    return [
        Picture(
            analysis.figures[f"tradeoff-{name}"],
            f"Actions used against clutter moved in {name} heaps",
            f"{name.capitalize()} heaps: the nearer to the lower left the better. {_PANELS}",
        )
        for name in analysis.experiment.conditions
    ]


def _scores(experiment: Experiment) -> list[Block]:
    blocks: list[Block] = []
    for condition in experiment.conditions.values():
        blocks.append(score_grid(condition))
        blocks += [
            count_grid(condition, metric)
            for metric in ("reward", "visibility_change", "uncovered_rate")
        ]
    return [*blocks, Paragraph(NOTE, note=True)]


def _modes(
    experiment: Experiment, models: Mapping[str, Mapping[str, ObjectModel]] | None
) -> list[Block]:
    blocks: list[Block] = []
    for condition in experiment.conditions.values():
        blocks.append(Grid(_mode_table(condition)))
        if models is not None and condition.name in models:
            blocks += mode_pictures(condition, models[condition.name])
    return [*blocks, Paragraph(failure_modes.definition(), note=True)]


def _mode_table(condition: Condition) -> Table:
    modes = {
        name: [behaviour.mode for trial in trials for behaviour in trial.behaviours]
        for name, trials in condition.trials.items()
    }
    caption = (
        f"How the episodes of {condition.name} heaps end, all training seeds together, with "
        "Wilson's 95 % intervals over episodes"
    )
    return failure_modes.mode_table(modes, caption)


def _made(experiment: Experiment) -> list[Block]:
    blocks: list[Block] = [made_grid(c) for c in experiment.conditions.values()]
    found = {
        f"{condition.name} {trial.name}, seed {trial.seed}": trial.header.get("fingerprint", {})
        for condition in experiment.conditions.values()
        for trials in condition.trials.values()
        for trial in trials
    }
    crossings = [Paragraph(text) for text in mixed(found)]
    return [*blocks, *crossings, Paragraph(plan_text(experiment), note=True)]
