"""Recorded bags of ROS 2, sqlite3 or MCAP: what a robot saw, and what it would have been told."""

import json
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from mechsearch.camera import Camera
from mechsearch.geometry import invert, transform_from_pose
from mechsearch.robot.calibration import BoardView, CameraCalibration, read_calibration
from mechsearch.robot.controller import CameraFrame
from mechsearch.robot.limits import GRASPING, MOVE, Motion, PlannedGrasp, Tool
from mechsearch.types import Array, Floats, MechSearchError, check_extra, shown

_APART = 0.2
"""How far two clocks may be apart [s], and the images and poses that belong together."""

_ENCODINGS = {
    "16UC1": ("u2", 1), "32FC1": ("f4", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3),
    "rgba8": ("u1", 4), "bgra8": ("u1", 4), "mono8": ("u1", 1), "8UC1": ("u1", 1),
}  # fmt: skip
DEPTH_ENCODINGS, MASK_ENCODINGS = ("16UC1", "32FC1"), ("mono8", "8UC1")
COLOUR = ("rgb8", "bgr8", "rgba8", "bgra8")


@dataclass(frozen=True)
class Topics:
    """Where things are in a bag.

    Attributes:
        depth: Images of depth, 16UC1 [mm] or 32FC1 [m].
        camera_info: Intrinsics of these; images are rectified.
        mask: Target pixels in the same images, mono8, not 0.
        colour: Colour images, aligned with depth; may be missing.
        tool: Poses of the tool's tip (geometry_msgs/PoseStamped) in the base frame.
        wrench: Forces that act on it (geometry_msgs/WrenchStamped) in the base's axes; may be
            missing.
        joints: Angles of the robot's joints (sensor_msgs/JointState); nodes alone hear them.
        base: Name of the robot's base frame in /tf and /tf_static.
    """

    depth: str = "/camera/aligned_depth_to_color/image_raw"
    camera_info: str = "/camera/aligned_depth_to_color/camera_info"
    mask: str = "/target/mask"
    colour: str = "/camera/color/image_raw"
    tool: str = "/tool/pose"
    wrench: str = "/tool/wrench"
    joints: str = "/joint_states"
    base: str = "base_link"


COMMANDS_TOPIC, REASONS_TOPIC = "/mechsearch/command", "/mechsearch/reason"
"""Goals (geometry_msgs/PoseStamped, base frame), and why, as JSON (std_msgs/String)."""

GRASPS_TOPIC = "/mechsearch/grasp"
"""Poses of the tool's tip and axes when it closes (likewise), which no straight motion leads to."""

_TYPES = {
    "depth": "sensor_msgs/msg/Image", "camera_info": "sensor_msgs/msg/CameraInfo",
    "mask": "sensor_msgs/msg/Image", "colour": "sensor_msgs/msg/Image",
    "tool": "geometry_msgs/msg/PoseStamped", "wrench": "geometry_msgs/msg/WrenchStamped",
}  # fmt: skip
_OF_A_BOARD = ("colour", "camera_info", "tool")
_TRANSFORMS = ("/tf", "/tf_static")


def read_bag(
    path: Path,
    topics: Topics,
    calibration: Path | None = None,
    told: Callable[[int, int], object] = lambda *_: None,
    masks: bool = True,
) -> Iterator[tuple[CameraFrame, Tool]]:
    """Yield what a robot saw, image by image, once it is certain that the bag is whole.

    Args:
        path: The bag.
        topics: Where things are in it.
        calibration: File that says where the camera is, of `write_calibration`; None takes what
            the bag's transforms say.
        told: Told when an image is dealt with how many are, and of how many.
        masks: Whether they are read, or else colours are needed, for a segmenter.

    Raises:
        MechSearchError: If a topic or transform is missing, an encoding is unknown, images differ
            in size or are not those of the calibration, or clocks run apart.
    """
    check_extra("reading a bag", "robot")
    with _opened(path) as reader:
        names = [name for name in _TYPES if masks or name != "mask"]
        optional = ("colour", "wrench") if masks else ("wrench",)
        _check_topics(reader, path, topics, names, optional)
        index, transforms = _indexed(reader, topics, path, names, optional)
        known = None if calibration is None else read_calibration(calibration)
        images = index["depth"]
        for done, (stamp, recorded) in enumerate(images, start=1):
            yield _seen(reader, stamp, recorded, topics, index, transforms, known)
            told(done, len(images))


