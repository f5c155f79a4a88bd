"""Recorded episodes as pictures and films: target green, path of the end effector blue.

Poses are rendered again, so a picture of any size can be made from the record alone. In retrieval
the gripper is in the picture while it grasps: open, where it was to close (`recorded`), or all the
way where the decisions are carried out again (`pictures.replay`). An arm is in a film as inverse
kinematics places it where the tip has been. Films are GIF with Pillow alone,
or MP4 with the `video` extra.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from mechsearch.camera import Camera, look_at, preset
from mechsearch.evaluation.episodes import IN_HAND, EpisodeRecord
from mechsearch.files import check_place, write_whole
from mechsearch.grippers import AnyGripper, Gripper, gripper_named
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import SMOOTHING, captioned, check_side, photographed, shrunk, tiled
from mechsearch.render.renderer import Renderer
from mechsearch.sim import (
    FREE,
    Pusher,
    arm_named,
    closed_gripper_model,
    gripper_models,
    links_of,
    open_parts,
    pusher_model,
    shown_at,
)
from mechsearch.types import (
    DECISION_NAMES,
    PUSH,
    USED_UP,
    Array,
    Floats,
    MechSearchError,
    Weighed,
    check_extra,
)

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
        parts: Poses (P, 7) of the rendered parts of an arm and its tool, or of all grippers while
            one grasps; None while the closed one pushes, or waits.
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


Weigh = Callable[
    [Mapping[str, Any], EpisodeRecord, Mapping[str, ObjectModel]], Sequence[Weighed | None]
]
"""Tells what a policy weighed, from an episode's header, its record and the objects."""


def nothing_known(*episode: Any) -> Sequence[Weighed | None]:
    """Return that nothing is known of what a policy weighed; see `Weigh`."""
    del episode
    return ()


class Hands:
    """The grippers of a robot, as films show them, and the arm that holds them, if one does."""

    def __init__(self, header: Mapping[str, Any]) -> None:
        """Take the grippers that an evaluation's header names."""
        self.names: tuple[str, ...] = tuple(header["env"]["grippers"])
        self.grippers: list[AnyGripper] = [gripper_named(name) for name in self.names]
        arm = arm_named(header["env"].get("robot", FREE))
        jaws = self.grippers[0]
        self._links = links_of(arm, jaws) if arm and isinstance(jaws, Gripper) else []
        counts = [len(gripper.places) for gripper in self.grippers]
        self._starts = np.cumsum([0, *counts]).tolist()

    @property
    def have_arm(self) -> bool:
        """Whether an arm holds them."""
        return bool(self._links)

    @property
    def models(self) -> list[ObjectModel]:
        """What is rendered of all of them."""
        return [
            model for gripper in self.grippers for model in gripper_models(gripper)
        ] + self._links

    def parts(self, number: int, poses: Floats) -> Floats:
        """Return the poses of all parts, those of one gripper given, the others out of sight."""
        parts = np.tile(OUT_OF_SIGHT, (self._starts[-1] + len(self._links), 1))
        parts[self._starts[number] :][: len(poses)] = poses
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
        words += end_said(record, step - 1) if step else ""
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
            words = f"{hands.title(record, step)}: {came_to(record, step)}{end_said(record, step)}"
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
    words = f"{hands.title(record, step)}: {said}{end_said(record, step)}"
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


def end_said(record: EpisodeRecord, step: int) -> str:
    """Return how the episode ended, to be said after an action, if that was the last."""
    return f", {record.end}" if record.end and step + 1 == len(record.actions) else ""


FORMATS = (".gif", ".mp4")
Models = Mapping[str, ObjectModel]
PATH_COLOUR = (28, 98, 235)


@dataclass(frozen=True)
class FilmConfig:
    """How frames look.

    Attributes:
        camera: Name of the view, "overhead" or "tilted"; empty takes the first for pushes alone,
            and for retrieval one from the side that shows what is lifted.
        size: Side of each frame [px].
        captions: Whether to write below each frame what happens.
    """

    camera: str = ""
    size: int = 288
    captions: bool = True

    def __post_init__(self) -> None:
        check_side(self.size)
        if self.camera:
            preset(self.camera)


