"""What a report holds: claims or comparisons, figures, scores, failures, and how it was made.

Pictures of episodes are chosen by rule, not by hand.
"""

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain

from matplotlib.figure import Figure
from PIL import Image

from mechsearch.evaluation.episodes import in_brief, in_words, load_episodes
from mechsearch.findings import analysis, failure_modes
from mechsearch.findings.analysis import Analysis
from mechsearch.findings.claims import Ruling, answer_table, overview_table
from mechsearch.findings.experiment import EVALUATIONS, VALIDATION, Condition, Experiment
from mechsearch.findings.failure_modes import BACK_AND_FORTH, HOVERING, SUCCESS
from mechsearch.findings.scores import RANKS, ScoredPolicy, ranked_heaps
from mechsearch.findings.tables import ATTEMPTS_NOTE, number
from mechsearch.pictures.film import (
    FilmConfig,
    Models,
    Play,
    Weigh,
    film_of,
    filmstrip,
    nothing_known,
    recorded,
    start_and_end,
)
from mechsearch.pictures.page import Shown, episode_page
from mechsearch.report import figures
from mechsearch.report.document import (
    Content,
    Document,
    PageBeside,
    Paragraph,
    Picture,
    Section,
)

SHOWN_MODES = (SUCCESS, BACK_AND_FORTH, HOVERING)
_FRAMES, _STRIP, _PAIR = 4, 320, 224

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


def document(
    found: Analysis,
    title: str,
    models: Mapping[str, Models] | None = None,
    play: Play = recorded,
    weigh: Weigh = nothing_known,
    progress: Callable[[str, int, int], object] = lambda *_: None,
) -> Document:
    """Return the whole report.

    Args:
        found: What the experiment says.
        title: At its head.
        models: Objects by name for each condition, to draw episodes; None leaves pictures out.
        play: Makes what is drawn of an episode of retrieval.
        weigh: Tells what a policy weighed in an episode.
        progress: Told before each section, and in the end.
    """
    experiment = found.experiment
    planned = experiment.plan is not None
    sections: dict[str, Iterator[Content]] = {}
    if planned:
        sections["What the paper claims"] = _rulings(found.paper, _CLAIMS_NOTE)
        sections["The same of the loss as printed"] = _rulings(found.as_printed)
        sections["What this project asks besides"] = _rulings(found.goals)
    else:
        sections["What beat what"] = _comparisons(found)
    if planned or experiment.runs:
        sections["Learning"] = _learning(experiment)
    conditions = experiment.conditions.values()
    sections["Actions used against clutter moved"] = _tradeoff(
        [c for c in conditions if not c.retrieves]
    )
    sections["Targets retrieved against clutter moved"] = _tradeoff(
        [c for c in conditions if c.retrieves]
    )
    sections["Scores"] = _scores(experiment)
    sections["How episodes end"] = _modes(experiment, models or {}, play)
    if models:
        pictures = iter(()) if planned else _episodes(experiment, models, play)
        sections["Episodes"] = chain(pictures, _pages(experiment, models, play, weigh))
    notes = (Paragraph(note, "note") for note in analysis.made_notes(experiment))
    tables = map(analysis.made_table, experiment.conditions.values())
    sections["How this was made"] = chain(tables, notes)
    filled = []
    for done, (name, blocks) in enumerate(sections.items()):
        progress(f"report, {name}", done, len(sections))
        filled.append(Section(name, list(blocks)))
    progress("report", len(sections), len(sections))
    return Document(title, analysis.lead(experiment), [one for one in filled if one.blocks])


def _rulings(rulings: Sequence[Ruling], note: str = "") -> Iterator[Content]:
    if rulings:
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
            yield Paragraph(f"In {comparison.heaps}:")
        verdict, *others = comparison.sentences
        yield Paragraph(verdict, "verdict")
        yield from map(Paragraph, others)
        yield analysis.comparison_table(comparison)
    yield Paragraph(_COMPARISONS_NOTE, "note")


def _drawn(figure: Figure, name: str, alt: str, caption: str) -> Picture:
    return Picture(figures.to_svg(figure), alt, caption, name)


