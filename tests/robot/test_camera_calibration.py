"""A camera's place, found from drawn images of a board, and checked by touching points."""

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from mechsearch.cli import main
from mechsearch.geometry import apply, invert
from mechsearch.robot.calibration import (
    BASE,
    FLANGE,
    SHIFT,
    TURN,
    Board,
    CameraCalibration,
    board_corners,
    board_pose,
    calibrate,
    check_touches,
    read_calibration,
    read_poses,
    write_calibration,
)  # fmt: skip
from mechsearch.types import MechSearchError
from tests.robot.board_images import (
    BASE_FROM_CAMERA,
    BOARD,
    FLANGE_FROM_CAMERA,
    INTRINSICS,
    Rig,
    apart,
    draw_board,
    transform,
)  # fmt: skip

pytest.importorskip("cv2")


@pytest.fixture(scope="module")
def views():
    return list(Rig(robot_error=(0.0005, 0.05)).views(15, np.random.default_rng(0)))


def test_a_boards_pose_is_that_it_was_drawn_at():
    true = transform((10, -20, 5), (-0.05, -0.06, 0.6))
    found, error = board_pose(draw_board(true, np.random.default_rng(0)), INTRINSICS, BOARD)
    shift, turn = apart(true, found)
    assert shift < 1.0
    assert turn < 0.3
    assert error < 0.15
    assert board_pose(np.zeros((480, 640), np.uint8), INTRINSICS, BOARD) is None


@pytest.mark.parametrize(
    ("fixed_to", "truth"), [(BASE, BASE_FROM_CAMERA), (FLANGE, FLANGE_FROM_CAMERA)]
)
def test_a_camera_is_found_where_it_is(fixed_to, truth):
    rig = Rig(fixed_to, robot_error=(0.0005, 0.05))
    for seed in range(2):
        views = list(rig.views(15, np.random.default_rng(seed)))
        found, errors = calibrate(views, INTRINSICS, BOARD, fixed_to)
        shift, turn = apart(found.camera.pose, truth)
        assert shift < 2.5
        assert turn < 0.25
        assert found.images == len(errors) == 15
        # What it says of itself is of the size of what was put in.
        assert 0.05 < found.reprojection < 0.15
        assert found.shift < 0.002


def test_too_few_images_are_refused(views):
    blank = [type(v)(v.name, np.zeros_like(v.image), v.base_from_flange) for v in views[5:]]
    with pytest.raises(MechSearchError, match=r"5 of 15 images show 6 corners .* at least 6"):
        calibrate([*views[:5], *blank], INTRINSICS, BOARD)


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ((), "turned by 0.0 degrees at most"),
        (
            ((0, 0, 1),),
            r"all turned about one axis, \(-?0.0., -?0.0., -?1.00\)|\(.*\); expected two",
        ),
    ],
)
def test_poses_that_leave_it_open_are_refused(axes, says):
    views = list(Rig().views(8, np.random.default_rng(0), axes=axes or ((0, 0, 0),)))
    with pytest.raises(MechSearchError, match=says):
        calibrate(views, INTRINSICS, BOARD)


def test_what_contradicts_itself_is_refused(views):
    poses = [view.base_from_flange for view in views]
    # Each image with the pose of the one before; squares of another size.
    swapped = [type(v)(v.name, v.image, p) for v, p in zip(views, poses[-1:] + poses, strict=False)]
    larger = Board(square=0.036, marker=0.0264)
    for given, board in ((swapped, BOARD), (views, larger)):
        with pytest.raises(MechSearchError, match=r"contradict each other by .* most at"):
            calibrate(given, INTRINSICS, board)


def test_boards_that_cannot_be_are_refused():
    for board, says in (
        (Board(dictionary="DICT_9X9"), "'DICT_9X9'; choose one of DICT_4X4_100"),
        (Board(columns=2), "2 x 5 squares"),
        (Board(columns=40, rows=40), "no more than the 100 markers"),
        (Board(square=30.0, marker=22.0), "in metres"),
    ):
        with pytest.raises(MechSearchError, match=says):
            board.made()


def test_a_camera_on_the_flange_is_no_fixed_one(views):
    found = CameraCalibration(INTRINSICS, FLANGE, 15, 0.1, 0.001, 0.1)
    with pytest.raises(MechSearchError, match="on the flange; expected one that stands still"):
        assert found.base_from_camera is None


SEEN = np.array([[-0.2, -0.1, 1.0], [0.25, -0.15, 1.02], [0.0, 0.2, 0.9], [0.1, 0.1, 1.1]])
TOUCHED = apply(BASE_FROM_CAMERA, SEEN)


def calibrated(pose):
    from dataclasses import replace

    camera = replace(INTRINSICS, world_from_camera=tuple(np.asarray(pose).ravel().tolist()))
    return CameraCalibration(camera, BASE, 15, 0.1, 0.001, 0.1)


@pytest.mark.parametrize(("shift", "turn"), [(0.0, 0.0), (0.004, 0.0), (0.0, 0.8), (0.012, 3.0)])
def test_touched_points_tell_how_far_a_camera_is_off(shift, turn):
    # The camera is taken to be where, seen from the points' middle, it was moved and turned.
    middle = TOUCHED.mean(axis=0)
    about = transform((0, 0, 0), middle) @ transform((0, turn, 0), (0, 0, 0))
    moved = transform((0, 0, 0), (shift, 0, 0)) @ about @ transform((0, 0, 0), -middle)
    check = check_touches(calibrated(moved @ BASE_FROM_CAMERA), SEEN, TOUCHED)
    assert check.shift == pytest.approx(shift, abs=1e-9)
    assert check.turn == pytest.approx(turn, abs=1e-6)
    assert len(check.errors) == len(SEEN)