class Film:
    """Draws the frames of one episode.

    Attributes:
        record: The episode.
        config: How frames look.
        moments: What there is to draw: of pushes the start, and the state after each action.
        bodies: The episode's objects, and after them what else the moments' `parts` place.
        pusher: What pushes, with its tip at the origin; None leaves it out.
    """

    def __init__(
        self,
        record: EpisodeRecord,
        models: Models,
        config: FilmConfig,
        pusher: ObjectModel | None = None,
        moments: Sequence[Moment] = (),
        parts: Sequence[ObjectModel] = (),
        with_arm: bool = False,
    ) -> None:
        """Prepare the objects of an episode.

        Args:
            record: The episode.
            models: Objects by name; those of the episode must be among them.
            config: How frames look.
            pusher: Mesh of what pushes with its tip at the origin; None leaves it out.
            moments: What there is to draw; by default the states of an episode of pushes.
            parts: What else their `parts` place.
            with_arm: Whether an arm is among that, for which the usual view is wider.

        Raises:
            MechSearchError: If an object of the episode is not among the models.
        """
        missing = sorted(set(record.objects) - models.keys())
        if missing:
            raise MechSearchError(
                f"the episode on heap {record.heap_seed} has objects that this set lacks: "
                f"{', '.join(missing)}; draw it with the object set it was recorded with"
            )
        self.record, self.config = record, config
        self.moments = tuple(moments or pushed(record))
        self.bodies = (*(models[name] for name in record.objects), *parts)
        self.pusher = pusher
        self._renderer = Renderer(self.bodies, pusher)
        size = config.size * SMOOTHING
        if config.camera or not (record.retrieval or parts):
            self._camera = preset(config.camera or "overhead", size)
        else:
            self._camera = _side_view(size, with_arm)

    @property
    def last(self) -> int:
        """Number of the last moment."""
        return len(self.moments) - 1

    def frame(self, number: int, until: int | None = None) -> Image.Image:
        """Return a moment, with the path of pushes.

        Args:
            number: Of the moment, from 0, the start; of pushes, of the actions before it.
            until: Action at which the path ends, 0 for none; by default the one that is shown, and
                after a grasp the path begins anew.
        """
        record, moment = self.record, self.moments[number]
        poses, pusher = self.placed(number)
        image = photographed(self._renderer, self._camera, poses, record.target, pusher)
        for path in path_at(record, moment) if until is None else _paths(record, until):
            draw_path(image, self._camera, path)
        small = shrunk(image, self.config.size)
        if not self.config.captions:
            return small
        return captioned(small, moment.words, text=max(11, self.config.size // 20))

    def placed(self, number: int) -> tuple[Floats, Floats | None]:
        """Return the poses of all bodies (B, 7) at a moment, and of what pushes (7,), if seen."""
        moment = self.moments[number]
        hidden = np.tile(OUT_OF_SIGHT, (len(self.bodies) - len(moment.poses), 1))
        parts = moment.parts if len(hidden) and moment.parts is not None else hidden
        tip = np.array([*self.record.ee_positions[moment.step], 1.0, 0.0, 0.0, 0.0])
        pushes = self.pusher is not None and moment.parts is None
        return np.concatenate([moment.poses, parts]), tip if pushes else None


def film_of(
    header: Mapping[str, Any],
    record: EpisodeRecord,
    models: Models,
    config: FilmConfig,
    robot: bool = False,
    play: Play = recorded,
) -> Film:
    """Return the film of an episode of either task.

    Args:
        header: Of the evaluation.
        record: The episode.
        models: Objects by name.
        config: How frames look.
        robot: Whether what pushes is in the picture; a gripper that grasps always is.
        play: Makes the moments of an episode of retrieval.

    Raises:
        MechSearchError: If an object of the episode is not among the models.
    """
    arm = arm_named(header.get("env", {}).get("robot", FREE)) if robot else None
    if arm is not None and record.retrieval is None:
        parts, places = shown_at(arm, Pusher(), record.ee_positions)
        moments = [
            replace(at, parts=place) for at, place in zip(pushed(record), places, strict=True)
        ]
        return Film(record, models, config, None, moments, parts, with_arm=True)
    if record.retrieval is None:
        return Film(record, models, config, pusher_model(Pusher()) if robot else None)
    hands = Hands(header)
    pusher = closed_gripper_model(hands.grippers[0]) if robot else None
    played = play(header, record, models)
    return Film(record, models, config, pusher, played, hands.models, hands.have_arm)


def _side_view(size: int, with_arm: bool = False) -> Camera:
    """Return a view from the side, wide enough for tall objects in the gripper, or for an arm."""
    eye, target = ((0.0, -0.62, 0.62), (0.0, 0.0, 0.1))
    if with_arm:
        eye, target = ((0.3, -1.35, 1.0), (-0.15, 0.0, 0.28))
    centre, focal = (size - 1) / 2, 1.4 * size
    return Camera(size, size, focal, focal, centre, centre, look_at(eye, target, (0, 0, 1)))


def path_at(record: EpisodeRecord, moment: Moment) -> list[Floats]:
    """Return the path of the pushes that go on at a moment, if they do."""
    over = record.retrieval and moment.step and record.actions[moment.step - 1, 0] != PUSH
    return [] if over or moment.parts is not None else _paths(record, moment.step)[-1:]


def _paths(record: EpisodeRecord, until: int) -> list[Floats]:
    """Return the positions (K, 3) of the end effector up to an action, of each row of pushes."""
    if record.retrieval is None:
        return [record.ee_positions[: until + 1]] if until else []
    pushing = groupby(range(until), lambda step: record.actions[step, 0] == PUSH)
    rows = [[*steps] for pushes, steps in pushing if pushes]
    return [record.ee_positions[row[0] : row[-1] + 2] for row in rows]


def start_and_end(*films: Film) -> Image.Image:
    """Return each start with the whole path, and the end, side by side (paper, Fig. 1)."""
    pairs = []
    for film in films:
        whole = len(film.record.actions)
        pairs.append(tiled([film.frame(0, until=whole), film.frame(film.last, until=0)], 2))
    return tiled(pairs, len(pairs), gap=18)


def filmstrip(film: Film, frames: int = 5) -> Image.Image:
    """Return `frames` moments spread evenly from start to end, each with the path so far.

    Of grasps they show what came of them, and the phases where there are not enough others.

    Raises:
        MechSearchError: If fewer than two frames are asked for.
    """
    for detail in range(FILMS_ALONE):
        listed = [n for n, moment in enumerate(film.moments) if moment.detail <= detail]
        if len(listed) >= frames:
            break
    shown = [listed[i] for i in frame_steps(len(listed) - 1, frames)]
    return tiled([film.frame(number) for number in shown], len(shown))


def frame_steps(last: int, frames: int) -> list[int]:
    """Return at most `frames` distinct steps from 0 to `last`, evenly spread."""
    if frames < 2:
        raise MechSearchError(f"a filmstrip of {frames} frames; expected at least 2")
    return sorted({round(step) for step in np.linspace(0, last, frames)})


def draw_path(image: Image.Image, camera: Camera, positions: Floats) -> None:
    """Draw positions (K, 3) [m] as a blue line with a ring at its start and a dot at its end."""
    points = [(float(x), float(y)) for x, y, _ in camera.project(positions)]
    draw = ImageDraw.Draw(image)
    unit = image.height / 288
    for colour, width in (("white", 5 * unit), (PATH_COLOUR, 3 * unit)):
        draw.line(points, fill=colour, width=round(width), joint="curve")
        for x, y in points:
            _dot(draw, x, y, width / 2, colour)
    _dot(draw, *points[0], 6 * unit, PATH_COLOUR)
    _dot(draw, *points[0], 3.5 * unit, "white")
    _dot(draw, *points[-1], 6.5 * unit, "white")
    _dot(draw, *points[-1], 5 * unit, PATH_COLOUR)


def _dot(
    draw: ImageDraw.ImageDraw, x: float, y: float, radius: float, colour: str | tuple[int, int, int]
) -> None:
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)


def write_film(
    path: Path,
    film: Film,
    rate: float = 6.0,
    progress: Callable[[str, int, int], object] = lambda *_: None,
) -> None:
    """Write an episode as GIF or MP4, whole or not at all; the last frame stays for a second.

    Args:
        path: Ends in .gif or .mp4.
        film: The episode.
        rate: Moments shown in a second.
        progress: Told after each frame.

    Raises:
        MechSearchError: As `check_film`.
    """
    check_film(path, rate)
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    write_whole(path, lambda partial: write(partial, _drawn(film, progress), rate))


def _drawn(film: Film, progress: Callable[[str, int, int], object]) -> Iterator[Image.Image]:
    for number in range(film.last + 1):
        yield film.frame(number)
        progress("frames", number + 1, film.last + 1)


def check_film(path: Path, rate: float = 6.0) -> None:
    """Refuse a film that cannot be written, before there is one.

    Raises:
        MechSearchError: If the format is unknown, the rate is out of range, or MP4 is asked for
            without the `video` extra.
    """
    check_place(path, FORMATS)
    if not 0.01 <= rate <= 100:
        raise MechSearchError(f"a film of {rate} moments a second; expected 0.01 to 100")
    if path.suffix.lower() == ".mp4":
        check_extra(f"{path} (as .gif it does not)", "video")


def _write_gif(path: Path, drawn: Iterator[Image.Image], rate: float) -> None:
    frames = list(drawn)
    # One palette for all frames, from the two that differ most: colours do not flicker.
    palette = tiled([frames[0], frames[-1]], 2, gap=0).quantize(256, dither=Image.Dither.NONE)
    reduced = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = round(1000 / rate)
    reduced[0].save(
        path,
        save_all=True,
        append_images=reduced[1:],
        duration=[duration] * (len(frames) - 1) + [duration + 1000],
        loop=0,
        disposal=1,
    )


def _write_mp4(path: Path, drawn: Iterator[Image.Image], rate: float) -> None:
    import imageio_ffmpeg

    frames = list(map(_even, drawn))
    first = frames[0]
    writer = imageio_ffmpeg.write_frames(
        str(path), (first.shape[1], first.shape[0]), fps=rate, macro_block_size=2, quality=8
    )
    writer.send(None)
    for frame in (*frames, *[frames[-1]] * max(1, round(rate))):
        writer.send(frame)
    writer.close()


def _even(image: Image.Image) -> Array:
    """Return the pixels without the last odd row or column, as the encoder needs."""
    return np.ascontiguousarray(np.asarray(image)[: image.height // 2 * 2, : image.width // 2 * 2])
