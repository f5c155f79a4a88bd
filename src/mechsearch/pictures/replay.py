"""Films of grasps: the decisions of a recorded episode carried out again in the same physics."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from mechsearch.env import RetrieveConfig, RetrieveEnv, task_from_json
from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.heaps.dataset import Heap
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.pictures.film import (
    FILMS_ALONE,
    PHASES,
    Hands,
    Moment,
    came_to,
    first_moment,
    is_shown_after,
    moment_after,
    recorded,
)
from mechsearch.sim import LiftFrame

_EVERY = 6
"""Of the frames of a grasp, which are 20 ms apart, one in so many is shown."""

_SAME = 1e-3
"""Distance up to which an object lies where it was recorded [m]: machines differ by rounding."""

_SAID = {"lower": "put back", "open": "let go"}
_AFTER = ("lower", "open", "leave")


def replayed(
    header: Mapping[str, Any], record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> list[Moment]:
    """Return the moments of an episode of retrieval, grasps phase by phase; see `film.Play`.

    Where the physics takes another course than it was recorded, as it may on another machine, they
    are those of the record alone.
    """
    hands, env = Hands(header), _env(header, record, models)
    moments = [first_moment(record)]
    for step, action in enumerate(record.actions):
        film = env.film = []
        info = env.step(action)[4]
        there = np.abs(env.state.poses - record.poses[step + 1])[:, :3].max()
        if info["outcome"] != came_to(record, step) or (not info["failure"] and there > _SAME):
            return recorded(header, record, models)
        moments += _grasp(record, step, film, hands)
        if is_shown_after(record, step):
            moments.append(moment_after(record, step, hands))
    return moments


def _env(
    header: Mapping[str, Any], record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> RetrieveEnv:
    """Return the environment at the start of the episode."""
    heap = Heap(
        record.objects, record.poses[0], record.target, float(record.occlusions[0]),
        record.heap_seed, record.count, record.condition, held_out=True,
    )  # fmt: skip
    task = task_from_json(RetrieveConfig, header["env"])
    blind = replace(task, keys=("ee_position",), privileged=False)
    env = RetrieveEnv([heap], ObjectSet("recorded", models, {}), blind)
    env.reset(options={"heap": 0, "fixed_start": True})
    return env


def _grasp(
    record: EpisodeRecord, step: int, film: Sequence[LiftFrame], hands: Hands
) -> Iterator[Moment]:
    """Yield the moments of one grasp; until it descends nothing happens."""
    number, title, last = int(record.actions[step, 1]), hands.title(record, step), step + 1
    phases = [(phase, [*frames]) for phase, frames in groupby(film, lambda frame: frame.phase)]
    while phases and phases[0][0] != "descend":
        phases.pop(0)
    ends = last == len(record.actions)
    for (phase, frames), (following, _) in pairwise([*phases, ("", [])]):
        is_judged = phase not in _AFTER and following in ("", *_AFTER)
        for i, frame in enumerate(frames):
            is_last = i + 1 == len(frames)
            if not is_last and i % _EVERY:
                continue
            words = _SAID.get(phase, phase)
            if is_judged and is_last:
                words = came_to(record, step) + (f", {record.end}" if ends else "")
            detail = PHASES.get(phase, FILMS_ALONE) if is_last else FILMS_ALONE
            parts = hands.parts(number, frame.gripper)
            shown = 0 if is_judged and is_last else detail
            yield Moment(step, frame.poses, f"{title}: {words}", parts, shown)
