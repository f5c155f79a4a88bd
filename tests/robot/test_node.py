"""Robot and controller as two processes over loopback: killing either ends in a stop."""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from rosbags.typesys import Stores, get_typestore

from mechsearch.robot.bags import COMMANDS_TOPIC, Topics
from mechsearch.robot.controller import Controller
from mechsearch.robot.limits import MOVE
from mechsearch.robot.node import Bus, ControllerNode, RobotNode, message, message_type
from mechsearch.robot.segmenter import open_segmenter
from tests.robot.processes import SLACK, publish_frame
from tests.robot.simulated_robot import BASE_FROM_WORKSPACE, SEEN_HEAP, SimulatedRobot
from tests.robot.test_limits import Onwards
from tests.robot.test_robot_grasper import ASKED, controller_of

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/>"
    "</Interfaces></General></Domain></CycloneDDS>"
)


class Process:
    """One of `processes`, and what it tells."""

    def __init__(self, name, domain):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.robot.processes", name, str(domain)],
            cwd=Path(__file__).parents[2], env={**os.environ, "CYCLONEDDS_URI": LOOPBACK},
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._told = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        for line in self._process.stdout:
            self._told.put(json.loads(line))

    def until(self, holds, seconds=90):
        ends = time.monotonic() + seconds
        while True:
            told = self._told.get(timeout=max(0.1, ends - time.monotonic()))
            if holds(told):
                return told

    def kill(self):
        self._process.kill()
        self._process.wait()


@pytest.fixture
def both():
    domain = 20 + os.getpid() % 180
    robot, controller = Process("robot", domain), Process("controller", domain)
    yield robot, controller
    robot.kill()
    controller.kill()


def moves(robot):
    first = np.array(robot.until(lambda told: True)["tip"])
    return robot.until(lambda told: np.linalg.norm(told["tip"] - first) > 0.03)


def test_killing_the_controller_stops_the_robot_above(both):
    robot, controller = both
    assert not moves(robot)["refusal"]
    controller.kill()
    stopped = robot.until(lambda told: told["refusal"])
    assert "no command" in stopped["refusal"]
    above = robot.until(lambda told: told["tip"][2] > stopped["tip"][2] + 0.09)
    assert np.linalg.norm(np.subtract(above["tip"][:2], stopped["tip"][:2])) < 0.01


def test_killing_the_robot_stops_the_controller(both):
    robot, controller = both
    assert not moves(robot)["refusal"]
    assert controller.until(lambda told: True)["kind"] == "move"
    robot.kill()
    stopped = controller.until(lambda told: told["kind"] != "move")
    assert (stopped["kind"], "measured" in stopped["reason"]) == ("stop", True)


class Memory:
    """A bus without a wire."""

    def __init__(self):
        self.kept = {}

    def publish(self, topic, kind, **fields):
        self.kept[topic] = message_type(kind).deserialize(message(kind, **fields).serialize())

    def newest(self, topic, kind):
        return self.kept.get(topic)


def test_a_grasp_goes_by_a_message_of_its_own_and_is_made_by_the_guard():
    controller, bus = controller_of(ASKED), Memory()
    robot = SimulatedRobot(SEEN_HEAP)
    driver, node = RobotNode(robot.guard, bus, Topics()), ControllerNode(
        controller, robot.camera.pose, bus, Topics()
    )  # fmt: skip
    # Raised already, and turned.
    tool = replace(robot.tool(), position=np.array([0.45, 0.1, 0.2]), ready=True)
    driver.step(tool, 0.0)
    publish_frame(bus, Topics(), robot.frame(), 0.0)
    assert node.step(0.0).kind == "grasp"
    assert set(bus.kept) >= {"/mechsearch/grasp", "/mechsearch/reason"}
    assert "/mechsearch/command" not in bus.kept
    for tick in range(1, 200):
        now = tick / 200
        tool = replace(tool, position=driver.step(replace(tool, time=now), now), time=now)
        if tick % 10 == 0:
            node.step(now)
            publish_frame(bus, Topics(), robot.frame(), now)
    np.testing.assert_allclose(tool.position, ASKED.position, atol=0.006)
    np.testing.assert_array_equal(driver.grasp.quaternion, ASKED.quaternion)
    # What comes later takes its place.
    bus.publish("/mechsearch/stop", "std_msgs/msg/Bool", data=True)
    node.step(1.0)
    assert "/mechsearch/command" in bus.kept
    driver.step(replace(tool, time=1.0), 1.0)
    assert driver.grasp is None


