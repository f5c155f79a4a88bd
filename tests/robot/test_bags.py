"""Recorded bags through the controller, written and read back by rosbags itself."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from mechsearch.cli import main
from mechsearch.robot.bags import Topics, read_bag
from mechsearch.types import MechSearchError
from tests.robot.simulated_robot import BASE_FROM_WORKSPACE, LIMITS, SEEN_HEAP, SimulatedRobot

pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
BEGAN = 1_700_000_000.0
TOPICS = Topics()


@pytest.fixture(scope="module")
def recorded():
    """Four images of a robot that stands still, and the tool."""
    robot = SimulatedRobot(SEEN_HEAP)
    frames = []
    for _ in range(4):
        frames.append((robot.frame(colour=True), robot.tool()))
        robot.now += 0.2
    return frames


def header(seconds, frame):
    nanoseconds = round((BEGAN + seconds) * 1e9)
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
    return TYPES["std_msgs/msg/Header"](time, frame)


def image(seconds, array, encoding):
    array = np.ascontiguousarray(array)
    data = array.view(np.uint8).ravel()
    return TYPES["sensor_msgs/msg/Image"](
        header(seconds, "camera_optical"), *array.shape[:2], encoding, 0,
        data.size // len(array), data,
    )  # fmt: skip


def info(seconds, camera, distortion=0.0):
    k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1])
    roi = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header(seconds, "camera_optical"), camera.height, camera.width, "plumb_bob",
        np.full(5, distortion), k, np.eye(3).ravel(), np.zeros(12), 0, 0, roi,
    )  # fmt: skip


def vector(kind, values):
    return TYPES[f"geometry_msgs/msg/{kind}"](*map(float, values))


def transform(child, parent, matrix):
    # Of a rotation by less than half a turn.
    w = np.sqrt(1 + np.trace(matrix[:3, :3])) / 2
    skew = matrix[:3, :3] - matrix[:3, :3].T
    xyz = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * w)
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header(0, parent), child,
        TYPES["geometry_msgs/msg/Transform"](
            vector("Vector3", matrix[:3, 3]), vector("Quaternion", [*xyz, w])
        ),
    )  # fmt: skip


def about_x(angle):
    matrix = np.eye(4)
    matrix[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix


def messages(frames, depth="16UC1", late=0.0, distortion=0.0, leave_out=(), small=()):
    """Yield topic, seconds and message of a bag."""
    pose = frames[0][0].camera.pose
    # From the base to the camera in two steps, as robots have them.
    half = about_x(2.0)
    tree = [
        transform("camera_link", "base_link", pose @ half.T),
        transform("camera_optical", "camera_link", half),
    ]
    yield (
        "/tf_static",
        0.0,
        TYPES["tf2_msgs/msg/TFMessage"](
            [one for one in tree if one.child_frame_id not in leave_out]
        ),
    )
    for frame, tool in frames:
        t = frame.time
        z = frame.depth if depth == "32FC1" else np.round(1000 * frame.depth).astype(np.uint16)
        bgr, mask = frame.colour[..., ::-1], frame.mask.astype(np.uint8) * 255
        yield TOPICS.depth, t, image(t, z[::2] if "depth" in small else z, depth)
        yield TOPICS.camera_info, t, info(t, frame.camera, distortion)
        yield TOPICS.mask, t, image(t, mask[:, ::2] if "mask" in small else mask, "mono8")
        yield TOPICS.colour, t, image(t, bgr, "bgr8")
        place = TYPES["geometry_msgs/msg/Pose"](
            vector("Point", tool.position), vector("Quaternion", [0, 0, 0, 1])
        )
        stamped = TYPES["geometry_msgs/msg/PoseStamped"](header(t + late, "base_link"), place)
        yield TOPICS.tool, t, stamped


def written(place, rows, plugin=StoragePlugin.SQLITE3, leave_out=()):
    with Writer(place, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, seconds, message in rows:
            if topic in leave_out:
                continue
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            raw = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], round((BEGAN + seconds) * 1e9), raw)
    return place


@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize(("depth", "within"), [("16UC1", 0.0005), ("32FC1", 0.0)])
def test_a_bag_gives_back_what_was_seen(recorded, tmp_path, plugin, depth, within):
    place = written(tmp_path / "bag", messages(recorded, depth), plugin)
    found = list(read_bag(place, TOPICS))
    assert len(found) == len(recorded)
    for (frame, tool), (true_frame, true_tool) in zip(found, recorded, strict=True):
        np.testing.assert_allclose(frame.depth, true_frame.depth, atol=within + 1e-6)
        np.testing.assert_array_equal(frame.mask, true_frame.mask)
        np.testing.assert_array_equal(frame.colour, true_frame.colour)
        np.testing.assert_allclose(frame.camera.pose, true_frame.camera.pose, atol=1e-6)
        assert frame.camera.fx == true_frame.camera.fx
        np.testing.assert_allclose(tool.position, true_tool.position)
        assert frame.time - BEGAN == pytest.approx(true_frame.time, abs=1e-6)


BAD = {
    "no depth": ({}, {"leave_out": (TOPICS.depth,)}, "no depth at /camera/aligned_depth"),
    "no camera info": ({}, {"leave_out": (TOPICS.camera_info,)}, "no camera_info at"),
    "no transform": (
        {"leave_out": ("camera_link",)}, {},
        "no transform from 'camera_optical' to 'base_link'; /tf and /tf_static connect camera_link",
    ),
    "clocks apart": ({"late": -3.0}, {}, "clocks run apart: /tool/pose is stamped 3.00 s before"),
    "an unknown encoding": ({"depth": "mono16"}, {}, "'mono16'; choose one of 16UC1, 32FC1"),
    "a depth of another size": ({"small": ("depth",)}, {}, "320 x 120 px; .* says 320 x 240 px"),
    "a mask of another size": ({"small": ("mask",)}, {}, "160 x 240 px; expected 320 x 240 px"),
    "distortion": ({"distortion": 0.1}, {}, "expected rectified images"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_a_bad_bag_gets_one_clear_message(recorded, tmp_path, what):
    of_messages, of_bag, says = BAD[what]
    place = written(tmp_path / "bag", messages(recorded, **of_messages), **of_bag)
    with pytest.raises(MechSearchError, match=says):
        list(read_bag(place, TOPICS))


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(MechSearchError, match="no bag at"):
        list(read_bag(tmp_path, TOPICS))
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: 3")
    with pytest.raises(MechSearchError, match="is damaged"):
        list(read_bag(tmp_path, TOPICS))


def play(bag, policy, out, *more):
    place = [*BASE_FROM_WORKSPACE[:3, 3].tolist(), 90.0]
    corners = [f"--low {' '.join(map(str, LIMITS['low']))}", "--high 0.82 0.32 0.36"]
    words = (
        f"robot play {bag} --policy {policy} --out {out} --workspace {' '.join(map(str, place))}"
    )
    main([*words.split(), *" ".join(corners).split(), *map(str, more)])


def test_a_bag_is_played(recorded, exported_pushes, tmp_path, capsys):
    bag, out = written(tmp_path / "bag", messages(recorded), StoragePlugin.MCAP), tmp_path / "out"
    play(bag, exported_pushes, out)
    said = capsys.readouterr().out
    assert "move to (" in said
    assert "begins a" in said
    with AnyReader([out / "commands"]) as reader:
        rows = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]
    goals = [message for topic, _, message in rows if topic == "/mechsearch/command"]
    reasons = [json.loads(m.data) for topic, _, m in rows if topic == "/mechsearch/reason"]
    assert len(goals) == len(reasons) == len(recorded)
    tip = recorded[0][1].position
    goal = goals[0].pose.position
    way = np.array([goal.x, goal.y, goal.z]) - tip
    assert 0.005 < np.linalg.norm(way) < 0.0501
    assert reasons[0]["kind"] == "move"
    assert set(reasons[0]["expects"]) == {"uncovered", "occlusion", "actions"}
    # What is drawn ends at the goal.
    picture = np.array(Image.open(out / "0001.png"))
    assert picture.shape == (240, 320, 3)
    column, row, _ = recorded[0][0].camera.project([goal.x, goal.y, goal.z])
    assert picture[round(row), round(column)].tolist() == [40, 200, 80]
    # A place that is taken is left as it is.
    with pytest.raises(SystemExit):
        play(bag, exported_pushes, out)
    assert "there already" in capsys.readouterr().err


def test_a_bag_without_masks_is_played_with_a_segmenter(
    recorded, exported_pushes, exported_segmenter, tmp_path, capsys
):
    rows = list(messages(recorded))
    bag, out = written(tmp_path / "bag", rows, leave_out=(TOPICS.mask,)), tmp_path / "out"
    with pytest.raises(SystemExit):
        play(bag, exported_pushes, out)
    assert "no mask at /target/mask" in capsys.readouterr().err
    play(bag, exported_pushes, out, "--segmenter", exported_segmenter)
    assert "move to (" in capsys.readouterr().out
    # The outline that is drawn is that of what was found, around the target.
    picture = np.array(Image.open(out / "0001.png"))
    drawn, frame = (picture == (230, 40, 40)).all(axis=2), recorded[0][0]
    assert drawn.sum() > 10
    rows, columns = np.nonzero(frame.mask)
    at = np.array([axis.mean() for axis in np.nonzero(drawn)])
    np.testing.assert_allclose(at, [rows.mean(), columns.mean()], atol=8)
    blind = written(tmp_path / "blind", messages(recorded), leave_out=(TOPICS.colour,))
    with pytest.raises(SystemExit):
        play(blind, exported_pushes, tmp_path / "none", "--segmenter", exported_segmenter)
    assert "no colour at" in capsys.readouterr().err


def test_a_grasp_on_a_bag_is_told_drawn_and_written_apart_from_goals(
    recorded, exported_pushes, exported_grasps, tmp_path, capsys
):
    bag, out = written(tmp_path / "bag", messages(recorded)), tmp_path / "out"
    play(bag, exported_pushes, out, "--grasps", exported_grasps / "jaws-85", "--grasp-from", "0")
    assert "grasp to (" in (said := capsys.readouterr().out)
    assert "m, closing along" in said
    with AnyReader([out / "commands"]) as reader:
        rows = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]
    assert {topic for topic, _, _ in rows} == {"/mechsearch/grasp", "/mechsearch/reason"}
    pose = rows[0][2].pose
    reason = json.loads(next(m.data for topic, _, m in rows if topic == "/mechsearch/reason"))
    assert (reason["kind"], reason["gripper"], reason["opening"]) == ("grasp", "jaws-85", 0.085)
    assert reason["expects"]["lifted"] == reason["confidence"] > 0
    # Straight down on the target, turned about the vertical alone; the tips meet no table.
    q = pose.orientation
    np.testing.assert_allclose(reason["approach"], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose([q.x, q.y, q.z**2 + q.w**2], [0, 0, 1], atol=1e-9)
    tip = [pose.position.x, pose.position.y, pose.position.z]
    np.testing.assert_allclose(reason["begin"], np.add(tip, [0, 0, 0.1]), atol=1e-9)
    assert tip[2] > BASE_FROM_WORKSPACE[2, 3]
    frame = recorded[0][0]
    column, row, _ = frame.camera.project(tip)
    near = np.argwhere(frame.mask) - [row, column]
    assert np.linalg.norm(near, axis=1).min() < 3
    # The picture has the jaws in blue on both sides of the tip, 85 mm apart.
    picture = np.array(Image.open(out / "0001.png"))
    closing = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()[:, 0]
    for side in (-1, 1):
        u, v, _ = frame.camera.project(tip + side * 0.0425 * closing)
        around = picture[round(v) - 1 : round(v) + 2, round(u) - 1 : round(u) + 2]
        assert (around == [60, 160, 255]).all(axis=2).any()


def test_a_bad_bag_leaves_nothing_behind(recorded, exported_pushes, tmp_path, capsys):
    bag = written(tmp_path / "bag", messages(recorded), leave_out=(TOPICS.depth,))
    with pytest.raises(SystemExit):
        play(bag, exported_pushes, tmp_path / "out")
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag"]


@pytest.fixture(scope="module")
def board_bag(tmp_path_factory):
    """A hand that carries a board: it rests at eight places, and moves between them."""
    pytest.importorskip("cv2")
    from tests.robot.board_images import INTRINSICS, Rig

    def rows(distortion=0.0):
        yield TOPICS.camera_info, 0.0, info(0.0, INTRINSICS, distortion)
        for number, view in enumerate(Rig().views(8, np.random.default_rng(0))):
            for step in range(7):
                # The hand comes, rests for a while, and goes.
                t = 4.0 * number + 0.1 * step
                moving = step in (0, 6)
                pose = view.base_from_flange.copy()
                pose[:3, 3] += 0.02 * moving
                yield TOPICS.tool, t, stamped_pose(t, pose)
                grey = np.zeros_like(view.image) if moving else view.image
                yield TOPICS.colour, t, image(t, np.repeat(grey[..., None], 3, 2), "bgr8")

    return written(tmp_path_factory.mktemp("board") / "bag", rows())


def stamped_pose(t, pose):
    turned = Rotation.from_matrix(pose[:3, :3]).as_quat()
    place = TYPES["geometry_msgs/msg/Pose"](
        vector("Point", pose[:3, 3]), vector("Quaternion", turned)
    )
    return TYPES["geometry_msgs/msg/PoseStamped"](header(t, "base_link"), place)


def test_a_camera_is_found_from_a_bag(board_bag, tmp_path, capsys):
    from mechsearch.robot.calibration import read_calibration
    from tests.robot.board_images import BASE_FROM_CAMERA, apart

    main(["robot", "calibrate", str(board_bag), "--out", str(tmp_path / "camera.json")])
    assert "8 of 8 images" in capsys.readouterr().out
    found = read_calibration(tmp_path / "camera.json")
    shift, turn = apart(found.base_from_camera, BASE_FROM_CAMERA)
    assert shift < 3
    assert turn < 0.3


def test_a_calibration_says_where_the_camera_of_a_bag_is(recorded, tmp_path):
    from mechsearch.robot.calibration import CameraCalibration, write_calibration

    # The bag knows no transform at all.
    bag = written(tmp_path / "bag", messages(recorded), leave_out=("/tf_static",))
    elsewhere = replace(recorded[0][0].camera, world_from_camera=tuple(about_x(3.0).ravel()))
    known, file = CameraCalibration(elsewhere, "base", 15, 0.1, 0.001, 0.1), tmp_path / "c.json"
    write_calibration(file, known)
    frame, _ = next(read_bag(bag, TOPICS, file))
    np.testing.assert_array_equal(frame.camera.pose, elsewhere.pose)
    write_calibration(file, replace(known, camera=replace(elsewhere, fx=elsewhere.fx * 1.1)))
    with pytest.raises(MechSearchError, match=r"images of 320 x 240 px with fx 336\.0, .* is of"):
        next(read_bag(bag, TOPICS, file))
