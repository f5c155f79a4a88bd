"""Depth images and masks as people keep them: what a file or an array shows, or why it is none."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, UnidentifiedImageError

from mechsearch.files import ARRAY_DAMAGE, read_arrays
from mechsearch.types import Array, MechSearchError

Stored = Array | Image.Image
"""An image as its file holds it: an array, or a picture whose mode and palette count too."""

_KINDS = {"1": "a black and white", "L": "an 8-bit grey", "P": "a palette"}
_PACKED = np.array([1 << 16, 1 << 8, 1])
"""Makes one number of red, green and blue."""


def read_stored(path: Path, name: str) -> Stored | dict[str, Array]:
    """Read a picture, an NPY, or the arrays of an NPZ; its first bytes tell which it is.

    Raises:
        MechSearchError: If the file is missing, damaged or neither; `name` is what it should hold.
    """
    if not path.is_file():
        raise MechSearchError(f"no {name} at {path}")
    try:
        with path.open("rb") as file:
            head = file.read(6)
        if head.startswith(b"PK"):
            return read_arrays(path, name)
        if head == b"\x93NUMPY":
            return np.asarray(np.load(path, allow_pickle=False))
        with Image.open(path) as image:
            if _is_deep_colour(image):
                return _deep_colour(path)
            image.load()
            return image
    except (*ARRAY_DAMAGE, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise MechSearchError(
            f"the {name} at {path} is damaged, or no picture, NPY or NPZ: {error}"
        ) from None


def depth_in_metres(stored: Stored, scale: float = 1.0) -> NDArray[np.float32]:
    """Return a depth image (H, W) [m].

    Args:
        stored: (H, W), or with one more axis of length 1: floats, or integers of 16 bits or more;
            three equal channels of 16 bits too.
        scale: Metres for one unit.

    Raises:
        MechSearchError: If it is none, or a depth is negative.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise MechSearchError(f"the depth scale is {scale}; expected a positive number of metres")
    kept = "expected 16-bit grey, a float TIFF, or an NPY of metres or millimetres"
    if isinstance(stored, Image.Image):
        if not stored.mode.startswith(("I", "F")):
            kind = f"{_KINDS.get(stored.mode, f'a colour ({stored.mode})')} {stored.format}"
            raise MechSearchError(
                f"the depth image is {kind} picture, which keeps no depth; {kept}"
            )
        stored = np.asarray(stored)
    array = np.asarray(stored)
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype == np.uint16:
        if (array != array[..., :1]).any():
            raise MechSearchError(f"the depth image is in colour, which is no depth; {kept}")
        array = array[..., :1]
    array = _flat("depth image", array)
    if array.dtype.kind not in "uif" or array.dtype.itemsize < 2:
        raise MechSearchError(f"the depth image is of {array.dtype}, which keeps no depth; {kept}")
    if (negative := int((array < 0).sum())) > 0:
        raise MechSearchError(
            f"{negative} pixels of the depth image are negative, down to {np.nanmin(array):g}; "
            "expected the distance along the optical axis, and 0 or NaN where it is not known"
        )
    return array.astype(np.float32) * np.float32(scale)


def target_pixels(stored: Stored, label: int | None = None) -> NDArray[np.bool_]:
    """Return where a mask shows the target (H, W).

    A mask has one value beside its background, which is 0, black, transparent, -1 or NaN; or it has
    probabilities from 0 to 1, of which those from 0.5 on count; or it is white on black with soft
    edges. Of pictures the visible colours count.

    Args:
        stored: (H, W), or with one more axis of length 1; uint8 with 2 to 4 channels is a picture.
        label: The target's value, where there are several; of a palette its index.

    Raises:
        MechSearchError: If it could mean several things.
    """
    array = stored if isinstance(stored, Image.Image) else np.asarray(stored)
    if isinstance(array, Image.Image):
        array = _shown(array, label)
    elif array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] in (2, 3, 4):
        array = _shown(Image.fromarray(array), label)
    values = _flat("mask", array)
    if values.dtype.kind not in "buif":
        raise MechSearchError(f"the mask is of {values.dtype}; expected numbers or bool")
    found = np.unique(values[~np.isnan(values)]).astype(np.float64)
    if label is not None:
        if label not in found:
            raise MechSearchError(f"no pixel of the mask is {label}; it holds {_listed(found)}")
        return np.asarray(values == label)
    whole = bool((found == np.round(found)).all())
    inside: Array | None = None
    if not (found != 0).any():
        inside = np.zeros(values.shape, np.bool_)
    elif not whole and found[0] >= 0 and found[-1] <= 1:
        inside = values >= 0.5
    elif found[-1] > 0 and found[:-1].tolist() in ([], [0], [-1]):
        inside = values == found[-1]
    elif _is_soft(values, found):
        inside = values >= 128
    if inside is not None and not inside.all():
        return inside
    expected = "expected 0 where the target is not and one value where it is, or probabilities"
    if inside is not None or len(found) == 1:
        expected = "so it would be the whole image; expected 0 where the target is not"
    elif whole:
        expected = "choose the target's by --label"
    elif found[0] < 0:
        expected += "; those of logits x are 1 / (1 + exp(-x))"
    raise MechSearchError(f"the mask holds {_listed(found)}; {expected}")


