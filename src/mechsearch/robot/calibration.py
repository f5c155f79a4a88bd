"""Where a camera is: found from images of a board that the robot holds, checked by touching points.

Needs the `calibration` extra where a board is looked for.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.camera import Camera
from mechsearch.files import read_record, record_from_json, write_record
from mechsearch.geometry import apply, invert, transform_from_pose
from mechsearch.types import Array, Floats, MechSearchError, check_extra, finite_numbers

SHIFT, TURN = 0.005, 1.0
"""How far a camera may be off without costing a policy much [m], [degrees]."""

BASE, FLANGE = "base", "flange"
"""What a camera is fixed to."""

_PURPOSE = "calibration of a camera"

_LEAST_IMAGES, _LEAST_CORNERS = 6, 6

_LEAST_TURN = 10.0
"""Between two poses, and between two axes about which poses are turned [degrees]."""

_LEAST_SPREAD = 0.03
"""Of touched points across their longest extent, as a standard deviation [m]."""

_OTHER_FOCUS = 0.02
"""Share by which intrinsics differ that are another camera's."""


def _opencv() -> Any:
    check_extra("a calibration", "calibration")
    import cv2

    return cv2


@dataclass(frozen=True)
class Board:
    """A ChArUco board, whose first square is black, as OpenCV draws it.

    Attributes:
        columns: Squares in a row.
        rows: Squares in a column.
        square: Side of a square, as it was printed [m].
        marker: Side of a marker [m].
        dictionary: Of the markers, by OpenCV's name.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.03
    marker: float = 0.022
    dictionary: str = "DICT_5X5_100"

    def made(self) -> Any:
        """Return it as OpenCV's board.

        Raises:
            MechSearchError: If there can be no such board.
        """
        cv2 = _opencv()
        names = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        if self.dictionary not in names:
            raise MechSearchError(
                f"unknown dictionary {self.dictionary!r}; choose one of {', '.join(names)}"
            )
        words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        markers = self.columns * self.rows // 2
        if min(self.columns, self.rows) < 3 or markers > len(words.bytesList):
            raise MechSearchError(
                f"a board of {self.columns} x {self.rows} squares; expected at least 3 x 3, and no "
                f"more than the {len(words.bytesList)} markers of {self.dictionary}"
            )
        if not 0 < self.marker < self.square < 1:
            raise MechSearchError(
                f"markers of {self.marker} m in squares of {self.square} m; expected markers "
                "smaller than squares, in metres"
            )
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square, self.marker, words)


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board on an image, and where the robot was.

    Attributes:
        name: Of the image, for people.
        image: Grey (H, W) or colours (H, W, 3) uint8, rectified.
        base_from_flange: Pose (4, 4) of what carries the board, or the camera.
    """

    name: str
    image: Array
    base_from_flange: Floats


@dataclass(frozen=True)
class CameraCalibration:
    """Where a camera is, and how well images and poses agreed on it.

    Attributes:
        camera: Intrinsics, and as `world_from_camera` its pose in the frame of what it is fixed to.
        fixed_to: "base" or "flange".
        images: How many it was found from.
        reprojection: Of the board's corners, root of the mean square [px].
        shift: By which images disagree where the board is, likewise [m].
        turn: Likewise [degrees].
    """

    camera: Camera
    fixed_to: str
    images: int
    reprojection: float
    shift: float
    turn: float

    @property
    def base_from_camera(self) -> Floats:
        """The pose (4, 4) of a camera that stands still in the base frame.

        Raises:
            MechSearchError: If it moves with the flange.
        """
        if self.fixed_to != BASE:
            raise MechSearchError(
                f"the calibration is of a camera on the {self.fixed_to}; expected one that stands "
                "still, since policies look from one place"
            )
        return self.camera.pose

    def check_camera(self, camera: Camera) -> None:
        """Refuse images of another size or intrinsics.

        Raises:
            MechSearchError: Saying how they differ.
        """
        told, known = ((c.fx, c.fy, c.cx, c.cy) for c in (camera, self.camera))
        apart = np.abs(np.subtract(told, known)).max() / known[0]
        sizes = [(c.width, c.height) for c in (camera, self.camera)]
        if sizes[0] != sizes[1] or apart > _OTHER_FOCUS:
            shown = [
                f"{w} x {h} px with fx {k[0]:.1f}, fy {k[1]:.1f}, cx {k[2]:.1f}, cy {k[3]:.1f}"
                for (w, h), k in zip(sizes, (told, known), strict=True)
            ]
            raise MechSearchError(f"images of {shown[0]}; the calibration is of {shown[1]}")


