"""`mechsearch robot calibrate` and `check-calibration`: where a robot's camera is."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from PIL import Image, UnidentifiedImageError

from mechsearch.cli.command import FLAT, Command, say, wrote
from mechsearch.robot import bags
from mechsearch.robot import calibration as hand_eye
from mechsearch.types import Array, MechSearchError

_POSES = "poses.csv"


@dataclass(frozen=True)
class Calibrate(Command):
    """Find where a camera is, from images of a ChArUco board and the poses of the robot's hand.

    Attributes:
        source: A bag of ROS 2 in which the hand rests before the camera at 15 places or so; or a
            folder of rectified images with a poses.csv, whose first line is
            image,x,y,z,qx,qy,qz,qw: the hand's pose in the base frame [m].
        out: File of the calibration.
        intrinsics: fx, fy, cx, cy of the images [px]; a bag has its own.
        camera_on: "base" of a camera that stands still, the board being fixed to the hand; "flange"
            of one on the hand, the board lying still.
        board: What was printed, measured with a ruler.
        topics: Where things are in a bag; images are those at `colour`.
    """

    source: Annotated[Path, tyro.conf.Positional]
    out: Path
    intrinsics: tuple[float, float, float, float] | None = None
    camera_on: Literal["base", "flange"] = "base"
    board: hand_eye.Board = field(default_factory=hand_eye.Board)
    topics: Annotated[bags.Topics, FLAT] = field(default_factory=bags.Topics)

    writes = (("out", (".json",)),)

    def run(self) -> None:
        """Find it, and say how far images and poses agree."""
        camera, views = self._views()
        calibration, errors = hand_eye.calibrate(views, camera, self.board, self.camera_on)
        for view in views:
            seen = f"{errors[view.name]:.2f} px" if view.name in errors else "no board"
            say(f"{view.name}  {seen}")
        hand_eye.write_calibration(self.out, calibration)
        say(
            f"{calibration.images} of {len(views)} images: corners are "
            f"{calibration.reprojection:.2f} px off; images and poses agree within "
            f"{1e3 * calibration.shift:.1f} mm and {calibration.turn:.2f} degrees (root of the "
            "mean square)"
        )
        say(f"the camera in the {calibration.fixed_to}'s frame:")
        say(np.array2string(calibration.camera.pose, precision=5, suppress_small=True))
        wrote(self.out)

    def _views(self) -> tuple[hand_eye.Camera, Sequence[hand_eye.BoardView]]:
        if not (self.source / _POSES).is_file():
            if (self.source / "metadata.yaml").is_file() or self.source.is_file():
                return bags.read_board_views(self.source, self.topics)
            raise MechSearchError(
                f"{self.source} is neither a bag nor a folder with a {_POSES}; expected one of them"
            )
        if self.intrinsics is None:
            raise MechSearchError("images in a folder need --intrinsics: fx fy cx cy [px]")
        poses = hand_eye.read_poses(self.source / _POSES)
        views = [hand_eye.BoardView(n, _image(self.source / n), pose) for n, pose in poses]
        if not views:
            raise MechSearchError(f"{self.source / _POSES} names no image")
        height, width = views[0].image.shape[:2]
        still = tuple(np.eye(4).ravel().tolist())
        return hand_eye.Camera(width, height, *self.intrinsics, still), views


@dataclass(frozen=True)
class CheckCalibration(Command):
    """Say whether points that the robot touched are where its camera sees them.

    Exits with 2 if the camera is off by more than a policy bears: 5 mm, 1 degree.

    Attributes:
        calibration: What `mechsearch robot calibrate` wrote.
        touches: At least three points far apart, as text whose first line is
            column,row,depth,x,y,z: a pixel, the depth there [m], and where the tip touched it in
            the base frame [m]; or, with `--image`, corner,x,y,z.
        image: Of a board that lies still, whose corners were touched.
        board: What was printed, for `--image`.
    """

    calibration: Annotated[Path, tyro.conf.Positional]
    touches: Annotated[Path, tyro.conf.Positional]
    image: Path | None = None
    board: hand_eye.Board = field(default_factory=hand_eye.Board)

    def run(self) -> None:
        """Compare, and refuse what is beyond the tolerance."""
        known, corners = hand_eye.read_calibration(self.calibration), None
        if self.image is not None:
            corners = hand_eye.board_corners(_image(self.image), known.camera, self.board)
        check = hand_eye.check_touches(
            known, *hand_eye.read_touches(self.touches, known.camera, corners)
        )
        for number, error in enumerate(check.errors, 1):
            say(f"point {number}  {1e3 * error:.1f} mm")
        off = f"the camera is off by {1e3 * check.shift:.1f} mm and {check.turn:.2f} degrees"
        bound = f"{1e3 * hand_eye.SHIFT:g} mm and {hand_eye.TURN:g} degrees"
        if check.shift > hand_eye.SHIFT or check.turn > hand_eye.TURN:
            raise MechSearchError(f"{off}; policies bear {bound}: calibrate again")
        say(f"{off}, within {bound}")


def _image(path: Path) -> Array:
    """Return an image, grey (H, W) or colours (H, W, 3) uint8."""
    try:
        with Image.open(path) as image:
            return np.asarray(image if image.mode == "L" else image.convert("RGB"))
    except (OSError, UnidentifiedImageError) as error:
        raise MechSearchError(f"no image at {path}: {error}") from None
