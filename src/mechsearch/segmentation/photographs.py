"""Reference views from a user's own photographs, each with a mask, kept in one file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from mechsearch.files import read_arrays, write_whole
from mechsearch.grasp.image_files import read_stored, target_pixels
from mechsearch.segmentation.reference import SIDE, References, cut_out
from mechsearch.types import MechSearchError

_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_MASK = "-mask"
_PURPOSE = "file of reference views"


def views_of_photographs(paths: Sequence[Path], pixel: float = 0.0) -> References:
    """Return the reference views that photographs are.

    A photograph's mask is what is not transparent in it, or a picture beside it: `cup-mask.png` of
    `cup.jpg`, black but for the object.

    Args:
        paths: Photographs, and folders of them.
        pixel: Side of a pixel at the object [m], the same in all; 0 where it is not known.

    Raises:
        MechSearchError: If there is no photograph, one has no mask, an empty or tiny one or one of
            another size, or a file is no picture; the file is named.
    """
    if not 0 <= pixel < np.inf:
        raise MechSearchError(f"the side of a pixel is {pixel} m; expected a positive number, or 0")
    photographs = [photograph for path in paths for photograph in _photographs(path)]
    if not photographs:
        given = ", ".join(map(str, paths)) or "nothing"
        raise MechSearchError(
            f"no photograph in {given}; expected pictures ({', '.join(_SUFFIXES)})"
        )
    views = []
    for path in photographs:
        rgb, mask = _view(path)
        try:
            views.append(cut_out([rgb], [mask], [pixel] if pixel else None))
        except MechSearchError as error:
            raise MechSearchError(f"{path}: {error}") from None
    names = ("rgb", "mask", "width")
    return References(*(np.concatenate([getattr(v, name) for v in views]) for name in names))


def save_references(path: Path, references: References) -> None:
    """Write reference views (.npz), whole or not at all."""
    write_whole(path, lambda to: np.savez_compressed(to, allow_pickle=False, **vars(references)))


def load_references(path: Path) -> References:
    """Read reference views.

    Raises:
        MechSearchError: If the file is missing, damaged or holds none.
    """
    found = read_arrays(path, _PURPOSE)
    count = len(found["width"]) if "width" in found and found["width"].ndim == 1 else 0
    expected = {
        "rgb": f"{(count, SIDE, SIDE, 3)} of uint8", "mask": f"{(count, SIDE, SIDE)} of bool",
        "width": f"{(count,)} of float32",
    }  # fmt: skip
    kinds = {name: f"{array.shape} of {array.dtype}" for name, array in found.items()}
    if not count or kinds != expected:
        held = ", ".join(f"{name} {kind}" for name, kind in kinds.items()) or "nothing"
        raise MechSearchError(
            f"{path} holds {held}; expected what `mechsearch segment reference` writes"
        )
    return References(**found)


def _photographs(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return sorted(
        file for file in path.iterdir()
        if file.suffix.lower() in _SUFFIXES and not file.stem.endswith(_MASK)
    )  # fmt: skip


def _view(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return a photograph's colours (H, W, 3) and its mask (H, W)."""
    stored = read_stored(path, "photograph")
    if not isinstance(stored, Image.Image):
        raise MechSearchError(f"{path} is no picture; expected one of {', '.join(_SUFFIXES)}")
    # As it is shown: telephones note how they were held.
    picture = ImageOps.exif_transpose(stored)
    beside = [
        path.with_name(f"{path.stem}{_MASK}{suffix}")
        for suffix in dict.fromkeys((*_SUFFIXES, path.suffix))
    ]
    masks = [file for file in beside if file.is_file()]
    if masks:
        mask = read_stored(masks[0], "mask")
        if isinstance(mask, dict):
            raise MechSearchError(f"{masks[0]} is no picture; expected a mask")
        try:
            inside = target_pixels(mask)
        except MechSearchError as error:
            raise MechSearchError(f"{masks[0]}: {error}") from None
    else:
        alpha = np.asarray(picture.convert("RGBA"))[..., 3]
        if (alpha == 255).all():
            raise MechSearchError(
                f"{path} has no mask; expected {beside[0].name} beside it, black but for the "
                "object, or all else transparent in the photograph"
            )
        inside = alpha >= 128
    return np.asarray(picture.convert("RGB")), inside