_RESTING = (0.0005, np.deg2rad(0.1))
"""How far a hand moves that rests [m], [rad]."""

_ELSEWHERE = (0.01, np.deg2rad(3.0))
"""How far it moves at least from one image of a board to the next."""


def read_board_views(path: Path, topics: Topics) -> tuple[Camera, list[BoardView]]:
    """Return a camera's intrinsics, and one image of each place where the robot's hand rested.

    Raises:
        MechSearchError: If colour images, camera info or tool poses are missing, clocks run apart,
            images are not rectified, or the hand never rested.
    """
    check_extra("reading a bag", "robot")
    with _opened(path) as reader:
        _check_topics(reader, path, topics, _OF_A_BOARD, ())
        index = _indexed(reader, topics, path, _OF_A_BOARD, ())[0]
        by_topic, tools = _by_topic(reader), list[tuple[float, Floats]]()
        for _, _, raw in reader.messages([by_topic[topics.tool]]):
            message = reader.deserialize(raw, _TYPES["tool"])
            _check_base(message, topics)
            p, q = message.pose.position, message.pose.orientation
            pose = transform_from_pose([p.x, p.y, p.z, q.w, q.x, q.y, q.z])
            tools.append((seconds_of(message.header), pose))
        views: list[BoardView] = []
        for stamp, recorded in index["colour"]:
            near = [(t, pose) for t, pose in tools if abs(t - stamp) <= _APART]
            between = near and near[0][0] <= stamp <= near[-1][0]
            rests = between and all(_within(near[0][1], pose, _RESTING) for _, pose in near)
            if rests and not (
                views and _within(views[-1].base_from_flange, near[0][1], _ELSEWHERE)
            ):
                connection = by_topic[topics.colour]
                found = next(reader.messages([connection], recorded, recorded + 1))
                message = reader.deserialize(found[2], connection.msgtype)
                image = decoded_image(message, topics.colour, (*COLOUR, *MASK_ENCODINGS))
                views.append(BoardView(f"the image at {stamp:.3f} s", image, near[0][1]))
        _, _, raw = next(reader.messages([by_topic[topics.camera_info]]))
        info = reader.deserialize(raw, _TYPES["camera_info"])
    if not views:
        raise MechSearchError(
            f"{path} has no image at {topics.colour} within {_APART} s of which {topics.tool} "
            "rests; expected a hand that stands still for a while at each place"
        )
    return rectified_camera(info, topics, np.eye(4)), views


def _within(one: Floats, other: Floats, limits: tuple[float, float]) -> bool:
    between = invert(one) @ other
    cosine = (np.trace(between[:3, :3]) - 1) / 2
    near = np.linalg.norm(between[:3, 3]) <= limits[0]
    return bool(near and cosine >= np.cos(limits[1]))


def _check_topics(
    reader: Any, path: Path, topics: Topics, names: Sequence[str], optional: Sequence[str]
) -> None:
    found = {topic: connection.msgtype for topic, connection in _by_topic(reader).items()}
    for name in names:
        topic, kind = getattr(topics, name), _TYPES[name]
        if found.get(topic, kind if name in optional else None) != kind:
            listed = ", ".join(f"{t} ({k})" for t, k in sorted(found.items())) or "nothing"
            raise MechSearchError(f"{path} has no {name} at {topic} of {kind}; it has {listed}")


