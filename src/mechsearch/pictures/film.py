"""Recorded episodes as pictures and films: target green, path of the end effector blue.

Poses are rendered again, so a picture of any size can be made from the record alone. Films are GIF
with Pillow alone, or MP4 with the `video` extra.
"""

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from mechsearch.camera import Camera, preset
from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.files import write_whole
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import SMOOTHING, captioned, photographed, shrunk, tiled
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array, Floats, MechSearchError

FORMATS = (".gif", ".mp4")
Models = Mapping[str, ObjectModel]
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
        models: Models,
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

    def frame(self, step: int, until: int | None = None) -> Image.Image:
        """Return the state after some actions, with a path of the end effector from the start.

        Args:
            step: From 0, the start, to T, the end.
            until: Step at which the path ends, 0 for none; by default the one that is shown.
        """
        record, last = self.record, len(self.record.actions)
        pose = np.array([*record.ee_positions[step], 1.0, 0.0, 0.0, 0.0])
        pusher = pose if self._pusher else None
        image = photographed(
            self._renderer, self._camera, record.poses[step], record.target, pusher
        )
        path = record.ee_positions[: (step if until is None else until) + 1]
        if len(path) > 1:
            draw_path(image, self._camera, path)
        small = shrunk(image, self.config.size)
        if not self.config.captions:
            return small
        words = f"{step} action{'s' if step > 1 else ''}" if step else "start"
        words += f": {record.occlusions[step]:.0%} hidden"
        words += f", {record.end}" if 0 < step == last else ""
        return captioned(small, words, text=max(11, self.config.size // 20))


def start_and_end(*films: Film) -> Image.Image:
    """Return each start with the whole path, and the end, side by side (paper, Fig. 1)."""
    pairs = []
    for film in films:
        last = len(film.record.actions)
        pairs.append(tiled([film.frame(0, until=last), film.frame(last, until=0)], 2))
    return tiled(pairs, len(pairs), gap=18)


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


def write_film(path: Path, film: Film, rate: float = 6.0) -> None:
    """Write an episode as GIF or MP4, whole or not at all; the last frame stays for a second.

    Args:
        path: Ends in .gif or .mp4.
        film: The episode.
        rate: Actions shown in a second.

    Raises:
        MechSearchError: If the format is unknown, the rate is not positive, or MP4 is asked for
            without the `video` extra.
    """
    if rate <= 0:
        raise MechSearchError(f"a film of {rate} actions a second; expected more than 0")
    if path.suffix == ".gif":
        write_whole(path, lambda partial: _write_gif(partial, film, rate))
    elif path.suffix == ".mp4":
        if importlib.util.find_spec("imageio_ffmpeg") is None:
            raise MechSearchError(
                f"writing {path} needs the video extra: install mechsearch[video], or choose .gif"
            )
        write_whole(path, lambda partial: _write_mp4(partial, film, rate))
    else:
        raise MechSearchError(
            f"unknown film format {path.suffix!r}; choose one of {', '.join(FORMATS)}"
        )


def _write_gif(path: Path, film: Film, rate: float) -> None:
    last = len(film.record.actions)
    frames = [film.frame(step) for step in range(last + 1)]
    # One palette for all frames, from the two that differ most: colours do not flicker.
    palette = tiled([frames[0], frames[-1]], 2, gap=0).quantize(256, dither=Image.Dither.NONE)
    reduced = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = round(1000 / rate)
    reduced[0].save(
        path,
        save_all=True,
        append_images=reduced[1:],
        duration=[duration] * last + [duration + 1000],
        loop=0,
        disposal=1,
    )


def _write_mp4(path: Path, film: Film, rate: float) -> None:
    import imageio_ffmpeg

    last = len(film.record.actions)
    steps = [*range(last + 1), *[last] * max(1, round(rate))]
    first = _even(film.frame(0))
    writer = imageio_ffmpeg.write_frames(
        str(path), (first.shape[1], first.shape[0]), fps=rate, macro_block_size=2, quality=8
    )
    writer.send(None)
    for step in steps:
        writer.send(_even(film.frame(step)))
    writer.close()


def _even(image: Image.Image) -> Array:
    """Return the pixels without the last odd row or column, as the encoder needs."""
    return np.ascontiguousarray(np.asarray(image)[: image.height // 2 * 2, : image.width // 2 * 2])
