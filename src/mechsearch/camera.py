"""A pinhole camera as data: project points, back-project pixels.

The camera frame is x right, y down, z forward. Pixel (row 0, column 0) has its centre at (0, 0),
and depth is measured along z, not along the ray.
"""

import re
from dataclasses import dataclass
from functools import lru_cache, reduce
from math import cos, inf, isfinite, radians, sin, tan
from operator import add

import numpy as np
from numpy.typing import ArrayLike

from mechsearch.geometry import apply, invert
from mechsearch.types import Floats, MechSearchError


@dataclass(frozen=True)
class Camera:
    """Intrinsics [px] and pose of a pinhole camera.

    Attributes:
        width: Image width [px].
        height: Image height [px].
        fx: Focal length along columns [px].
        fy: Focal length along rows [px].
        cx: Principal point, column [px].
        cy: Principal point, row [px].
        world_from_camera: Rigid transform, row by row, 16 numbers.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: tuple[float, ...]

    def __post_init__(self) -> None:
        # What is not a number is not positive either.
        if not (self.width >= 1 and self.height >= 1 and 0 < self.fx < inf and 0 < self.fy < inf):
            raise MechSearchError(
                f"a camera needs a positive size and focal length, not {self.width} x "
                f"{self.height} px with fx {self.fx}, fy {self.fy}"
            )
        if not (isfinite(self.cx) and isfinite(self.cy)):
            raise MechSearchError(
                f"a camera's principal point is finite, not cx {self.cx}, cy {self.cy}"
            )
        if len(self.world_from_camera) != 16:
            raise MechSearchError(
                f"world_from_camera has {len(self.world_from_camera)} numbers; expected 16 (4 x 4)"
            )
        pose = self.pose
        across = pose[:3, :3] @ pose[:3, :3].T
        if not (
            np.isfinite(pose).all()
            and pose[3].tolist() == [0, 0, 0, 1]
            and np.abs(across - np.eye(3)).max() < 1e-3
            and np.linalg.det(pose[:3, :3]) > 0
        ):
            raise MechSearchError(
                f"world_from_camera is {self.world_from_camera}; expected a rigid transform (4 x 4)"
            )

    @property
    def pose(self) -> Floats:
        """The transform (4, 4) from camera to world coordinates."""
        return np.array(self.world_from_camera).reshape(4, 4)

    def project(self, points: ArrayLike) -> Floats:
        """Return (column, row, depth) (..., 3) [px, px, m] of points in the world (..., 3)."""
        local = apply(invert(self.pose), points)
        z = local[..., 2]
        return np.stack(
            [self.fx * local[..., 0] / z + self.cx, self.fy * local[..., 1] / z + self.cy, z], -1
        )

    def project_level(self, x: Floats, y: Floats, height: float) -> tuple[Floats, Floats]:
        """Return (column, row) (...) [px] of points of one height [m]; see `project`."""
        # What is times 0, much of it where a camera looks straight down, is left out.
        across, down, z = (
            reduce(add, [f * term for f, term in zip(row, (x, y, height, 1.0), strict=True) if f])
            for row in invert(self.pose)[:3]
        )
        return self.fx * across / z + self.cx, self.fy * down / z + self.cy

    def back_project(self, depth: ArrayLike) -> Floats:
        """Return the world point (H, W, 3) [m] that each pixel of a depth image (H, W) shows."""
        z = np.asarray(depth, dtype=np.float64)
        if z.shape != (self.height, self.width):
            raise MechSearchError(
                f"the depth image is {z.shape}; this camera's is {(self.height, self.width)}"
            )
        return apply(self.pose, self.directions() * z[..., None])

    def points_at(self, columns: ArrayLike, rows: ArrayLike, depths: ArrayLike) -> Floats:
        """Return the world points (..., 3) [m] at places (...,) [px] and depths (...,) [m]."""
        u, v = np.asarray(columns, np.float64), np.asarray(rows, np.float64)
        rays = np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones(u.shape)], -1)
        return apply(self.pose, rays * np.asarray(depths, np.float64)[..., None])

    def directions(self) -> Floats:
        """Return each pixel's ray (H, W, 3) in the camera frame, scaled so that z is 1."""
        columns, rows = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack(
            [
                (columns - self.cx) / self.fx,
                (rows - self.cy) / self.fy,
                np.ones((self.height, self.width)),
            ],
            -1,
        )

    def resized(self, size: int, width: int | None = None) -> "Camera":
        """Return the same view on an image whose height is `size` [px], and its width in scale."""
        scale = size / self.height
        columns = round(self.width * scale) if width is None else width
        across = scale if width is None else width / self.width
        return Camera(
            columns,
            size,
            self.fx * across,
            self.fy * scale,
            (self.cx + 0.5) * across - 0.5,
            (self.cy + 0.5) * scale - 0.5,
            self.world_from_camera,
        )