def write_commands(path: Path, motions: Sequence[Motion], base: str, mcap: bool) -> None:
    """Write motions into a bag of their own.

    Args:
        path: The bag's folder.
        motions: In order.
        base: Name of the base frame.
        mcap: Whether it is stored as MCAP, or else as sqlite3.

    Raises:
        MechSearchError: If there is something at that place.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if path.exists():
        raise MechSearchError(f"{path} is there already; expected a new place for the bag")
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        goal_type, reason_type = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/String"
        goals = {
            topic: writer.add_connection(topic, goal_type, typestore=store)
            for topic in dict.fromkeys(map(topic_of, motions))
        }
        reasons = writer.add_connection(REASONS_TOPIC, reason_type, typestore=store)
        for motion in motions:
            nanoseconds = round(motion.time * 1e9)
            time = types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
            w, *turn = (1.0, 0.0, 0.0, 0.0) if motion.grasp is None else motion.grasp.quaternion
            goal = types[goal_type](
                types["std_msgs/msg/Header"](time, base),
                types["geometry_msgs/msg/Pose"](
                    types["geometry_msgs/msg/Point"](*map(float, motion.goal)),
                    types["geometry_msgs/msg/Quaternion"](*map(float, (*turn, w))),
                ),
            )
            reason = types[reason_type](told(motion))
            writer.write(goals[topic_of(motion)], nanoseconds, store.serialize_cdr(goal, goal_type))
            writer.write(reasons, nanoseconds, store.serialize_cdr(reason, reason_type))


def topic_of(motion: Motion) -> str:
    """Return where a motion is told: a grasp apart from goals, which the tip goes straight to."""
    return COMMANDS_TOPIC if motion.grasp is None else GRASPS_TOPIC


def told(motion: Motion) -> str:
    """Return why a motion was chosen, as JSON."""
    expects = None if motion.expects is None else asdict(motion.expects)
    said = {"kind": motion.kind, "speed": motion.speed, "reason": motion.reason}
    said |= {"confidence": motion.confidence, "expects": expects}
    if (grasp := motion.grasp) is not None:
        said |= {"gripper": grasp.gripper, "opening": grasp.opening}
        said |= {"approach": grasp.approach.tolist(), "begin": grasp.begin.tolist()}
    return json.dumps(said)


def draw(frame: CameraFrame, tool: Tool, motion: Motion) -> Image.Image:
    """Return an image with the target's outline, the tool's tip, and where a motion takes it.

    Of a grasp it is the fingertips, open, what they close along, and the way down to it.
    """
    if frame.colour is not None:
        picture = Image.fromarray(np.ascontiguousarray(frame.colour))
    else:
        depth = np.nan_to_num(np.asarray(frame.depth, np.float64), posinf=0.0)
        near, far = np.quantile(depth[depth > 0], [0.02, 0.98]) if (depth > 0).any() else (0, 1)
        grey = np.clip((far - depth) / max(far - near, 1e-6), 0, 1) * 200 * (depth > 0)
        picture = Image.fromarray(grey.astype(np.uint8)).convert("RGB")
    if frame.mask is not None:
        inside = np.asarray(frame.mask, np.bool_)
        inner = inside.copy()
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            inner &= np.roll(inside, shift, axis)
        pixels = np.array(picture)
        pixels[inside & ~inner] = (230, 40, 40)
        picture = Image.fromarray(pixels)
    pen = ImageDraw.Draw(picture)
    lines = [] if motion.grasp is None else list(_jaws(motion.grasp))
    start = tool.position if motion.grasp is None else motion.grasp.begin
    ends = frame.camera.project([tool.position, start, motion.goal])[:, :2].tolist()
    tip, begin, goal = map(tuple, ends)
    colour = (40, 200, 80) if motion.kind in (MOVE, GRASPING) else (255, 170, 0)
    pen.line([begin, goal], fill=colour, width=2)
    pen.ellipse([tip[0] - 3, tip[1] - 3, tip[0] + 3, tip[1] + 3], outline=colour)
    pen.ellipse([goal[0] - 3, goal[1] - 3, goal[0] + 3, goal[1] + 3], fill=colour)
    for line in lines:
        pen.line(frame.camera.project(line)[:, :2].ravel().tolist(), (60, 160, 255), 2)
    text = motion.reason if motion.kind == MOVE else f"{motion.kind}: {motion.reason}"
    pen.text((4, 4), text, fill=(255, 255, 255), stroke_width=1, stroke_fill=(0, 0, 0))
    return picture


_FINGER = 0.02
"""Width of a finger as it is drawn, and of a cup [m]."""


def _jaws(grasp: PlannedGrasp) -> Floats:
    """Return lines (3, 2, 3) [m]: between open fingertips, and each of these; of a cup a cross."""
    x, y = grasp.axes[:, 0], _FINGER / 2 * grasp.axes[:, 1]
    half = grasp.opening / 2 * x
    across = np.stack([-y, y])
    along = np.stack([-half, half]) if grasp.opening else _FINGER / 2 * np.stack([-x, x])
    return np.asarray(grasp.position + np.stack([along, across - half, across + half]))


def is_mcap(path: Path) -> bool:
    """Return whether a bag is stored as MCAP."""
    folder = path if path.is_dir() else path.parent
    return any(folder.glob("*.mcap"))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a bag by its folder, or by a file in it."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent if path.suffix in (".mcap", ".db3", ".yaml") else path
    if not (folder / "metadata.yaml").is_file():
        raise MechSearchError(f"no bag at {path}; expected a folder with a metadata.yaml")
    try:
        reader = AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except AnyReaderError as error:
        raise MechSearchError(f"the bag at {path} is damaged: {shown(str(error))}") from None
    try:
        yield reader
    finally:
        reader.close()


def _by_topic(reader: Any) -> dict[str, Any]:
    return {connection.topic: connection for connection in reader.connections}


def seconds_of(header: Any) -> float:
    """Return the time of a message's header [s]."""
    return float(header.stamp.sec + header.stamp.nanosec / 1e9)