def test_touched_points_that_tell_nothing_are_refused():
    known = calibrated(BASE_FROM_CAMERA)
    line = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.3, 0.0, 1.0]])
    for seen, touched, says in (
        (SEEN[:2], TOUCHED[:2], "2 touched points; expected at least 3"),
        (line, apply(BASE_FROM_CAMERA, line), "lie along a line"),
        (SEEN, TOUCHED + np.eye(4)[:, 1:] * [0, 0, 0.03], "no pose .* at point 4"),
    ):
        with pytest.raises(MechSearchError, match=says):
            check_touches(known, seen, touched)


def kept(place, views):
    """Views as a user keeps them: images, and poses beside them."""
    place.mkdir()
    lines = ["image, x, y, z, qx, qy, qz, qw"]
    for view in views:
        Image.fromarray(view.image).save(place / view.name)
        turned = Rotation.from_matrix(view.base_from_flange[:3, :3]).as_quat()
        numbers = [*view.base_from_flange[:3, 3], *turned]
        lines.append(", ".join([view.name, *(f"{n:.6f}" for n in numbers)]))
    (place / "poses.csv").write_text("\n".join(lines) + "\n")
    return place


def said(capsys, *words):
    """What a command says, and its error."""
    code = 0
    try:
        main(list(map(str, words)))
    except SystemExit as end:
        code = end.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_folder_is_calibrated_from_and_the_calibration_is_checked(views, tmp_path, capsys):
    folder, out = kept(tmp_path / "images", views), tmp_path / "camera.json"
    numbers = (INTRINSICS.fx, INTRINSICS.fy, INTRINSICS.cx, INTRINSICS.cy)
    words = ("robot", "calibrate", folder, "--out", out)
    code, _, error = said(capsys, *words)
    assert (code, "need --intrinsics: fx fy cx cy" in error) == (2, True)
    code, told, _ = said(capsys, *words, "--intrinsics", *numbers)
    assert code == 0
    assert "15 of 15 images: corners are 0.0" in told
    found = read_calibration(out)
    assert apart(found.base_from_camera, BASE_FROM_CAMERA)[0] < 2.5

    # The tip touches three points, and the camera sees them to the pixel and the millimetre.
    def touches(moved=(0.0, 0.0, 0.0)):
        rows = ["column,row,depth,x,y,z"]
        for point in TOUCHED:
            x, y, z = apply(invert(BASE_FROM_CAMERA), point)
            place = (INTRINSICS.fx * x / z + INTRINSICS.cx, INTRINSICS.fy * y / z + INTRINSICS.cy)
            pixel = [f"{p:.0f}" for p in place]
            rows.append(",".join([*pixel, f"{z:.3f}", *(f"{n:.4f}" for n in point + moved)]))
        file = tmp_path / "touches.csv"
        file.write_text("\n".join(rows))
        return file

    code, told, _ = said(capsys, "robot", "check-calibration", out, touches())
    assert (code, told.count("point")) == (0, 4)
    assert "within 5 mm and 1 degrees" in told
    code, _, error = said(capsys, "robot", "check-calibration", out, touches((0.02, 0, 0)))
    assert (code, error.count("\n")) == (2, 1)
    assert "policies bear 5 mm and 1 degrees: calibrate again" in error


def test_corners_of_a_board_are_touched(tmp_path, capsys):
    camera_from_board = transform((10, -10, 5), (-0.1, -0.07, 0.6))
    image = draw_board(camera_from_board, np.random.default_rng(0))
    Image.fromarray(image).save(tmp_path / "board.png")
    write_calibration(tmp_path / "camera.json", calibrated(BASE_FROM_CAMERA))
    # Corners are numbered by rows of 6, 30 mm apart; the first is a square from both borders.
    rows, chosen = ["corner,x,y,z"], (0, 5, 18, 23)
    for number in chosen:
        on_board = (0.03 * (1 + number % 6), 0.03 * (1 + number // 6), 0.0)
        point = apply(BASE_FROM_CAMERA @ camera_from_board, on_board)
        rows.append(",".join([str(number), *(f"{n:.4f}" for n in point)]))
    (tmp_path / "touches.csv").write_text("\n".join(rows))
    words = ("robot", "check-calibration", tmp_path / "camera.json", tmp_path / "touches.csv")
    code, told, _ = said(capsys, *words, "--image", tmp_path / "board.png")
    assert (code, told.count("point")) == (0, 4)
    assert board_corners(image, INTRINSICS, BOARD).shape == (24, 3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("image,x,y,z\na.png,0,0,0\n", "lacks qw, qx, qy, qz"),
        ("image,x,y,z,qx,qy,qz,qw\na.png,0,0,zero,0,0,0,1\n", "line 2 of .* as numbers"),
        ("image,x,y,z,qx,qy,qz,qw\na.png,0,0,0.5,0,0,0,2\n", "quaternion of length 2.000"),
        ("image,x,y,z,qx,qy,qz,qw\na.png,400,0,500,0,0,0,1\n", "500 m from the base"),
    ],
)
def test_poses_that_are_none_are_refused(tmp_path, text, says):
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(MechSearchError, match=says):
        read_poses(tmp_path / "poses.csv")


def test_the_tolerance_is_that_of_the_sensors():
    assert (SHIFT, TURN) == (0.005, 1.0)