def edge_step(depth: Floats, camera: Camera) -> Floats:
    """Return the least difference in depth between neighbours that is an edge (H, W) [m].

    It is more than 5 mm, and than that of a surface of slope 2 against the image plane, about 63
    degrees.
    """
    return 0.005 + 2.0 * depth / camera.fx


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> tuple[float, ...]:
    """Return world_from_camera (16 numbers) of a camera at `eye` [m] that looks at `target`."""
    position = np.asarray(eye, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = position
    return tuple(float(value) for value in matrix.ravel())


def _preset(eye: tuple[float, float, float], up: tuple[float, float, float]) -> Camera:
    size, focal = 64, 92.0
    centre = (size - 1) / 2
    return Camera(size, size, focal, focal, centre, centre, look_at(eye, (0, 0, 0), up))


VIEWS = {
    "overhead": _preset((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "tilted": _preset((0.0, -0.7, 0.75), (0.0, 0.0, 1.0)),
}
"""Views of the workspace: `overhead` looks straight down, image columns along x and rows along -y;
`tilted` looks down at about 47 degrees from the -y side."""


@lru_cache(maxsize=64)
def preset(name: str, size: int = 64) -> Camera:
    """Return a named view with square images of `size` [px].

    Raises:
        MechSearchError: If there is no such view.
    """
    if name not in VIEWS:
        raise MechSearchError(f"unknown camera {name!r}; choose one of {', '.join(VIEWS)}")
    if size < 8:
        raise MechSearchError(f"image size {size} px is too small; expected at least 8")
    return VIEWS[name].resized(size)


_ACROSS, _MOST_TILT = 75.0, 80.0
"""Angle across a mounted camera's image, and its greatest tilt [degrees]."""

_FARTHEST, _LARGEST, _LEAST_SEEN = 5.0, 4096, 0.75
"""Its greatest distance [m] and side [px], and the share of a view that it has to hold."""

_NUMBER = r"(\d*\.?\d+)"


@lru_cache(maxsize=64)
def mounted(text: str, view: str) -> Camera:
    """Return a camera that is mounted beside a view, and sees most of the table in it.

    It stands on the side of -y, as the view "tilted" does, looks at the table's middle, and sees 75
    degrees across.

    Args:
        text: Degrees off the vertical, metres from the table's middle, and size of the image [px],
            such as "35 0.9 640x480".
        view: A name for `preset`.

    Raises:
        MechSearchError: If it is anything else, or too little of the view is in its image.
    """
    found = re.fullmatch(rf"\s*{_NUMBER}\s+{_NUMBER}\s+(\d+)\s?x\s?(\d+)\s*", text, re.ASCII)
    tilt, away = map(float, found.groups()[:2]) if found else (inf, 0.0)
    width, height = map(int, found.groups()[2:]) if found else (0, 0)
    sides = min(width, height), max(width, height)
    if tilt > _MOST_TILT or not 0 < away <= _FARTHEST or sides[0] < 8 or sides[1] > _LARGEST:
        raise MechSearchError(
            f"mounted is {text!r}; expected degrees off the vertical up to {_MOST_TILT:g}, metres "
            f"from the table's middle up to {_FARTHEST:g}, and the image's sides from 8 to "
            f"{_LARGEST} px, such as '35 0.9 640x480'"
        )
    focal, angle = width / 2 / tan(radians(_ACROSS / 2)), radians(tilt)
    pose = look_at((0, -away * sin(angle), away * cos(angle)), (0, 0, 0), (0, 1, 0))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, pose)
    known = preset(view)
    down = known.directions() @ known.pose[2, :3]
    table = known.back_project(-known.pose[2, 3] / down)
    column, row, ahead = np.moveaxis(camera.project(table), -1, 0)
    inside = (np.abs(column - camera.cx) < width / 2) & (np.abs(row - camera.cy) < height / 2)
    seen = float((inside & (ahead > 0)).mean())
    if seen < _LEAST_SEEN:
        raise MechSearchError(
            f"mounted is {text!r}, where {seen:.0%} of the view {view!r} is in the image; expected "
            f"at least {_LEAST_SEEN:.0%}: choose a place further away"
        )
    return camera
