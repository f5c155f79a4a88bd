"""What a report holds: claims or comparisons, figures, scores, failures, and how it was made."""

from collections.abc import Iterator, Mapping, Sequence

from matplotlib.figure import Figure

from mechsearch.findings import analysis, failure_modes
from mechsearch.findings.analysis import Analysis
from mechsearch.findings.claims import Ruling, answer_table, overview_table
from mechsearch.findings.comparisons import comparison_table
from mechsearch.findings.experiment import Experiment
from mechsearch.findings.runs import EVALUATIONS
from mechsearch.objects.model import ObjectModel
from mechsearch.report import learning
from mechsearch.report.document import Content, Document, Paragraph, Picture, Section
from mechsearch.report.episodes import mode_pictures, ranked_pictures, ranking_text
from mechsearch.report.figures import draw_scores, draw_tradeoff, to_svg

Models = Mapping[str, Mapping[str, ObjectModel]]

_CLAIMS_NOTE = (
    "Every row compares one number with a threshold. It holds if the whole 95 % interval lies on "
    "the claimed side, does not hold if it lies on the other, and is undecided if it contains the "
    "threshold. Intervals come from a bootstrap that draws training seeds and heaps, each by "
    "itself, and is widened for small numbers of either; policies in one condition are paired heap "
    "by heap. A claim holds if all its rows hold, and fails if one of them does. Idle and random "
    "stand for the untrained policy."
)
_COMPARISONS_NOTE = (
    "Differences are paired heap by heap, with 95 % intervals of a bootstrap over training seeds "
    "and heaps (heaps alone where there is one seed), for each comparison by itself: among many "
    "comparisons some intervals miss the truth. “No clear difference” means that the interval "
    "holds zero, not that two policies are alike."
)
_PANELS = (
    "One panel for all heaps and one for each number of objects in a heap. Bars: 95 % intervals."
)


def document(found: Analysis, title: str, models: Models | None = None) -> Document:
    """Return the whole report.

    Args:
        found: What the experiment says.
        title: At its head.
        models: Objects by name for each condition, to draw episodes; None leaves pictures out.
    """
    experiment = found.experiment
    sections: dict[str, Iterator[Content]] = {}
    if experiment.plan is not None:
        sections["What the paper claims"] = _rulings(found.paper, _CLAIMS_NOTE)
        sections["What this project asks besides"] = _rulings(found.goals)
    else:
        sections["What beat what"] = _comparisons(found)
    if experiment.plan is not None:
        sections["Learning"] = _learning(experiment)
    elif experiment.runs:
        sections["Learning"] = _runs(experiment)
    sections["Actions used against clutter moved"] = _tradeoff(experiment)
    sections["Scores"] = _scores(experiment)
    sections["How episodes end"] = _modes(experiment, models or {})
    if models and experiment.plan is None:
        sections["Episodes"] = _episodes(experiment, models)
    sections["How this was made"] = _made(experiment)
    return Document(
        title,
        analysis.lead(experiment),
        [Section(name, list(blocks)) for name, blocks in sections.items()],
    )


def _rulings(rulings: Sequence[Ruling], note: str = "") -> Iterator[Content]:
    yield overview_table(rulings)
    yield from map(answer_table, rulings)
    if note:
        yield Paragraph(note, "note")


def _comparisons(found: Analysis) -> Iterator[Content]:
    several = len(found.experiment.conditions) > 1
    for comparison in found.comparisons:
        if not comparison.against:
            yield Paragraph("A single policy has nothing to be compared with.")
            continue
        if several:
            yield Paragraph(f"In {comparison.condition} heaps:")
        verdict, *others = comparison.sentences
        yield Paragraph(verdict, "verdict")
        yield from map(Paragraph, others)
        yield comparison_table(comparison)
    yield Paragraph(_COMPARISONS_NOTE, "note")


def _drawn(figure: Figure, name: str, alt: str, caption: str) -> Picture:
    return Picture(to_svg(figure), alt, caption, name)


def _scored_on(experiment: Experiment) -> str:
    where = EVALUATIONS.get(experiment.scored_on, "")
    scored = f"Scored without noise or teachers on {where}." if where else "No run was recorded."
    return (
        f"{scored} Thick: mean over training seeds; thin: each seed; band: Student's 95 % interval "
        "over seeds. Diamonds: final scores, and grey levels: policies that do not learn, both on "
        "the final heaps."
    )


def _learning(experiment: Experiment) -> Iterator[Content]:
    both = _scored_on(experiment)
    yield _drawn(
        learning.draw_learning(experiment),
        "learning",
        "Learning curves of four metrics",
        f"Learning curves. {both}",
    )
    yield _drawn(
        learning.draw_ablation(experiment),
        "ablation",
        "Learning curves of the method and its ablations",
        "The method, and what is left of it without teachers, without the asymmetry of actor "
        f"and critic, and with colour and label instead of the position image. {both}",
    )


def _runs(experiment: Experiment) -> Iterator[Content]:
    if experiment.scored_on:
        names = list(dict.fromkeys(run.name for run in experiment.runs))
        yield _drawn(
            learning.draw_curves(experiment, learning.RUN_METRICS, names, 2.5),
            "learning",
            "Learning curves of the runs",
            f"Evaluations during training. {_scored_on(experiment)}",
        )
    for run in experiment.runs:
        figure = learning.draw_training(run)
        if figure:
            caption = f"Training of {run.name}, seed {run.seed}."
            yield _drawn(figure, f"training-{run.name}-seed{run.seed}", caption, caption)


def _tradeoff(experiment: Experiment) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        yield _drawn(
            draw_tradeoff(condition),
            f"tradeoff-{name}",
            f"Actions used against clutter moved in {name} heaps",
            f"{name.capitalize()} heaps: the nearer to the lower left the better. {_PANELS}",
        )


def _scores(experiment: Experiment) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        scores = {policy: [condition.scores_of(policy)] for policy in condition.policies}
        yield _drawn(
            draw_scores(scores, condition.subjects),
            f"scores-{name}",
            f"Means and intervals of each policy in {name} heaps; the table has the numbers",
            f"{name.capitalize()} heaps: means with 95 % intervals.",
        )
        yield from analysis.score_tables(condition)
    yield Paragraph(analysis.SCORES_NOTE, "note")


def _modes(experiment: Experiment, models: Models) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        yield analysis.mode_table(condition)
        if name in models:
            yield from mode_pictures(condition, models[name])
    yield Paragraph(failure_modes.definition(), "note")


def _episodes(experiment: Experiment, models: Models) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        if name in models:
            yield Paragraph(ranking_text(condition))
            yield from ranked_pictures(condition, models[name])


def _made(experiment: Experiment) -> Iterator[Content]:
    yield from map(analysis.made_table, experiment.conditions.values())
    for note in analysis.made_notes(experiment):
        yield Paragraph(note, "note")
