"""Images of a calibration board, drawn by its homography: a robot of which everything is known."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from mechsearch.camera import Camera, look_at
from mechsearch.geometry import invert
from mechsearch.robot.calibration import BASE, Board, BoardView

STILL = tuple(np.eye(4).ravel().tolist())
INTRINSICS = Camera(640, 480, 610.0, 612.0, 322.4, 236.1, STILL)
BOARD = Board()

BASE_FROM_CAMERA = np.array(look_at((0.55, -0.4, 1.0), (0.5, 0.0, 0.1), (0, 1, 0))).reshape(4, 4)


def transform(turned, place):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turned, degrees=True).as_matrix(), place
    return pose


# The board is screwed to the flange somehow; of a camera on the flange it lies on the table.
FLANGE_FROM_BOARD = transform((3, -5, 40), (-0.09, 0.05, 0.08))
FLANGE_FROM_CAMERA = transform((2, 4, -88), (0.05, 0.02, 0.03))
BASE_FROM_BOARD = transform((178, 4, 0), (0.45, 0.1, 0.02))


def draw_board(camera_from_board, rng, camera=INTRINSICS, board=BOARD, noise=5.0, blur=0.7):
    """A grey image (H, W) uint8: the board in soft, uneven light before a dark wall."""
    import cv2

    cell, fine = 60, 2
    size = (board.columns * cell, board.rows * cell)
    texture = board.made().generateImage(size, marginSize=0)
    texture = cv2.copyMakeBorder(texture, *[cell // 2] * 4, cv2.BORDER_CONSTANT, value=255)
    # From pixels of the texture to metres on the board, and on to pixels of a finer image.
    metres, off = board.square / cell, -(cell // 2) + 0.5
    onto = np.array([[metres, 0, metres * off], [0, metres, metres * off], [0, 0, 1]])
    k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    finer = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1]])
    homography = finer @ k @ camera_from_board[:3, [0, 1, 3]] @ onto
    sides = (camera.width * fine, camera.height * fine)
    large = cv2.warpPerspective(
        texture, homography, sides, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT,
        borderValue=60,
    )  # fmt: skip
    seen = cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    seen = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), blur)
    light = np.linspace(0.6, 0.9, camera.width, dtype=np.float32)
    seen = seen * light + 15 + rng.normal(0, noise, seen.shape)
    return np.clip(seen, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Rig:
    """What takes part; `robot_error` is that of the robot's own poses, by axis [m], [degrees]."""

    fixed_to: str = BASE
    board: Board = field(default_factory=Board)
    robot_error: tuple[float, float] = (0.0, 0.0)

    def views(self, count, rng, tilt=30.0, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
        for number in range(count):
            turned = sum(np.multiply(axis, rng.uniform(-tilt, tilt)) for axis in axes)
            place = (*rng.uniform(-0.12, 0.12, 2), rng.uniform(0.5, 0.75))
            # The board before the camera, its first corner at the upper left, then turned.
            camera_from_board = transform((0, 0, 0), place) @ transform(turned, (0, 0, 0))
            camera_from_board = camera_from_board @ transform((0, 0, 0), (-0.1, -0.075, 0))
            if self.fixed_to == BASE:
                flange = BASE_FROM_CAMERA @ camera_from_board @ invert(FLANGE_FROM_BOARD)
            else:
                flange = BASE_FROM_BOARD @ invert(camera_from_board) @ invert(FLANGE_FROM_CAMERA)
            image = draw_board(camera_from_board, rng, board=self.board)
            shift, turn = self.robot_error
            off = transform(rng.normal(0, turn, 3), rng.normal(0, shift, 3))
            yield BoardView(f"{number:02d}.png", image, flange @ off)


def apart(one, other):
    """How far two poses are apart: [mm], [degrees]."""
    between = invert(one) @ other
    turned = Rotation.from_matrix(between[:3, :3]).magnitude()
    return 1e3 * np.linalg.norm(one[:3, 3] - other[:3, 3]), np.rad2deg(turned)
