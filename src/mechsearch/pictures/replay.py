"""Films of grasps: the decisions of a recorded episode carried out again in the same physics."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any

from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.evaluation.frames import is_near
from mechsearch.evaluation.rollout import RetrieveEnv, begun_again
from mechsearch.evaluation.rollout import weighed_again as weighed_again
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.film import (
    FILMS_ALONE,
    PHASES,
    Hands,
    Moment,
    came_to,
    end_said,
    first_moment,
    is_shown_after,
    moment_after,
    recorded,
)
from mechsearch.sim import LiftFrame

_EVERY = 6
"""Of the frames of a grasp, which are 20 ms apart, one in so many is shown."""

_SAID = {"lower": "put back", "open": "let go", "carry": "to the tray"}
_AFTER = ("lower", "open", "carry", "leave")


def replayed(
    header: Mapping[str, Any], record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> list[Moment]:
    """Return the moments of an episode of retrieval, grasps phase by phase; see `film.Play`.

    Where the physics takes another course than it was recorded, as it may on another machine, they
    are those of the record alone.
    """
    hands, (env, _) = Hands(header), begun_again(header, record, models, ("ee_position",))
    assert isinstance(env, RetrieveEnv)
    moments = [first_moment(record)]
    for step, action in enumerate(record.actions):
        film = env.film = []
        info = env.step(action)[4]
        there = info["failure"] or is_near(env.state.poses, record.poses[step + 1])
        if info["outcome"] != came_to(record, step) or not there:
            return recorded(header, record, models)
        moments += carried_out(record, step, film, hands)
    return moments


def carried_out(
    record: EpisodeRecord, step: int, film: Sequence[LiftFrame], hands: Hands
) -> Iterator[Moment]:
    """Yield the moments of a decision of retrieval, of which `film` has the grasp."""
    yield from _grasp(record, step, film, hands)
    if is_shown_after(record, step):
        yield moment_after(record, step, hands)


def _grasp(
    record: EpisodeRecord, step: int, film: Sequence[LiftFrame], hands: Hands
) -> Iterator[Moment]:
    """Yield the moments of one grasp; until it descends nothing happens."""
    number, title = int(record.actions[step, 1]), hands.title(record, step)
    phases = [(phase, [*frames]) for phase, frames in groupby(film, lambda frame: frame.phase)]
    while phases and phases[0][0] != "descend":
        phases.pop(0)
    for (phase, frames), (following, _) in pairwise([*phases, ("", [])]):
        is_judged = phase not in _AFTER and following in ("", *_AFTER)
        for i, frame in enumerate(frames):
            is_last = i + 1 == len(frames)
            if not is_last and i % _EVERY:
                continue
            words = _SAID.get(phase, phase)
            if is_judged and is_last:
                words = came_to(record, step) + end_said(record, step)
            detail = PHASES.get(phase, FILMS_ALONE) if is_last else FILMS_ALONE
            parts = hands.parts(number, frame.gripper)
            shown = 0 if is_judged and is_last else detail
            yield Moment(step, frame.poses, f"{title}: {words}", parts, shown)
