"""Filmstrips of one success and one episode of each failure mode (paper, Figures 1 and 6)."""

import io
from collections.abc import Mapping

from PIL import Image

from mechsearch.evaluation.episodes import load_episodes
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.filmstrip import Film, FilmConfig, filmstrip
from mechsearch.report.document import Block, Picture
from mechsearch.report.experiment import Condition, Trial
from mechsearch.report.failure_modes import BACK_AND_FORTH, HOVERING, SUCCESS

PICTURED = (SUCCESS, BACK_AND_FORTH, HOVERING)
_FRAMES, _SIZE = 4, 320


def mode_pictures(condition: Condition, models: Mapping[str, ObjectModel]) -> list[Block]:
    """Return a filmstrip of each mode that a policy which learnt shows, the method's if it does.

    The episode is chosen by rule: of the successes the median in reward, of the failures the one in
    which nothing moves for longest.
    """
    blocks: list[Block] = []
    for mode in PICTURED:
        found = chosen(condition, mode)
        if found:
            blocks.append(_picture(condition, mode, *found, models))
    return blocks


def chosen(condition: Condition, mode: str) -> tuple[Trial, int] | None:
    """Return a trial and the index of the heap that shows a mode; None if none does."""
    for trials in condition.trials.values():
        candidates = [
            (trial, i)
            for trial in trials
            if trial.trained
            for i, behaviour in enumerate(trial.behaviours)
            if behaviour.mode == mode
        ]
        if candidates and mode == SUCCESS:
            ranked = sorted(candidates, key=lambda one: float(one[0].values["reward"][one[1]]))
            return ranked[len(ranked) // 2]
        if candidates:
            return max(candidates, key=lambda one: one[0].behaviours[one[1]].stretch)
    return None


def _picture(
    condition: Condition, mode: str, trial: Trial, index: int, models: Mapping[str, ObjectModel]
) -> Picture:
    seed = int(trial.heaps[index])
    record = next(one for one in load_episodes(trial.path).episodes if one.heap_seed == seed)
    strip = filmstrip(Film(record, models, FilmConfig(size=_SIZE)), _FRAMES)
    first, last = record.occlusions[0], record.occlusions[-1]
    caption = (
        f"{mode.capitalize()}: {trial.name}, seed {trial.seed}, on {condition.name} heap {seed} of "
        f"{int(trial.counts[index])} objects, {first:.0%} to {last:.0%} hidden in "
        f"{len(record.actions)} actions"
    )
    if mode != SUCCESS:
        caption += f"; nothing moves for {trial.behaviours[index].stretch} actions in a row"
    return Picture(_encoded(strip), f"Frames of an episode. {caption}", f"{caption}.")


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