def _learning(experiment: Experiment) -> Iterator[Content]:
    where = EVALUATIONS.get(experiment.scored_on, "")
    scored = f"Scored without noise or teachers on {where}." if where else "No run was recorded."
    note = (
        f"{scored} Thick: mean over training seeds; thin: each seed; band: Student's 95 % interval "
        "over seeds. "
    )
    if experiment.scored_on == VALIDATION:
        note += "Final scores, and policies that do not learn, are of other heaps: see the tables."
    else:
        note += (
            "Diamonds: final scores, and grey levels: policies that do not learn, both on the "
            "final heaps."
        )
    if experiment.plan is not None:
        figure = figures.draw_learning(experiment)
        alt = "Learning curves of four metrics"
        yield _drawn(figure, "learning", alt, f"Learning curves. {note}")
        yield _drawn(
            figures.draw_ablation(experiment),
            "ablation",
            "Learning curves of the method and its ablations",
            "The method, and what is left of it without teachers, without the asymmetry of actor "
            f"and critic, and with colour and label instead of the position image. {note}",
        )
        return
    if where:
        names = list(dict.fromkeys(run.name for run in experiment.runs))
        figure = figures.draw_curves(experiment, figures.RUN_METRICS, names, 2.5)
        alt = "Learning curves of the runs"
        yield _drawn(figure, "learning", alt, f"Evaluations during training. {note}")
    for run in experiment.runs:
        training = figures.draw_training(run)
        if training:
            caption = f"Training of {run.name}, seed {run.seed}."
            yield _drawn(training, f"training-{run.name}-seed{run.seed}", caption, caption)


def _tradeoff(conditions: Sequence[Condition]) -> Iterator[Content]:
    for condition in conditions:
        what = "Targets retrieved" if condition.retrieves else "Actions used"
        corner = "upper" if condition.retrieves else "lower"
        yield _drawn(
            figures.draw_tradeoff(condition),
            f"tradeoff-{condition.name}",
            f"{what} against clutter moved in {condition.heaps}",
            f"{condition.heaps.capitalize()}: the nearer to the {corner} left the better. "
            f"{_PANELS}",
        )


def _scores(experiment: Experiment) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        scores = {policy: [condition.scores_of(policy)] for policy in condition.policies}
        yield _drawn(
            figures.draw_scores(scores, condition.subjects),
            f"scores-{name}",
            f"Means and intervals of each policy in {condition.heaps}; the table has the numbers",
            f"{condition.heaps.capitalize()}: means with 95 % intervals.",
        )
        yield from analysis.score_tables(condition)
    yield Paragraph(analysis.SCORES_NOTE, "note")
    if any(condition.retrieves for condition in experiment.conditions.values()):
        yield Paragraph(ATTEMPTS_NOTE, "note")


def _modes(experiment: Experiment, models: Mapping[str, Models], play: Play) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        yield analysis.mode_table(condition)
        if name in models:
            yield from mode_pictures(condition, models[name], play)
    aims = {condition.retrieves for condition in experiment.conditions.values()}
    definitions = {False: failure_modes.DEFINITION, True: failure_modes.RETRIEVAL_DEFINITION}
    for aim in sorted(aims):
        opening = "In retrieval: " if aim and len(aims) > 1 else ""
        yield Paragraph(opening + definitions[aim], "note")


def _episodes(
    experiment: Experiment, models: Mapping[str, Models], play: Play
) -> Iterator[Content]:
    for name, condition in experiment.conditions.items():
        if name in models:
            kind = condition.scored[0].header["condition"]
            held = ", the target in the gripper if it was retrieved" if condition.retrieves else ""
            yield Paragraph(
                f"Three {kind} heaps, chosen by rank: where {condition.subjects[0]} had its "
                f"{', its '.join(RANKS[:-1])} and its {RANKS[-1]} reward. Of each pair, left: the "
                "start, with the visible part of the target in green and the path of the end "
                f"effector in blue, from ring to dot; right: the end{held}."
            )
            yield from ranked_pictures(condition, models[name], play)


def _pages(
    experiment: Experiment, models: Mapping[str, Models], play: Play, weigh: Weigh
) -> Iterator[PageBeside]:
    for name, condition in experiment.conditions.items():
        page = ranked_page(condition, models[name], play, weigh) if name in models else ""
        if page:
            what = f"{condition.subjects[0]} in {condition.heaps}"
            ranks = f"{', '.join(RANKS[:-1])} and {RANKS[-1]}"
            text = f"The {ranks} episode of {what}, in three dimensions"
            yield PageBeside(page, text, f"episodes-{name}")


