"""Robot and controller as processes that share nothing but messages: DDS, under ROS 2's names.

Messages are ROS 2's standard ones, named and encoded as its middleware does. Needs the `dds` extra.
"""

import time
from functools import cache
from typing import Any, cast

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from numpy.typing import ArrayLike
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from mechsearch.robot import bags
from mechsearch.robot.controller import CameraFrame, Controller
from mechsearch.robot.limits import GRASPING, MOVE, Guard, Motion, PlannedGrasp, Tool
from mechsearch.types import Floats

STOP_TOPIC = "/mechsearch/stop"
"""Whether somebody presses the stop (std_msgs/Bool)."""

TWIST_TOPIC = "/mechsearch/twist"
"""Velocity of the set point that a robot's guard lets pass (geometry_msgs/TwistStamped, base
frame), for drivers that follow velocities."""

MARKER_TOPIC = "/mechsearch/marker"
"""An arrow from the tip to the goal, to look at (visualization_msgs/Marker, base frame)."""

_POSE, _WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
_JOINTS, _TWIST = "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped"
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_STORE = get_typestore(Stores.ROS2_JAZZY)
_QUALITY = Qos(Policy.Reliability.Reliable(duration(milliseconds=20)), Policy.History.KeepLast(1))
_HEARD = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1))


@cache
def message_type(name: str) -> Any:
    """Return the type of a standard message, such as "sensor_msgs/msg/Image", as ROS 2 names it."""
    room, _, short = name.split("/")
    fields = {field: _field(*kind) for field, kind in _STORE.fielddefs[name][1]}
    made: Any = make_idl_struct(f"{short}_", f"{room}::msg::dds_::{short}_", fields)
    # Images as arrays; as lists of numbers they would take a tenth of a second.
    made.deserialize = staticmethod(lambda data, **_: _STORE.deserialize_cdr(data, name))
    return made


def _field(node: Nodetype, argument: Any) -> Any:
    if node == Nodetype.NAME:
        return message_type(argument)
    if node == Nodetype.BASE:
        name = argument[0]
        return {"bool": bool, "string": str}.get(name) or getattr(types, name)
    inner, idl = _field(*argument[0]), cast(Any, types)
    return idl.array[inner, argument[1]] if node == Nodetype.ARRAY else idl.sequence[inner]


def message(name: str, /, **fields: Any) -> Any:
    """Return a standard message; what is not given is 0, empty or False."""
    kinds = _STORE.fielddefs[name][1]
    blank = {field: _blank(*kind) for field, kind in kinds if field not in fields}
    return message_type(name)(**blank, **fields)


def _blank(node: Nodetype, argument: Any) -> Any:
    if node == Nodetype.NAME:
        return message(argument)
    if node == Nodetype.BASE:
        return {"bool": False, "string": ""}.get(argument[0], 0)
    return [_blank(*argument[0])] * argument[1] if node == Nodetype.ARRAY else []


class Bus:
    """Publishes messages, and keeps the newest of each topic."""

    def __init__(self, domain: int = 0) -> None:
        """Join a domain: ROS_DOMAIN_ID, where that is set."""
        self._participant = DomainParticipant(domain)
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}
        self._newest: dict[str, Any] = {}

    def publish(self, topic: str, kind: str, /, **fields: Any) -> None:
        """Publish a message of a kind, such as "std_msgs/msg/Bool"; see `message`."""
        if topic not in self._writers:
            self._writers[topic] = DataWriter(self._participant, self._topic(topic, kind), _QUALITY)
        self._writers[topic].write(message(kind, **fields))

    def newest(self, topic: str, kind: str) -> Any:
        """Return the newest message that has come; None before the first."""
        if topic not in self._readers:
            self._readers[topic] = DataReader(self._participant, self._topic(topic, kind), _HEARD)
        # Where a publisher has died, that comes too.
        if come := [m for m in self._readers[topic].take(10) if not isinstance(m, InvalidSample)]:
            self._newest[topic] = come[-1]
        return self._newest.get(topic)

    def _topic(self, topic: str, kind: str) -> Topic[Any]:
        return Topic(self._participant, f"rt{topic}", message_type(kind))


