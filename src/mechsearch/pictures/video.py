"""Films of recorded episodes: GIF with Pillow alone, MP4 with the `video` extra."""

import importlib.util
from pathlib import Path

import numpy as np
from PIL import Image

from mechsearch.files import write_whole
from mechsearch.pictures.filmstrip import Film
from mechsearch.types import Array, MechSearchError

FORMATS = (".gif", ".mp4")


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
    sheet = Image.new("RGB", (frames[0].width * 2, frames[0].height))
    sheet.paste(frames[0], (0, 0))
    sheet.paste(frames[-1], (frames[0].width, 0))
    palette = sheet.quantize(256, dither=Image.Dither.NONE)
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