def ranked_page(
    condition: Condition, models: Models, play: Play = recorded, weigh: Weigh = nothing_known
) -> str:
    """Return a page of the three episodes by which the first policy that learnt ranks heaps.

    It is empty where these episodes are not there.

    Args:
        condition: Whose policies are shown.
        models: Objects by name.
        play: Makes what is drawn of an episode of retrieval.
        weigh: Tells what a policy weighed in an episode.
    """
    chooser = condition.policies[condition.subjects[0]][0]
    if not chooser.path.exists():
        return ""
    heaps = ranked_heaps(chooser.heaps, chooser.values["reward"])
    evaluation = load_episodes(chooser.path)
    header = evaluation.header
    records = {record.heap_seed: record for record in evaluation.episodes}
    shown = {}
    for rank, heap in heaps.items():
        record = records[heap]
        film = film_of(header, record, models, FilmConfig(), True, play)
        words = f"heap {heap}: {in_brief(record)}"
        shown[rank] = Shown(film, words, weigh(header, record, models))
    return episode_page(f"{condition.subjects[0]} in {condition.heaps}", shown)


def shown_modes(condition: Condition) -> tuple[str, ...]:
    """Return what filmstrips show: success, and failures; of retrieval its two most common ones."""
    if not condition.retrieves:
        return SHOWN_MODES
    subjects = [one for name in condition.subjects for one in condition.policies[name]]
    modes = Counter(episode.mode for one in subjects for episode in one.modes)
    return SUCCESS, *[mode for mode, _ in modes.most_common() if mode != SUCCESS][:2]


def mode_pictures(condition: Condition, models: Models, play: Play = recorded) -> Iterator[Picture]:
    """Yield filmstrips of one success and one episode of each failure mode (paper, Fig. 1 and 6).

    Args:
        condition: Whose policies are shown: those that learnt, the first that has the mode.
        models: Objects by name.
        play: Makes what is drawn of an episode of retrieval.
    """
    for mode in shown_modes(condition):
        example = exemplary_episode(condition, mode)
        if example is None:
            continue
        scored, index = example
        seed = int(scored.heaps[index])
        record = next(one for one in load_episodes(scored.path).episodes if one.heap_seed == seed)
        caption = (
            f"{mode.capitalize()}: {scored.name}, seed {scored.seed}, on {record.condition} heap "
            f"{seed} of {int(scored.counts[index])} objects, {in_words(record)}"
        )
        if mode != SUCCESS and not condition.retrieves:
            caption += f"; nothing moves for {scored.modes[index].stretch} actions in a row"
        film = film_of(scored.header, record, models, FilmConfig(size=_STRIP), True, play)
        strip = filmstrip(film, _FRAMES)
        yield Picture(_encoded(strip), f"Frames of an episode. {caption}", f"{caption}.")


def exemplary_episode(condition: Condition, mode: str) -> tuple[ScoredPolicy, int] | None:
    """Return a policy and the index of the heap that shows a mode; None if no recorded one does.

    It is the median in reward; of failures to uncover the one in which nothing moves for longest.
    """
    for name in condition.subjects:
        candidates = [
            (scored, i)
            for scored in condition.policies[name]
            if scored.path.exists()
            for i, found in enumerate(scored.modes)
            if found.mode == mode
        ]
        if candidates and (mode == SUCCESS or condition.retrieves):
            ranked = sorted(candidates, key=lambda one: float(one[0].values["reward"][one[1]]))
            return ranked[len(ranked) // 2]
        if candidates:
            return max(candidates, key=lambda one: one[0].modes[one[1]].stretch)
    return None


def ranked_pictures(
    condition: Condition, models: Models, play: Play = recorded
) -> Iterator[Picture]:
    """Yield start and end of every policy on three heaps: the first that learnt ranks them.

    Args:
        condition: Whose policies are shown, the first seed of each whose episodes are there.
        models: Objects by name.
        play: Makes what is drawn of an episode of retrieval.
    """
    chooser = condition.policies[condition.subjects[0]][0]
    heaps = ranked_heaps(chooser.heaps, chooser.values["reward"])
    config = FilmConfig(size=_PAIR, captions=False)
    for name, seeds in condition.policies.items():
        files = [scored.path for scored in seeds if scored.path.exists()]
        if not files:
            continue
        evaluation = load_episodes(files[0])
        records = {record.heap_seed: record for record in evaluation.episodes}
        shown = {rank: records[heap] for rank, heap in heaps.items() if heap in records}
        films = [
            film_of(evaluation.header, record, models, config, play=play)
            for record in shown.values()
        ]
        caption = "; ".join(
            f"{rank}: {in_words(record)} ({record.end}), reward "
            f"{number('reward', float(record.rewards.sum()))}"
            for rank, record in shown.items()
        )
        if films:
            alt = f"Start and end of {len(films)} episodes. {name}: {caption}"
            yield Picture(_encoded(start_and_end(*films)), alt, f"{name}, {caption}.")


def _encoded(image: Image.Image) -> bytes:
    """Return an image as a PNG of 256 colours, a third of the size of a full one."""
    buffer = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