def header(now: float, frame: str) -> Any:
    """Return a message's header."""
    seconds, nanoseconds = divmod(round(now * 1e9), 10**9)
    stamp = message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _vector(kind: str, values: ArrayLike) -> Any:
    x, y, z = map(float, np.asarray(values))
    return message(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _pose(position: ArrayLike, axes: ArrayLike) -> Any:
    w, x, y, z = map(float, np.asarray(axes))
    turn = message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return message("geometry_msgs/msg/Pose", position=_vector("Point", position), orientation=turn)


def _publish_pose(
    bus: Bus, topic: str, position: ArrayLike, now: float, base: str, axes: ArrayLike = _UPRIGHT
) -> None:
    bus.publish(topic, _POSE, header=header(now, base), pose=_pose(position, axes))


class RobotNode:
    """The driver's side: tells where the tool is, and follows commands within its guard's limits.

    A command is a pose that the tip goes to; one stays where it is to stop. A grasp, told apart
    from these, is the pose of tip and axes when the tool closes.

    Attributes:
        grasp: That is being made, for which the driver turns and opens the tool; else None. How
            wide it opens, and how likely it lifts, is not a number: no message says so.
    """

    def __init__(self, guard: Guard, bus: Bus, topics: bags.Topics) -> None:
        """Take the guard of a robot."""
        self.guard, self._bus, self._topics = guard, bus, topics
        self.grasp: PlannedGrasp | None = None
        self._last: dict[str, Any] = {}
        self._before: tuple[float, Floats] | None = None

    def step(self, tool: Tool, now: float) -> Floats:
        """Return where the tip should be next (3,) [m]; to be called at the robot's own rate."""
        bus, topics = self._bus, self._topics
        _publish_pose(bus, topics.tool, tool.position, tool.time, topics.base)
        wrench = message("geometry_msgs/msg/Wrench", force=_vector("Vector3", tool.force))
        stamp = header(tool.time, topics.base)
        bus.publish(topics.wrench, _WRENCH, header=stamp, wrench=wrench)
        if tool.joints:
            angles = list(map(float, tool.joints.values()))
            bus.publish(
                topics.joints, _JOINTS, header=stamp, name=list(tool.joints), position=angles
            )
        newest = {t: bus.newest(t, _POSE) for t in (bags.COMMANDS_TOPIC, bags.GRASPS_TOPIC)}
        come = [t for t, told in newest.items() if told is not self._last.get(t)]
        if come:
            last = max(come, key=lambda topic: bags.seconds_of(newest[topic].header))
            self._receive(newest[last].pose, now, last == bags.GRASPS_TOPIC)
            self._last = newest
        pressed = bus.newest(STOP_TOPIC, "std_msgs/msg/Bool")
        point = self.guard.set_point(tool, now, pressed is not None and pressed.data)
        time, before = self._before or (now, point)
        velocity = (point - before) / (now - time) if now > time else np.zeros(3)
        self._before = now, point
        twist = message("geometry_msgs/msg/Twist", linear=_vector("Vector3", velocity))
        bus.publish(TWIST_TOPIC, _TWIST, header=header(now, topics.base), twist=twist)
        return point

    def _receive(self, pose: Any, now: float, grasps: bool) -> None:
        place, q = pose.position, pose.orientation
        goal, kind = np.array([place.x, place.y, place.z]), MOVE
        self.grasp = None
        if grasps:
            axes, kind = np.array([q.w, q.x, q.y, q.z]), GRASPING
            self.grasp = PlannedGrasp(goal, axes, np.nan, np.nan, "")
        speed = self.guard.limits.speed
        self.guard.receive(Motion(kind, goal, speed, now, "", grasp=self.grasp), now)


class ControllerNode:
    """The controller's side: images and the tool's place in, commands and reasons out."""

    def __init__(
        self, controller: Controller, base_from_camera: Floats, bus: Bus, topics: bags.Topics
    ) -> None:
        """Take a controller, and the pose (4, 4) of a fixed camera in the base frame.

        It hears masks; where the controller has a segmenter, colours in their place.
        """
        self.controller, self._bus, self._topics = controller, bus, topics
        self._pose = base_from_camera
        self._depth: Any = None
        self._frame: CameraFrame | None = None

    def step(self, now: float) -> Motion | None:
        """Command what the newest messages call for; None while something has not yet come.

        To be called more often than the robot's watchdog asks for, whether or not images come.

        Raises:
            MechSearchError: If an image is encoded in an unknown way.
        """
        bus, topics = self._bus, self._topics
        image = "sensor_msgs/msg/Image"
        looks = self.controller.segmenter is not None
        depth = bus.newest(topics.depth, image)
        other = bus.newest(topics.colour if looks else topics.mask, image)
        info = bus.newest(topics.camera_info, "sensor_msgs/msg/CameraInfo")
        pose, wrench = bus.newest(topics.tool, _POSE), bus.newest(topics.wrench, _WRENCH)
        pressed = bus.newest(STOP_TOPIC, "std_msgs/msg/Bool")
        if None in (depth, other, info, pose):
            return None
        if depth is not self._depth and other.header.stamp == depth.header.stamp:
            self._depth = depth
            colour = bags.decoded_image(other, topics.colour, bags.COLOUR) if looks else None
            self._frame = CameraFrame(
                bags.decoded_image(depth, topics.depth, bags.DEPTH_ENCODINGS),
                None if looks else bags.decoded_image(other, topics.mask, bags.MASK_ENCODINGS) > 0,
                bags.rectified_camera(info, topics, self._pose),
                bags.seconds_of(depth.header),
                colour,
            )
        if self._frame is None:
            return None
        place, force = pose.pose.position, None if wrench is None else wrench.wrench.force
        pressing = np.zeros(3) if force is None else np.array([force.x, force.y, force.z])
        told = bus.newest(topics.joints, _JOINTS)
        joints = {} if told is None else dict(zip(told.name, told.position, strict=False))
        tip = np.array([place.x, place.y, place.z])
        tool = Tool(tip, bags.seconds_of(pose.header), pressing, joints=joints)
        stop = pressed is not None and pressed.data
        motion = self.controller.step(self._frame, tool, now, stop)
        axes = _UPRIGHT if motion.grasp is None else motion.grasp.quaternion
        _publish_pose(bus, bags.topic_of(motion), motion.goal, now, topics.base, axes)
        bus.publish(bags.REASONS_TOPIC, "std_msgs/msg/String", data=bags.told(motion))
        self._show(tip, motion, now)
        return motion

    def _show(self, tip: Floats, motion: Motion, now: float) -> None:
        # By default an arrow, between two points; as thick as its shaft and its head.
        self._bus.publish(
            MARKER_TOPIC, "visualization_msgs/msg/Marker", header=header(now, self._topics.base),
            ns="mechsearch", points=[_vector("Point", tip), _vector("Point", motion.goal)],
            pose=_pose(np.zeros(3), _UPRIGHT), scale=_vector("Vector3", (0.005, 0.012, 0.0)),
            color=message("std_msgs/msg/ColorRGBA", r=0.2, g=0.8, b=0.3, a=1.0),
        )  # fmt: skip

    def spin(self, period: float = 0.05) -> None:
        """Step on and on, each so many seconds."""
        while True:
            self.step(time.time())
            time.sleep(period)
