"""Instants of an episode, of which a film is made: after each push, and all through a grasp.

`recorded` makes them of the record alone: a grasp is the open gripper where it was to close.
`pictures.replay` makes them by carrying the decisions out again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mechsearch.evaluation.episodes import IN_HAND, EpisodeRecord
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.gripper import AnyGripper, gripper_named, open_parts
from mechsearch.types import DECISION_NAMES, PUSH, USED_UP, Floats

PHASES = {"close": 1, "lift": 2, "descend": 2}
"""Phases of a grasp whose ends a filmstrip shows where it has the room, and from which detail."""

FILMS_ALONE = 3
"""Detail of what no filmstrip shows."""

OUT_OF_SIGHT = np.array([0.0, 0.0, 50.0, 1.0, 0.0, 0.0, 0.0])
"""Pose (7,) where nothing is seen."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One instant.

    Attributes:
        step: Actions carried out so far.
        poses: Of all objects (N, 7).
        words: What happens.
        parts: Poses (P, 7) of the rendered parts of all grippers while one grasps; None while the
            closed one pushes, or waits.
        detail: From which on a filmstrip shows it: 0 what came of actions, `PHASES` in turn, and
            above these films alone.
    """

    step: int
    poses: Floats
    words: str
    parts: Floats | None = None
    detail: int = 0


Play = Callable[[Mapping[str, Any], EpisodeRecord, Mapping[str, ObjectModel]], Sequence[Moment]]
"""Makes the moments of an episode of retrieval, from its header, its record and the objects."""


class Hands:
    """The grippers of a robot, as films show them."""

    def __init__(self, header: Mapping[str, Any]) -> None:
        """Take the grippers that an evaluation's header names."""
        self.names: tuple[str, ...] = tuple(header["env"]["grippers"])
        self.grippers: list[AnyGripper] = [gripper_named(name) for name in self.names]
        counts = [len(gripper.places) for gripper in self.grippers]
        self._starts = np.cumsum([0, *counts]).tolist()

    @property
    def models(self) -> list[ObjectModel]:
        """What is rendered of all of them."""
        return [model for gripper in self.grippers for model in gripper.models()]

    def parts(self, number: int, poses: Floats) -> Floats:
        """Return the poses of all parts, those of one gripper given, the others out of sight."""
        parts = np.tile(OUT_OF_SIGHT, (self._starts[-1], 1))
        parts[self._starts[number] : self._starts[number + 1]] = poses
        return parts

    def open_at(self, number: int, pose: Floats) -> Floats:
        """Return the poses of all parts, one gripper being open at a grasp (7,)."""
        return self.parts(number, open_parts(self.grippers[number], pose))

    def title(self, record: EpisodeRecord, step: int) -> str:
        """Return what an action is called, such as "grasp 2", with the gripper if there are two."""
        kinds = record.actions[:, 0].astype(int)
        kind, gripper = int(kinds[step]), int(record.actions[step, 1])
        title = f"{DECISION_NAMES[kind]} {int((kinds[: step + 1] == kind).sum())}"
        return title if kind == PUSH or len(self.names) == 1 else f"{title}, {self.names[gripper]}"


def pushed(record: EpisodeRecord) -> Iterator[Moment]:
    """Yield the states of an episode of pushes."""
    last = len(record.actions)
    for step in range(last + 1):
        words = f"{step} action{'s' if step > 1 else ''}" if step else "start"
        words += f": {record.occlusions[step]:.0%} hidden"
        words += f", {record.end}" if 0 < step == last else ""
        yield Moment(step, record.poses[step], words)


def recorded(
    header: Mapping[str, Any], record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> list[Moment]:
    """Return the moments of an episode of retrieval, from its record alone; see `Play`."""
    del models
    hands = Hands(header)
    moments = [first_moment(record)]
    for step, action in enumerate(record.actions):
        if came_to(record, step) not in ("", USED_UP):
            parts = hands.open_at(int(action[1]), np.asarray(action[2:], np.float64))
            words = f"{hands.title(record, step)}: {came_to(record, step)}{_end(record, step)}"
            moments.append(Moment(step, record.poses[step], words, parts))
        if is_shown_after(record, step):
            moments.append(moment_after(record, step, hands))
    return moments


def first_moment(record: EpisodeRecord) -> Moment:
    """Return the start of an episode."""
    return Moment(0, record.poses[0], f"start: {record.occlusions[0]:.0%} hidden")


def moment_after(record: EpisodeRecord, step: int, hands: Hands) -> Moment:
    """Return the moment at which an action is over."""
    hidden = f"{record.occlusions[step + 1]:.0%} hidden"
    said = "none left" if came_to(record, step) == USED_UP else hidden
    words = f"{hands.title(record, step)}: {said}{_end(record, step)}"
    # Of pushes in a row a filmstrip shows the last.
    kinds = record.actions[step : step + 2, 0].tolist()
    shown = kinds[0] == PUSH and kinds != [PUSH, PUSH]
    return Moment(step + 1, record.poses[step + 1], words, detail=0 if shown else FILMS_ALONE)


def is_shown_after(record: EpisodeRecord, step: int) -> bool:
    """Return whether there is anything to see when an action is over: not the target in hand."""
    return step + 1 < len(record.actions) or record.end != IN_HAND


def came_to(record: EpisodeRecord, step: int) -> str:
    """Return what an action of retrieval came to; see `RetrieveEnv`."""
    assert record.retrieval is not None
    return record.retrieval.outcomes[step]


def _end(record: EpisodeRecord, step: int) -> str:
    return f", {record.end}" if step + 1 == len(record.actions) else ""