def _indexed(
    reader: Any, topics: Topics, path: Path, kinds: Sequence[str], optional: Sequence[str]
) -> tuple[dict[str, list[tuple[float, int]]], dict[str, list[tuple[float, str, Floats]]]]:
    """Return when messages of each kind were stamped [s] and recorded [ns], and all transforms.

    Of each frame these are its poses in another: since when, in which, and the pose (4, 4).
    """
    names = {getattr(topics, name): name for name in kinds}
    index: dict[str, list[tuple[float, int]]] = {name: [] for name in kinds}
    transforms: dict[str, list[tuple[float, str, Floats]]] = {}
    some = [c for c in reader.connections if c.topic in (*names, *_TRANSFORMS)]
    for connection, recorded, raw in reader.messages(some):
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic not in _TRANSFORMS:
            index[names[connection.topic]].append((seconds_of(message.header), recorded))
            continue
        for one in message.transforms:
            since = -np.inf if connection.topic == "/tf_static" else seconds_of(one.header)
            r, t = one.transform.rotation, one.transform.translation
            pose = transform_from_pose([t.x, t.y, t.z, r.w, r.x, r.y, r.z])
            child = one.child_frame_id.strip("/")
            transforms.setdefault(child, []).append((since, one.header.frame_id.strip("/"), pose))
    if missing := [n for n in kinds if n not in optional and not index[n]]:
        raise MechSearchError(
            f"{path} has no message at {getattr(topics, missing[0])}, its {missing[0]}"
        )
    delays = {
        name: float(np.median([recorded / 1e9 - stamp for stamp, recorded in rows]))
        for name, rows in index.items()
        if rows
    }
    slow, fast = max(delays, key=delays.__getitem__), min(delays, key=delays.__getitem__)
    if delays[slow] - delays[fast] > _APART:
        raise MechSearchError(
            f"clocks run apart: {getattr(topics, slow)} is stamped "
            f"{delays[slow] - delays[fast]:.2f} s before {getattr(topics, fast)}, as they were "
            f"recorded; expected at most {_APART} s"
        )
    return {name: sorted(rows) for name, rows in index.items()}, transforms


def _seen(
    reader: Any,
    stamp: float,
    recorded: int,
    topics: Topics,
    index: dict[str, list[tuple[float, int]]],
    transforms: dict[str, list[tuple[float, str, Floats]]],
    calibration: CameraCalibration | None,
) -> tuple[CameraFrame, Tool]:
    def nearest(name: str) -> Any:
        rows = index.get(name, [])
        place = bisect_right(rows, (stamp, 0))
        some = rows[max(place - 1, 0) : place + 1]
        best = min(some, key=lambda row: abs(row[0] - stamp), default=(np.inf, 0))
        if abs(best[0] - stamp) > _APART:
            return None
        return message_of(name, best[1])

    def message_of(name: str, at: int) -> Any:
        connection = _by_topic(reader)[getattr(topics, name)]
        (found,) = list(reader.messages([connection], at, at + 1))[:1]
        return reader.deserialize(found[2], connection.msgtype)

    message, info, pose = message_of("depth", recorded), nearest("camera_info"), nearest("tool")
    for name, found in (("camera_info", info), ("tool", pose)):
        if found is None:
            raise MechSearchError(
                f"no message at {getattr(topics, name)} within {_APART} s of the depth image at "
                f"{stamp:.3f} s"
            )
    depth = decoded_image(message, topics.depth, DEPTH_ENCODINGS)
    if calibration is None:
        place = _pose(message.header.frame_id, topics.base, stamp, transforms)
    else:
        place = calibration.base_from_camera
    camera = rectified_camera(info, topics, place)
    if calibration is not None:
        calibration.check_camera(camera)
    size = (camera.height, camera.width)
    images = {}
    for name, encodings in (("mask", MASK_ENCODINGS), ("colour", COLOUR)):
        found = nearest(name)
        image = None if found is None else decoded_image(found, getattr(topics, name), encodings)
        if image is not None and image.shape[:2] != size:
            raise MechSearchError(
                f"{getattr(topics, name)} has images of {image.shape[1]} x {image.shape[0]} px; "
                f"expected {size[1]} x {size[0]} px, aligned with {topics.depth}"
            )
        images[name] = image
    if depth.shape != size:
        raise MechSearchError(
            f"{topics.depth} has images of {depth.shape[1]} x {depth.shape[0]} px; "
            f"{topics.camera_info} says {size[1]} x {size[0]} px"
        )
    wrench, at = nearest("wrench"), pose.pose.position
    pressed = None if wrench is None else wrench.wrench.force
    force = np.zeros(3) if pressed is None else np.array([pressed.x, pressed.y, pressed.z])
    _check_base(pose, topics)
    mask = None if images["mask"] is None else images["mask"] > 0
    tool = Tool(np.array([at.x, at.y, at.z]), seconds_of(pose.header), force)
    return CameraFrame(depth, mask, camera, stamp, images["colour"]), tool