def _shown(picture: Image.Image, label: int | None) -> Array:
    """Return what a person sees on a mask (H, W): greys as they are, else where one colour is.

    Of a palette with several colours it is the indices.
    """
    if picture.mode.startswith(("1", "I", "F")):
        return np.asarray(picture)
    try:
        seen = np.asarray(picture.convert("RGBA"))
    except ValueError as error:
        raise MechSearchError(f"the mask is a picture of mode {picture.mode}: {error}") from None
    colours, opaque = seen[..., :3], seen[..., 3] >= 128
    codes = colours @ _PACKED
    found = np.unique(codes[opaque])
    background = not opaque.all()
    if picture.mode == "P" and (label is not None or len(found) + background > 2):
        return np.asarray(picture)
    if not background and (colours == colours[..., :1]).all():
        grey: Array = seen[..., 0]
        # No labels outlive JPEG, so near black is black, and near white is white.
        lossy = picture.format == "JPEG" and ((grey < 64) | (grey >= 192)).mean() > 0.9
        return grey >= 128 if lossy else grey
    # A cut-out photograph has many colours, and what is left of it is the target.
    if not len(found) or (background and len(found) > 256):
        return np.asarray(opaque)
    others = found[found != 0] if (found != 0).any() else found
    if len(others) == 1 and (background or len(found) == 2):
        return np.asarray(opaque & (codes == others[0]))
    listed = ", ".join(f"#{code:06x}" for code in found[:8].tolist())
    raise MechSearchError(
        f"the mask shows {len(found)} colours, {listed}{', ...' * (len(found) > 8)}; expected one, "
        "on black or on nothing"
    )


def _is_soft(values: Array, found: Array) -> bool:
    """Return whether a mask is white on black, with edges blurred by resizing or by JPEG."""
    white, middle = int((values >= 247).sum()), int(((values > 8) & (values < 247)).sum())
    edges = bool(((found > 64) & (found < 192)).any())
    return found[0] >= 0 and found[-1] <= 255 and len(found) > 8 and edges and middle < white


def _listed(found: Array) -> str:
    """Return the values of a mask in words."""
    if len(found) == 1:
        return f"{found[0]:g} alone"
    if len(found) <= 12:
        return "the values " + ", ".join(f"{value:g}" for value in found.tolist())
    return f"{len(found)} values from {found[0]:g} to {found[-1]:g}"


def _flat(name: str, array: Array) -> Array:
    if array.ndim == 3 and 1 in (array.shape[0], array.shape[2]):
        array = array[..., 0] if array.shape[2] == 1 else array[0]
    if array.ndim != 2:
        raise MechSearchError(f"the {name} has shape {array.shape}; expected (H, W)")
    return array


def _is_deep_colour(image: ImageFile.ImageFile) -> bool:
    """Return whether a PNG has colours of 16 bits, of which Pillow keeps eight."""
    return image.format == "PNG" and image.tile[0][3] == "RGB;16B"


def _deep_colour(path: Path) -> Array:
    """Return the colours (H, W, 3) uint16 of such a PNG: its high bytes, then its low ones."""
    parts = []
    for order in ("RGB;16B", "RGB;16L"):
        with Image.open(path) as image:
            image.tile = [image.tile[0]._replace(args=order)]
            parts.append(np.asarray(image).astype(np.uint16))
    return parts[0] << 8 | parts[1]
