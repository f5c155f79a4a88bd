"""A robot and a controller, each a process: `python -m tests.robot.processes robot | controller`.

They tell what they do, a line of JSON each.
"""

import json
import sys
import time
from dataclasses import replace

import numpy as np

from mechsearch.geometry import apply, invert
from mechsearch.robot.bags import Topics
from mechsearch.robot.controller import Controller
from mechsearch.robot.limits import Limits
from mechsearch.robot.node import Bus, ControllerNode, RobotNode, header, message_type
from tests.robot.simulated_robot import (
    BASE_FROM_WORKSPACE,
    LIMITS,
    STEP,
    SimulatedRobot,
    own_camera,
)  # fmt: skip
from tests.robot.test_limits import Onwards

# A busy machine is no fault.
SLACK = Limits(**LIMITS, speed=0.05, watchdog=1.0, image_age=2.0)
TOPICS = Topics()
SECONDS = 60.0


def tell(**facts):
    print(json.dumps(facts), flush=True)


def image(bus, topic, array, encoding, now):
    size = array.nbytes // len(array)
    bus.publish(
        topic, "sensor_msgs/msg/Image", header=header(now, "camera"), height=array.shape[0],
        width=array.shape[1], encoding=encoding, is_bigendian=0, step=size, data=array.tobytes(),
    )  # fmt: skip


def publish_frame(bus, topics, frame, now):
    """Publish depth, camera info, mask and, where there are, colours of a frame."""
    depth, camera = np.round(1000 * frame.depth).astype(np.uint16), frame.camera
    image(bus, topics.depth, depth, "16UC1", now)
    if frame.colour is not None:
        image(bus, topics.colour, np.ascontiguousarray(frame.colour), "rgb8", now)
    image(bus, topics.mask, frame.mask.astype(np.uint8), "mono8", now)
    roi = message_type("sensor_msgs/msg/RegionOfInterest")(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    bus.publish(
        topics.camera_info, "sensor_msgs/msg/CameraInfo", header=header(now, "camera"),
        height=camera.height, width=camera.width, distortion_model="", d=[], k=k,
        r=[0.0] * 9, p=[0.0] * 12, binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def robot(domain):
    bus, simulated = Bus(domain), SimulatedRobot(limits=SLACK)
    simulated.camera = own_camera(160, 120)
    node = RobotNode(simulated.guard, bus, TOPICS)
    began, step = time.time(), 0
    while time.time() < began + SECONDS:
        now = simulated.now = time.time()
        if step % 40 == 0:
            publish_frame(bus, TOPICS, simulated.frame(), now)
        point = node.step(replace(simulated.tool(), time=now), now)
        simulated.world.follow(apply(invert(BASE_FROM_WORKSPACE), point))
        if step % 20 == 0:
            tell(tip=simulated.tool().position.tolist(), refusal=simulated.guard.refusal)
        step += 1
        time.sleep(max(0.0, began + step * STEP - time.time()))


def controller(domain):
    own = Controller(Onwards(-1.0, 0.5, 0.0), BASE_FROM_WORKSPACE, SLACK)
    node = ControllerNode(own, own_camera().pose, Bus(domain), TOPICS)
    began = time.time()
    while time.time() < began + SECONDS:
        motion = node.step(time.time())
        if motion is not None:
            tell(kind=motion.kind, reason=motion.reason)
        time.sleep(0.05)


if __name__ == "__main__":
    {"robot": robot, "controller": controller}[sys.argv[1]](int(sys.argv[2]))
