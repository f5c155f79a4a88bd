"""Pictures of recorded episodes: target green, path of the end effector blue (paper, Fig. 1).

Poses are rendered again, so a picture of any size can be made from the record alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from mechsearch.camera import Camera, preset
from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import SMOOTHING, captioned, shrunk, tiled, tinted
from mechsearch.render.renderer import Renderer
from mechsearch.types import Floats, MechSearchError

PATH_COLOUR = (28, 98, 235)


@dataclass(frozen=True)
class FilmConfig:
    """How frames look.

    Attributes:
        camera: Name of the view, "overhead" or "tilted".
        size: Side of each frame [px].
        captions: Whether to write below each frame how much of the target is hidden.
    """

    camera: str = "overhead"
    size: int = 288
    captions: bool = True


class Film:
    """Draws the frames of one episode."""

    def __init__(
        self,
        record: EpisodeRecord,
        models: Mapping[str, ObjectModel],
        config: FilmConfig,
        pusher: ObjectModel | None = None,
    ) -> None:
        """Prepare the objects of an episode.

        Args:
            record: The episode.
            models: Objects by name; those of the episode must be among them.
            config: How frames look.
            pusher: Mesh of the end effector with its tip at the origin; None leaves it out.

        Raises:
            MechSearchError: If an object of the episode is not among the models.
        """
        missing = sorted(set(record.objects) - models.keys())
        if missing:
            raise MechSearchError(
                f"the episode on heap {record.heap_seed} has objects that this set lacks: "
                f"{', '.join(missing)}; draw it with the object set it was recorded with"
            )
        self.record = record
        self.config = config
        self._renderer = Renderer([models[name] for name in record.objects], pusher)
        self._pusher = pusher is not None
        self._camera = preset(config.camera, config.size * SMOOTHING)

    def frame(self, step: int, path: bool = True) -> Image.Image:
        """Return the state after `step` actions, with the path that led there.

        Args:
            step: From 0, the start, to T, the end.
            path: Whether to draw the end effector's path up to then.
        """
        return self._finished(self._painted(step, step if path else 0), self._caption(step))

    def start_with_path(self) -> Image.Image:
        """Return the start with the whole path that is to come, as the paper's Fig. 1 has it."""
        return self._finished(self._painted(0, len(self.record.actions)), self._caption(0))

    def _painted(self, step: int, until: int) -> Image.Image:
        tip = self.record.ee_positions[step]
        frame = self._renderer.frame(
            self._camera,
            self.record.poses[step],
            np.array([*tip, 1.0, 0.0, 0.0, 0.0]) if self._pusher else None,
            colour=True,
        )
        assert frame.rgb is not None
        image = Image.fromarray(tinted(frame.rgb, frame.modal(self.record.target)))
        if until:
            draw_path(image, self._camera, self.record.ee_positions[: until + 1])
        return image

    def _caption(self, step: int) -> str:
        hidden = f"{self.record.occlusions[step]:.0%} hidden"
        last = len(self.record.actions)
        if step == 0:
            return f"start: {hidden}"
        actions = f"{step} action{'s' if step > 1 else ''}"
        return f"{actions}: {hidden}" + (f", {self.record.end}" if step == last else "")

    def _finished(self, image: Image.Image, caption: str) -> Image.Image:
        size = self.config.size
        small = shrunk(image, size)
        return (
            captioned(small, caption, text=max(11, size // 20)) if self.config.captions else small
        )


def start_and_end(film: Film) -> Image.Image:
    """Return the start with the whole path, and the end, side by side (paper, Fig. 1)."""
    last = len(film.record.actions)
    return tiled([film.start_with_path(), film.frame(last, path=False)], 2)


def filmstrip(film: Film, frames: int = 5) -> Image.Image:
    """Return `frames` states spread evenly from start to end, each with the path so far.

    Raises:
        MechSearchError: If fewer than two frames are asked for.
    """
    steps = frame_steps(len(film.record.actions), frames)
    return tiled([film.frame(step) for step in steps], len(steps))


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
