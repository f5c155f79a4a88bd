"""Grasps on a robot: a quality network as `mechsearch export grasps` writes it, and what it rates.

What is proposed, and how it is seen, is the same code as in simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mechsearch.camera import Camera
from mechsearch.files import record_from_json
from mechsearch.geometry import invert, quaternion_from_rotation, transform_from_pose
from mechsearch.grippers import (
    GRASP_NUMBERS,
    METRIC_HEIGHT,
    PROPOSALS,
    Aligned,
    AnyGripper,
    GraspView,
    Gripper,
    SuctionCup,
    grasp_camera,
    grid_of,
    gripper_named,
    pixels_beside,
    plan_grasps,
)
from mechsearch.observe.reprojection import reproject
from mechsearch.robot.limits import PlannedGrasp
from mechsearch.robot.network import Exported, Network, open_exported, tensors
from mechsearch.types import Array, Floats

_NEAREST = 0.1
"""What of a mask is nearer to the fixed camera is no part of a heap [m]."""

JAWS, CUP = "jaws", "suction"
"""Kinds of exported graspers."""


@dataclass(frozen=True)
class GrasperDescription(Exported):
    """What stands beside the network, whose kind is "jaws" or "suction"; see `described_grasps`.

    Images may have any size and view; they are brought into that of `grasp_camera`.

    Attributes:
        gripper: Its name, and each field of `Gripper` or `SuctionCup`.
    """

    gripper: Mapping[str, Any]


@dataclass(frozen=True)
class GraspExpectation:
    """What a grasp is expected to come to.

    Attributes:
        lifted: Probability that it lifts the target.
    """

    lifted: float


def described_gripper(name: str) -> dict[str, Any]:
    """Return what a `GrasperDescription` says of a gripper itself."""
    gripper = gripper_named(name)
    kind = JAWS if isinstance(gripper, Gripper) else CUP
    own = {"name": name, **asdict(gripper)}
    return {"kind": kind, "gripper": own, "image_size": grasp_camera().width}


def described_grasps(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the inputs and outputs of a gripper's network, N grasps at once; see `Aligned`."""
    grid = grid_of(gripper_named(name))
    patch = ("N", grid.rows, grid.columns)
    inputs: dict[str, tuple[Sequence[Any], str, str]] = {
        "relative": (patch, "float32", "m over the plane of the gripper's x and y axes"),
        "target": (patch, "bool", "whether the target is seen"),
        "numbers": (("N", GRASP_NUMBERS), "float32", "as `grippers.rating.aligned` returns them"),
    }
    return tensors(inputs), tensors({"quality": (("N",), "float32", "chance that it lifts")})


def open_grasper(folder: str | Path) -> "ExportedGrasper":
    """Return a grasper that `mechsearch export grasps` wrote; needs the `robot` extra.

    Raises:
        MechSearchError: If it is missing, damaged, or written for another version.
    """
    return ExportedGrasper(*open_exported(Path(folder), "grasps", GrasperDescription, (JAWS, CUP)))


class ExportedGrasper:
    """Plans grasps of one gripper.

    Attributes:
        gripper: Its geometry and control.
    """

    def __init__(self, description: GrasperDescription, network: Network) -> None:
        """Take an exported grasper's parts; see `open_grasper`.

        Raises:
            MechSearchError: If they describe no gripper.
        """
        self.description, self._network = description, network
        own = {name: value for name, value in description.gripper.items() if name != "name"}
        kind: Any = Gripper if description.kind == JAWS else SuctionCup
        self.gripper: AnyGripper = record_from_json(kind, own)
        self.grid = grid_of(self.gripper)

    def plan(
        self,
        depth: Array,
        mask: Array,
        camera: Camera,
        rng: np.random.Generator,
        base_from_workspace: ArrayLike | None = None,
    ) -> list[PlannedGrasp]:
        """Return grasps of what a mask shows, the best first; none where there is no place for one.

        What is in shadow of what the camera sees is taken to be as low as the lowest close by; what
        of the robot is in the image is taken for clutter.

        Args:
            depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
            mask: Visible pixels of the target (H, W) bool.
            camera: Its intrinsics, and as `world_from_camera` its pose in the robot's base frame.
            rng: Draws the proposals.
            base_from_workspace: As of a `Controller` (4, 4); without it, the base's origin is on
                the table, below the middle of what is looked at.

        Raises:
            MechSearchError: If images and camera differ in size, the workspace's transform is not
                rigid, or nothing that the camera sees is near the workspace.
        """
        base = np.eye(4) if base_from_workspace is None else np.asarray(base_from_workspace)
        # A camera's pose is checked as any other.
        replace(camera, world_from_camera=tuple(base.ravel().tolist()))
        view = view_of_robot(depth, mask, camera, base)
        found = plan_grasps(view, rng, PROPOSALS, self.gripper, self)
        pairs = zip(found.poses, found.quality.tolist(), strict=True)
        return [self._planned(base @ transform_from_pose(pose), chance) for pose, chance in pairs]

    def quality(self, seen: Aligned) -> Floats:
        """Return the chance of success (K,) in [0, 1] of grasps."""
        found = self._network(relative=seen.relative, target=seen.target, numbers=seen.numbers)
        return np.asarray(found["quality"], np.float64)

    def _planned(self, frame: Floats, quality: float) -> PlannedGrasp:
        """Return a grasp whose gripper's frame is at a place (4, 4) in the base frame."""
        turn = frame[:3, :3]
        opening = self.gripper.opening if isinstance(self.gripper, Gripper) else 0.0
        return PlannedGrasp(
            frame[:3, 3] - self.gripper.reach * turn[:, 2], quaternion_from_rotation(turn),
            opening, quality, str(self.description.gripper["name"]),
        )  # fmt: skip


def view_of_robot(depth: Array, mask: Array, camera: Camera, base: Floats) -> GraspView:
    """Return a robot's images as the fixed camera over the workspace would see them.

    It is the part of them that a height map is made of.

    Args:
        depth: As of `ExportedGrasper.plan`, as what follows.
        mask: Mask.
        camera: Camera.
        base: Where the workspace is (4, 4).
    """
    pose = invert(base) @ camera.pose
    own = replace(camera, world_from_camera=tuple(pose.ravel().tolist()))
    onto = _around(depth, mask, own)
    seen = reproject(depth, own, onto, mask)
    return GraspView(seen.depth, np.asarray(seen.mask), onto, METRIC_HEIGHT)


def _around(depth: Array, mask: Array, own: Camera) -> Camera:
    """Return the part of the fixed camera's image that is needed of a mask in another image."""
    whole = grasp_camera()
    if np.shape(depth) != np.shape(mask):
        return whole
    rows, columns = np.nonzero(np.asarray(mask, np.bool_) & np.isfinite(depth) & (depth > 0))
    places = whole.project(own.points_at(columns, rows, depth[rows, columns]))
    places = places[places[:, 2] > _NEAREST]
    if not len(places):
        return whole
    # A pixel more than rounding calls for.
    pad = pixels_beside(whole, float(places[:, 2].min())) + 2
    low, high = places[:, :2].min(axis=0) - pad, places[:, :2].max(axis=0) + pad
    (left, right), (top, bottom) = (
        np.clip([np.floor(a), np.ceil(b) + 1], 0, side).astype(int).tolist()
        for a, b, side in zip(low, high, (whole.width, whole.height), strict=True)
    )
    if left >= right or top >= bottom:
        return whole
    return replace(
        whole, width=right - left, height=bottom - top, cx=whole.cx - left, cy=whole.cy - top
    )
