"""A user's own depth image, mask and camera, checked and made fit for the grasp networks."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mechsearch.camera import Camera
from mechsearch.grasp.camera_files import camera_of, read_camera
from mechsearch.grasp.image_files import Stored, depth_in_metres, read_stored, target_pixels
from mechsearch.grippers import NETWORK_OPENING, GraspView, surroundings
from mechsearch.observe.observation import without_holes
from mechsearch.types import Array, MechSearchError

_WIDTH_PX = (23.0, 34.5, 46.0)
"""Width of a 5 cm gripper at the target [px]: between the outer ones the released network's scores
were found steady; the middle one is that 0.8 m below the metric camera."""

_LEAST_WIDTH_PX = 11.5
"""Below this there is too little to resize."""

_NEAREST = 0.05
"""Least median of what a camera shows [m]; smaller numbers are no metres."""

_AROUND = 0.2
"""How far from the target the table is looked for [m]."""

_HEAP = 0.3
"""A target lies no higher above the table [m]."""

_STRAY = 0.01
"""What lies farther beyond the table, or in front of the target, is not believed [m]."""


def read_view(
    depth: Path,
    mask: Path | None = None,
    intrinsics: Path | None = None,
    scale: float = 1.0,
    label: int | None = None,
) -> tuple[GraspView, Camera]:
    """Return the view that files hold, and the camera as it is there; see `view_of_image`.

    Args:
        depth: Depth image: NPY, a picture such as a 16-bit PNG, or NPZ with an array `depth`, and
            perhaps `mask` and a camera.
        mask: The target: NPY, a picture, or NPZ with an array `mask`; None takes it from the
            depth's NPZ.
        intrinsics: The camera, see `read_camera`; None takes it from the depth's NPZ.
        scale: Metres for one unit of the depth image, 0.001 for millimetres.
        label: The target's value in a mask of several.

    Raises:
        MechSearchError: If a file is missing or damaged, lacks something, or what it holds is
            refused.
    """
    stored = read_stored(depth, "depth image")
    metres = depth_in_metres(_named(stored, "depth", depth), scale)
    shown = read_stored(mask, "mask") if mask else _whole(stored, "mask", depth)
    inside = target_pixels(_named(shown, "mask", mask or depth), label)
    if intrinsics:
        camera = read_camera(intrinsics, metres.shape)
    else:
        camera = camera_of(_whole(stored, "intrinsics", depth), metres.shape, str(depth))
    return view_of_image(metres, inside, camera), camera


def view_of_image(
    depth: Stored, mask: Stored, camera: Camera, label: int | None = None
) -> GraspView:
    """Return a user's depth image, checked, filled, and resized where the networks need it.

    Holes are filled as `observe.observation.without_holes` does, and are no part of the target. The
    table is that around the target. What seems to be beyond it, or much nearer than the target,
    takes the depth of the nearest other pixel, with a warning. The view's camera tells whether the
    image was resized; a grasp's `pose` is in the same world as before.

    Args:
        depth: (H, W) [m]; see `depth_in_metres`.
        mask: The target (H, W); see `target_pixels`.
        camera: Its size must be the image's.
        label: The target's value in a mask of several.

    Raises:
        MechSearchError: If sizes differ, depths are no metres, half of the image is holes, no pixel
            of the target is visible, or the target is too far for the networks.
    """
    metres, inside = depth_in_metres(depth), target_pixels(mask, label)
    if inside.shape != metres.shape:
        raise MechSearchError(f"the mask is {inside.shape}, the depth image {metres.shape}")
    if (camera.height, camera.width) != metres.shape:
        raise MechSearchError(
            f"the depth image is {metres.shape}, but the intrinsics are for "
            f"{(camera.height, camera.width)}"
        )
    seen = np.isfinite(metres) & (metres > 0)
    metres = np.asarray(without_holes(metres, "the depth image"), np.float32)
    if (middle := float(np.median(metres))) < _NEAREST:
        raise MechSearchError(
            f"the median depth is {middle:.3g}; expected metres, at least {_NEAREST}"
        )
    inside = inside & seen
    _check_visible(inside)
    width = camera.fx * NETWORK_OPENING[0] / float(np.median(metres[inside]))
    if width < _LEAST_WIDTH_PX:
        raise MechSearchError(
            f"at the target 5 cm are {width:.1f} px; expected at least {_LEAST_WIDTH_PX}, so bring "
            "an image from nearer or with more pixels"
        )
    if not _WIDTH_PX[0] <= width <= _WIDTH_PX[2]:
        camera = _in_scale(camera, _WIDTH_PX[1] / width)
        metres, inside, seen = (_resized(image, camera) for image in (metres, inside, seen))
        _check_visible(inside)
    far = _table(metres, inside, seen, camera)
    metres = _believed(metres, inside, seen, far)
    return GraspView(metres, inside, camera, far)


def _check_visible(inside: Array) -> None:
    if not inside.any():
        raise MechSearchError("the mask has no pixel with a depth: no target is visible")


def _in_scale(camera: Camera, factor: float) -> Camera:
    """Return the camera of an image with so many times the pixels each way."""
    height, width = (max(round(side * factor), 1) for side in (camera.height, camera.width))
    return camera.resized(height, width)


def _resized(image: Array, camera: Camera) -> Array:
    """Return an image in a camera's size; depths on both sides of an edge are not mixed."""
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(np.intp)
        for new, old in zip((camera.height, camera.width), image.shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def _ends(depths: Array) -> tuple[float, float]:
    """Return the least and the greatest of depths, but for 1% and for three of them."""
    ordered = np.sort(depths)
    left = min(max(len(ordered) // 100, 3), (len(ordered) - 1) // 2)
    return float(ordered[left]), float(ordered[-1 - left])


def _table(metres: Array, inside: Array, seen: Array, camera: Camera) -> float:
    """Return the depth of the surface that things around the target stand on [m]."""
    middle = float(np.median(metres[inside]))
    part = surroundings(inside, int(_AROUND * camera.fx / middle))
    depths = metres[part][seen[part]]
    depths = depths[depths <= middle + _HEAP]
    _, last = _ends(depths)
    return float(np.median(depths[np.abs(depths - last) <= _STRAY]))


def _believed(
    metres: NDArray[np.float32], inside: Array, seen: Array, far: float
) -> NDArray[np.float32]:
    """Return depths without those that are beyond the table, or much nearer than the target."""
    near, _ = _ends(metres[inside])
    deep, close = seen & (metres > far + _STRAY), inside & (metres < near - _STRAY)
    if not (deep | close).any():
        return metres
    said = []
    if deep.any():
        last = metres[deep].max()
        said.append(f"{deep.sum()} deeper than the table at {far:.3f} m, down to {last:.3f} m")
    if close.any():
        first = metres[close].min()
        said.append(
            f"{close.sum()} of the mask above the target at {near:.3f} m, up to {first:.3f} m"
        )
    warnings.warn(
        f"pixels not believed: {', and '.join(said)}; they take the depth of the nearest other one",
        stacklevel=3,
    )
    # Holes may have been filled from such pixels.
    nearest = distance_transform_edt(
        deep | close | ~seen, return_distances=False, return_indices=True
    )
    return np.asarray(metres[tuple(nearest)])


def _whole(stored: Stored | dict[str, Array], what: str, path: Path) -> dict[str, Array]:
    """Return the arrays of an NPZ that a mask or a camera is taken from."""
    if not isinstance(stored, dict):
        raise MechSearchError(f"{path} holds a depth image alone; name a file for the {what} too")
    return stored


def _named(stored: Stored | dict[str, Array], name: str, path: Path) -> Stored:
    """Return an image by name where a file has several arrays."""
    if not isinstance(stored, dict):
        return stored
    if name not in stored:
        raise MechSearchError(f"{path} has no array {name!r}; it has {', '.join(stored)}")
    return stored[name]