def test_joints_come_by_name_and_velocities_and_arrows_go_out():
    limits, bus = replace(SLACK, joints={"elbow": (-2.0, 2.0)}), Memory()
    robot = SimulatedRobot(SEEN_HEAP, limits)
    driver = RobotNode(robot.guard, bus, Topics())
    controller = Controller(Onwards(1.0, 0.0, 0.0), BASE_FROM_WORKSPACE, limits)
    node = ControllerNode(controller, robot.camera.pose, bus, Topics())
    tool = replace(robot.tool(), joints={"wrist": 5.0, "elbow": 0.3})
    for tick in range(20):
        now = tick / 200
        publish_frame(bus, Topics(), robot.frame(), now)
        tool = replace(tool, position=driver.step(replace(tool, time=now), now), time=now)
        motion = node.step(now)
    assert motion.kind == MOVE, motion.reason
    # The workspace's x axis is the base's y axis; a guard leaves a fifth of the speed.
    linear = bus.kept["/mechsearch/twist"].twist.linear
    np.testing.assert_allclose([linear.x, linear.z], 0, atol=1e-6)
    assert 0 < linear.y <= 0.8 * limits.speed + 1e-6
    arrow = bus.kept["/mechsearch/marker"]
    assert (arrow.type, arrow.action, arrow.pose.orientation.w, arrow.color.a) == (0, 0, 1, 1)
    tip, goal = ([p.x, p.y, p.z] for p in arrow.points)
    np.testing.assert_allclose(goal, motion.goal)
    np.testing.assert_allclose(np.subtract(goal, tip)[[0, 2]], 0, atol=0.005)
    driver.step(replace(tool, joints={"wrist": 5.0, "elbow": 1.97}), 0.1)
    assert node.step(0.1).reason.startswith("joint elbow is at 1.970 rad")
    assert "joint elbow" in driver.guard.refusal


def test_messages_are_ros_2s_to_the_byte():
    store = get_typestore(Stores.ROS2_JAZZY)
    plain = store.types
    stamp = {"sec": 7, "nanosec": 8}
    theirs = plain["geometry_msgs/msg/PoseStamped"](
        plain["std_msgs/msg/Header"](plain["builtin_interfaces/msg/Time"](7, 8), "base_link"),
        plain["geometry_msgs/msg/Pose"](
            plain["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
            plain["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        ),
    )

    def own(name, **fields):
        return message_type(name)(**fields)

    ours = own(
        "geometry_msgs/msg/PoseStamped",
        header=own(
            "std_msgs/msg/Header", stamp=own("builtin_interfaces/msg/Time", **stamp),
            frame_id="base_link",
        ),
        pose=own(
            "geometry_msgs/msg/Pose",
            position=own("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0),
            orientation=own("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )  # fmt: skip
    kind = "geometry_msgs/msg/PoseStamped"
    # Four bytes say how it is encoded.
    assert ours.serialize()[4:] == bytes(store.serialize_cdr(theirs, kind))[4:]
    name = message_type("sensor_msgs/msg/Image").__idl__.idl_transformed_typename
    assert name.replace(".", "::") == "sensor_msgs::msg::dds_::Image_"


def test_a_controller_finds_the_target_in_colours_that_come_as_messages(
    exported_segmenter, monkeypatch
):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain, topics = 20 + (os.getpid() + 90) % 180, Topics()
    robot, bus = SimulatedRobot(SEEN_HEAP, SLACK), Bus(domain)
    driver = RobotNode(robot.guard, bus, topics)
    controller = Controller(
        Onwards(-1.0, 0.5, 0.0),
        BASE_FROM_WORKSPACE,
        SLACK,
        None,
        open_segmenter(exported_segmenter),
    )
    node = ControllerNode(controller, robot.camera.pose, Bus(domain), topics)
    seen, motion, ends = robot.frame(colour=True), None, time.monotonic() + 60
    while motion is None and time.monotonic() < ends:
        now = time.time()
        # A mask that shows nothing is not heard.
        publish_frame(bus, topics, replace(seen, mask=np.zeros_like(seen.mask)), now)
        driver.step(replace(robot.tool(), time=now), now)
        motion = node.step(now)
    assert motion is not None
    assert motion.kind == MOVE, motion.reason
    found = controller.mask
    assert (found & seen.mask).sum() > 0.5 * (found | seen.mask).sum()
    command = None
    while command is None and time.monotonic() < ends:
        command = bus.newest(COMMANDS_TOPIC, "geometry_msgs/msg/PoseStamped")
    place = command.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], motion.goal)