def _check_base(pose: Any, topics: Topics) -> None:
    if (frame := pose.header.frame_id).strip("/") != topics.base:
        raise MechSearchError(f"{topics.tool} is in the frame {frame!r}; expected {topics.base!r}")


def decoded_image(message: Any, topic: str, encodings: Sequence[str]) -> Array:
    """Return an image: depth in metres, colours as red, green and blue.

    Raises:
        MechSearchError: If its encoding is none of these, or its bytes are too few.
    """
    encoding = message.encoding
    if encoding not in encodings:
        raise MechSearchError(
            f"{topic} is encoded as {encoding!r}; choose one of {', '.join(encodings)}"
        )
    kind, channels = _ENCODINGS[encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    width = message.width * channels * dtype.itemsize
    data = np.asarray(message.data, np.uint8)
    if message.step < width or data.size != message.step * message.height:
        raise MechSearchError(
            f"{topic} has {data.size} bytes in rows of {message.step}; expected {message.height} "
            f"rows of {width} bytes or more"
        )
    rows = np.ascontiguousarray(data.reshape(message.height, message.step)[:, :width])
    image: Array = rows.view(dtype).astype(kind)
    if encoding in DEPTH_ENCODINGS:
        return image / np.float32(1000) if encoding == "16UC1" else image
    if channels == 1:
        return image
    image = image.reshape(message.height, message.width, channels)[..., :3]
    return image[..., ::-1] if encoding.startswith("bgr") else image


def rectified_camera(info: Any, topics: Topics, pose: Floats) -> Camera:
    """Return a camera of a CameraInfo, at a pose (4, 4) in the base frame.

    Raises:
        MechSearchError: If its images are not rectified.
    """
    if np.any(np.asarray(info.d) != 0):
        raise MechSearchError(
            f"{topics.camera_info} has the distortion {np.asarray(info.d).tolist()}; expected "
            "rectified images, such as image_proc makes"
        )
    k = np.asarray(info.k).reshape(3, 3)
    numbers = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
    return Camera(info.width, info.height, *numbers, tuple(pose.ravel().tolist()))


def _pose(
    frame: str, base: str, time: float, transforms: dict[str, list[tuple[float, str, Floats]]]
) -> Floats:
    """Return the pose (4, 4) of a frame in the base frame."""

    def root(name: str) -> tuple[str, Floats]:
        pose, seen = np.eye(4), {name}
        while name in transforms:
            rows = transforms[name]
            _, name, own = next((r for r in reversed(rows) if r[0] <= time), rows[0])
            pose = own @ pose
            if name in seen:
                break
            seen.add(name)
        return name, pose

    (top, pose), (base_top, base_pose) = root(frame.strip("/")), root(base.strip("/"))
    if top != base_top:
        known = {*transforms, *(row[1] for rows in transforms.values() for row in rows)}
        raise MechSearchError(
            f"no transform from {frame!r} to {base!r}; /tf and /tf_static connect "
            f"{', '.join(sorted(known)) or 'nothing'}"
        )
    found: Floats = invert(base_pose) @ pose
    return found