def write_calibration(path: Path, calibration: CameraCalibration) -> None:
    """Write a calibration, whole or not at all."""
    write_record(path, _PURPOSE, asdict(calibration))


def read_calibration(path: Path) -> CameraCalibration:
    """Return what `write_calibration` wrote.

    Raises:
        MechSearchError: If it is missing, damaged, or something else.
    """
    return record_from_json(CameraCalibration, read_record(path, _PURPOSE, ("camera", "fixed_to")))


def calibrate(
    views: Iterable[BoardView], camera: Camera, board: Board, fixed_to: str = BASE
) -> tuple[CameraCalibration, dict[str, float]]:
    """Return a camera's place, by OpenCV's hand-eye routine (Park and Martin, 1994).

    Args:
        views: With the board on the flange, or, of a camera on the flange, lying still.
        camera: Its intrinsics; its pose is not read.
        board: On the images.
        fixed_to: What the camera is fixed to.

    Returns:
        The calibration, and the reprojection error [px] of each image that shows the board.

    Raises:
        MechSearchError: If too few images show the board, the poses do not tell where the camera
            is, or images and poses contradict each other.
    """
    cv2 = _opencv()
    if fixed_to not in (BASE, FLANGE):
        raise MechSearchError(f"unknown {fixed_to!r}; choose one of {BASE}, {FLANGE}")
    found, carried, errors, count = [], [], dict[str, float](), 0
    for view in views:
        count += 1
        seen = board_pose(view.image, camera, board)
        if seen is not None:
            pose, errors[view.name] = seen
            found.append(pose)
            flange = view.base_from_flange
            carried.append(invert(flange) if fixed_to == BASE else flange)
    if len(found) < _LEAST_IMAGES:
        raise MechSearchError(
            f"{len(found)} of {count} images show {_LEAST_CORNERS} corners of the board or more; "
            f"expected at least {_LEAST_IMAGES} such images, and 15 are better"
        )
    _check_poses(carried)
    moved, boards = np.array(carried), np.array(found)
    rotation, place = cv2.calibrateHandEye(
        moved[:, :3, :3], moved[:, :3, 3], boards[:, :3, :3], boards[:, :3, 3],
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place[:, 0]
    # As the board does not move on what carries it, all images should find it at one place there.
    boards = moved @ pose @ boards
    shifts, turns = _from_their_mean(boards)
    shift, turn, worst = _rms(shifts), _rms(turns), list(errors)[int(shifts.argmax())]
    if not (np.isfinite(pose).all() and shift <= SHIFT and turn <= TURN):
        raise MechSearchError(
            f"images and poses contradict each other by {1e3 * shift:.1f} mm and {turn:.2f} "
            f"degrees, most at {worst}; expected at most {1e3 * SHIFT:g} mm and {TURN:g} degrees: "
            "does each pose belong to its image, is the board's square right, did the board move, "
            f"and is the camera fixed to the {fixed_to}?"
        )
    placed = replace(camera, world_from_camera=tuple(pose.ravel().tolist()))
    reprojection = _rms(np.array(list(errors.values())))
    return CameraCalibration(placed, fixed_to, len(found), reprojection, shift, turn), errors


def board_pose(image: Array, camera: Camera, board: Board) -> tuple[Floats, float] | None:
    """Return a board's pose (4, 4) in the camera's frame and its reprojection error [px].

    Returns:
        None where fewer than 6 of its corners are seen.

    Raises:
        MechSearchError: If the image has another size than the camera's.
    """
    cv2 = _opencv()
    if image.shape[:2] != (camera.height, camera.width):
        raise MechSearchError(
            f"an image of {image.shape[1]} x {image.shape[0]} px; the intrinsics are of "
            f"{camera.width} x {camera.height} px"
        )
    made = board.made()
    # The borders of markers, refined, make for better corners of squares.
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.CharucoDetector(made, detectorParams=parameters)
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, ids = detector.detectBoard(np.ascontiguousarray(grey))[:2]
    if ids is None or len(ids) < _LEAST_CORNERS:
        return None
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    points = made.getChessboardCorners()[ids.ravel()]
    told, turned, place = cv2.solvePnP(points, corners, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    if not told:
        return None
    turned, place = cv2.solvePnPRefineLM(points, corners, matrix, None, turned, place)
    projected = cv2.projectPoints(points, turned, place, matrix, None)[0]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turned)[0], place[:, 0]
    return pose, _rms(np.linalg.norm((projected - corners)[:, 0], axis=1))


def _check_poses(poses: Sequence[Floats]) -> None:
    """Refuse poses that are not turned about two axes: they leave the camera's place open."""
    turns = np.array([
        _rotation_vector(one[:3, :3].T @ other[:3, :3])
        for i, one in enumerate(poses)
        for other in poses[:i]
    ])  # fmt: skip
    angles = np.linalg.norm(turns, axis=1)
    far = angles > np.deg2rad(_LEAST_TURN)
    if not far.any():
        raise MechSearchError(
            f"the poses are turned by {np.rad2deg(angles.max()):.1f} degrees at most; expected the "
            f"hand to be turned by more than {_LEAST_TURN:g} degrees, about two axes"
        )
    axes = turns[far] / angles[far, None]
    spread = np.linalg.svd(axes, compute_uv=False)[1] / np.sqrt(len(axes))
    if spread < np.sin(np.deg2rad(_LEAST_TURN)):
        x, y, z = np.linalg.svd(axes)[2][0]
        raise MechSearchError(
            f"the poses are all turned about one axis, ({x:.2f}, {y:.2f}, {z:.2f}); expected two: "
            "tilt the hand forwards and sideways too"
        )


@dataclass(frozen=True, eq=False)
class TouchCheck:
    """How far off a calibration is where points were touched.

    Attributes:
        errors: Of each point (n,) [m].
        shift: Of all together, in their middle [m].
        turn: By which the camera would have to be turned [degrees].
    """

    errors: Floats
    shift: float
    turn: float


def check_touches(calibration: CameraCalibration, seen: Floats, touched: Floats) -> TouchCheck:
    """Return how far points as the camera sees them are from where the tip touched them.

    Args:
        calibration: Of a camera that stands still.
        seen: In the camera's frame (n, 3) [m].
        touched: Where the robot measured its tip, in the base frame (n, 3) [m].

    Raises:
        MechSearchError: If there are fewer than three points, or they lie close together or along a
            line, or no pose of the camera explains them.
    """
    if len(touched) < 3:
        raise MechSearchError(f"{len(touched)} touched points; expected at least 3")
    middle, believed = touched.mean(axis=0), apply(calibration.base_from_camera, seen)
    spread = np.linalg.svd(touched - middle, compute_uv=False)[1] / np.sqrt(len(touched))
    if spread < _LEAST_SPREAD:
        raise MechSearchError(
            f"the touched points lie along a line, or within {1e3 * spread:.0f} mm; expected a "
            "triangle with sides of 100 mm or more"
        )
    there = believed.mean(axis=0)
    u, _, vt = np.linalg.svd((touched - middle).T @ (believed - there))
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    left = np.linalg.norm((believed - there) @ rotation.T - (touched - middle), axis=1)
    if left.max() > SHIFT:
        raise MechSearchError(
            f"no pose of the camera explains the touched points: {1e3 * left.max():.1f} mm remain "
            f"at point {left.argmax() + 1}; expected at most {1e3 * SHIFT:g} mm: is its depth or "
            "its tip wrong, or are the intrinsics?"
        )
    turn = float(np.rad2deg(np.linalg.norm(_rotation_vector(rotation))))
    errors = np.linalg.norm(believed - touched, axis=1)
    return TouchCheck(errors, float(np.linalg.norm(there - middle)), turn)


def read_poses(path: Path) -> list[tuple[str, Floats]]:
    """Return images' names, and poses (4, 4) of the flange in the base frame.

    Args:
        path: Text with commas whose first line names its columns: `image`, `x`, `y`, `z` [m], and
            the quaternion `qx`, `qy`, `qz`, `qw`.

    Raises:
        MechSearchError: If it is missing, or a line is not such a pose.
    """
    rows = []
    names = ("x", "y", "z", "qw", "qx", "qy", "qz")
    for where, row in _rows(path, "tool poses", ("image", *names)):
        pose = _numbers(row, names, where)
        length = float(np.linalg.norm(pose[3:]))
        if not 0.99 < length < 1.01:
            raise MechSearchError(f"{where} has a quaternion of length {length:.3f}; expected 1")
        if (far := float(np.abs(pose[:3]).max())) > 10:
            raise MechSearchError(f"{where} is {far:g} m from the base; expected metres")
        pose[3:] /= length
        rows.append((str(row["image"]), transform_from_pose(pose)))
    return rows


def board_corners(image: Array, camera: Camera, board: Board) -> Floats:
    """Return where the inner corners of a board are, by number (n, 3) [m], in the camera's frame.

    Raises:
        MechSearchError: If the image does not show the board, or has another size.
    """
    if (seen := board_pose(image, camera, board)) is None:
        raise MechSearchError(f"the image shows fewer than {_LEAST_CORNERS} corners of the board")
    return apply(seen[0], board.made().getChessboardCorners())


def read_touches(
    path: Path, camera: Camera, corners: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return points in the camera's frame (n, 3), and where the tip touched them (n, 3) [m].

    Args:
        path: Text with commas whose first line names its columns: `x`, `y`, `z` of the tip in the
            base frame [m], and `column`, `row` [px] and `depth` [m] of the point, or the number of
            the board's `corner`.
        camera: Of the image.
        corners: See `board_corners`; None takes pixels and depth.

    Raises:
        MechSearchError: If it is missing, or a line is not such a point.
    """
    own = ("column", "row", "depth") if corners is None else ("corner",)
    seen, touched = [], []
    for where, row in _rows(path, "touched points", (*own, "x", "y", "z")):
        point = _numbers(row, own, where)
        touched.append(_numbers(row, ("x", "y", "z"), where))
        if corners is not None:
            if point[0] not in range(len(corners)):
                raise MechSearchError(
                    f"{where} is corner {point[0]:g}; expected one from 0 to {len(corners) - 1}"
                )
            seen.append(corners[int(point[0])])
            continue
        column, line, depth = point
        if not (0 <= column < camera.width and 0 <= line < camera.height and 0 < depth < 10):
            raise MechSearchError(
                f"{where} is pixel ({column:g}, {line:g}) at {depth:g} m; expected one of "
                f"{camera.width} x {camera.height} px, and a depth in metres"
            )
        level = replace(camera, world_from_camera=tuple(np.eye(4).ravel().tolist()))
        seen.append(level.points_at(column, line, depth))
    return np.array(seen).reshape(-1, 3), np.array(touched).reshape(-1, 3)


def _rows(
    path: Path, purpose: str, names: Sequence[str]
) -> Sequence[tuple[str, Mapping[str, str | None]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            rows = [(f"line {reader.line_num} of {path}", row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MechSearchError(f"no {purpose} at {path}: {error}") from None
    header = reader.fieldnames or []
    if missing := [name for name in names if name not in header]:
        raise MechSearchError(
            f"{path} lacks {', '.join(missing)}; expected a first line with {', '.join(names)}, "
            f"got {', '.join(header) or 'nothing'}"
        )
    return rows


def _numbers(row: Mapping[str, str | None], names: Sequence[str], where: str) -> Floats:
    try:
        values = [float(row[name] or "") for name in names]
    except ValueError:
        values = [np.nan]
    return finite_numbers(values, (len(names),), f"{where} has {', '.join(names)} as numbers")


def _from_their_mean(poses: Floats) -> tuple[Floats, Floats]:
    """Return how far poses (n, 4, 4) are from their mean: (n,) [m], (n,) [degrees]."""
    u, _, vt = np.linalg.svd(poses[:, :3, :3].mean(axis=0))
    away = poses[:, :3, :3] @ (u @ vt).T
    turns = np.array([np.rad2deg(np.linalg.norm(_rotation_vector(one))) for one in away])
    return np.linalg.norm(poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0), axis=1), turns


def _rotation_vector(rotation: Floats) -> Floats:
    """Return axis times angle (3,) [rad] of a rotation by less than half a turn."""
    x, y, z = (
        rotation[2, 1] - rotation[1, 2],
        rotation[0, 2] - rotation[2, 0],
        (rotation[1, 0] - rotation[0, 1]),
    )
    across = np.array([x, y, z]) / 2
    sine = float(np.linalg.norm(across))
    angle = np.arctan2(sine, (np.trace(rotation) - 1) / 2)
    return across * (angle / sine) if sine > 1e-12 else across


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
