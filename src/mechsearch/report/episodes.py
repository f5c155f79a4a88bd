"""Pictures of episodes that are chosen by rule, not by hand."""

import io
from collections.abc import Iterator, Mapping

from PIL import Image

from mechsearch.evaluation.episodes import load_episodes
from mechsearch.findings.experiment import Condition
from mechsearch.findings.failure_modes import BACK_AND_FORTH, HOVERING, SUCCESS
from mechsearch.findings.scores import RANKS, ScoredPolicy, ranked_heaps
from mechsearch.findings.tables import number
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import tiled
from mechsearch.pictures.filmstrip import Film, FilmConfig, filmstrip, start_and_end
from mechsearch.report.document import Picture

SHOWN_MODES = (SUCCESS, BACK_AND_FORTH, HOVERING)
_FRAMES, _STRIP, _PAIR = 4, 320, 224


def mode_pictures(condition: Condition, models: Mapping[str, ObjectModel]) -> Iterator[Picture]:
    """Yield filmstrips of one success and one episode of each failure mode (paper, Fig. 1 and 6).

    Args:
        condition: Whose policies are shown: those that learnt, the first that has the mode.
        models: Objects by name.
    """
    for mode in SHOWN_MODES:
        example = exemplary_episode(condition, mode)
        if example is None:
            continue
        scored, index = example
        seed = int(scored.heaps[index])
        record = next(one for one in load_episodes(scored.path).episodes if one.heap_seed == seed)
        caption = (
            f"{mode.capitalize()}: {scored.name}, seed {scored.seed}, on {condition.name} heap "
            f"{seed} of {int(scored.counts[index])} objects, {record.occlusions[0]:.0%} to "
            f"{record.occlusions[-1]:.0%} hidden in {len(record.actions)} actions"
        )
        if mode != SUCCESS:
            caption += f"; nothing moves for {scored.modes[index].stretch} actions in a row"
        strip = filmstrip(Film(record, models, FilmConfig(size=_STRIP)), _FRAMES)
        yield Picture(_encoded(strip), f"Frames of an episode. {caption}", f"{caption}.")


def exemplary_episode(condition: Condition, mode: str) -> tuple[ScoredPolicy, int] | None:
    """Return a policy and the index of the heap that shows a mode; None if no recorded one does.

    Of the successes it is the median in reward, of the failures the one in which nothing moves for
    longest.
    """
    for name in condition.subjects:
        candidates = [
            (scored, i)
            for scored in condition.policies[name]
            if scored.path.exists()
            for i, found in enumerate(scored.modes)
            if found.mode == mode
        ]
        if candidates and mode == SUCCESS:
            ranked = sorted(candidates, key=lambda one: float(one[0].values["reward"][one[1]]))
            return ranked[len(ranked) // 2]
        if candidates:
            return max(candidates, key=lambda one: one[0].modes[one[1]].stretch)
    return None


def ranked_pictures(condition: Condition, models: Mapping[str, ObjectModel]) -> Iterator[Picture]:
    """Yield start and end of every policy on three heaps: the first that learnt ranks them.

    Args:
        condition: Whose policies are shown, of each the first seed that has its episodes.
        models: Objects by name.
    """
    chooser = condition.policies[condition.subjects[0]][0]
    heaps = ranked_heaps(chooser.heaps, chooser.values["reward"])
    config = FilmConfig(size=_PAIR, captions=False)
    for name, seeds in condition.policies.items():
        files = [scored.path for scored in seeds if scored.path.exists()]
        if not files:
            continue
        records = {record.heap_seed: record for record in load_episodes(files[0]).episodes}
        shown = {rank: records[heap] for rank, heap in heaps.items() if heap in records}
        pairs = [start_and_end(Film(record, models, config)) for record in shown.values()]
        caption = "; ".join(
            f"{rank}: {record.occlusions[0]:.0%} to {record.occlusions[-1]:.0%} hidden in "
            f"{len(record.actions)} actions ({record.end}), reward "
            f"{number('reward', float(record.rewards.sum()))}"
            for rank, record in shown.items()
        )
        if pairs:
            alt = f"Start and end of {len(pairs)} episodes. {name}: {caption}"
            yield Picture(_encoded(tiled(pairs, len(pairs), gap=18)), alt, f"{name}, {caption}.")


def ranking_text(condition: Condition) -> str:
    """Return in words what `ranked_pictures` shows."""
    return (
        f"Three {condition.name} heaps, chosen by rank: where {condition.subjects[0]} had its "
        f"{', its '.join(RANKS[:-1])} and its {RANKS[-1]} reward. Of each pair, left: the start, "
        "with the visible part of the target in green and the path of the end effector in blue, "
        "from ring to dot; right: the end."
    )


def _encoded(image: Image.Image) -> bytes:
    """Return an image as a PNG of 256 colours, a third of the size of a full one."""
    buffer = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
