"""Held-out heaps in closed loop: by the free pusher, by a robot in one process, and by messages.

`python -m tests.robot.closed_loop EXPORTED HEAPS --limit 60 --out rows.jsonl`: a line of JSON for
each heap and way, all from the same starts and candidates. By messages, robot and controller are
two processes that share nothing else, in the robot's simulated time, which is never faster than
the clock on the wall.
"""

import atexit
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from mechsearch.camera import preset
from mechsearch.env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.policies import policy_named
from mechsearch.geometry import apply, invert
from mechsearch.heaps.dataset import open_heaps
from mechsearch.robot import bags
from mechsearch.robot.controller import Controller
from mechsearch.robot.limits import MOVE, Guard, Limits
from mechsearch.robot.node import Bus, ControllerNode, RobotNode, header
from mechsearch.robot.policy import open_policy
from mechsearch.sim.scene import Pusher
from tests.robot.processes import publish_frame
from tests.robot.simulated_robot import (
    BASE_FROM_WORKSPACE,
    IMAGES_EVERY,
    LIMITS,
    STEP,
    SimulatedRobot,
    own_camera,
)

ROBOT = Limits(**LIMITS, speed=0.3, force=60)
ACTIONS, UNCOVERED = 50, 0.02
PATIENCE = 90.0
BEHIND = 0.1
"""By how much a controller may be behind the robot [s]: on a busy machine the robot waits."""

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/>"
    "</Interfaces></General></Domain></CycloneDDS>"
)
os.environ["CYCLONEDDS_URI"] = LOOPBACK
Way = Literal["free", "process", "messages"]


@dataclass(frozen=True)
class Run:
    policy: Annotated[Path, tyro.conf.Positional]
    heaps: Annotated[Path, tyro.conf.Positional]
    out: Path = Path("rows.jsonl")
    objects: str = ""
    ways: tuple[Way, ...] = ("free", "process", "messages")
    limit: int = 60
    seed: int = 0
    serve: int = -1

    @cached_property
    def robot_side(self):
        return RobotSide(self)

    @cached_property
    def opened(self):
        return open_heaps(self.heaps, self.objects)

    @cached_property
    def env(self):
        heaps, objects = self.opened
        return HeapEnv(heaps.heaps, objects, HeapEnvConfig(camera=heaps.camera))

    def begun(self, heap):
        return self.env.reset(seed=heap, options={"heap": heap, "fixed_start": True})[0]


class Loop:
    """One heap, as long as it takes: counts goals, and looks whether the target is uncovered."""

    def __init__(self, run, heap):
        run.begun(heap)
        self.robot = SimulatedRobot(heap, ROBOT, run.env.state.ee_position, heaps=run.opened)
        self.actions, self.goal = 0, None

    def heard(self, goal):
        if self.goal != tuple(goal):
            self.goal, self.actions = tuple(goal), self.actions + 1

    @property
    def uncovered(self):
        robot = self.robot
        occlusion = robot.renderer.occlusion(
            preset("overhead"), robot.world.poses, robot.heap.target,
            np.ones(len(robot.heap.poses), bool), Pusher().pose(robot.world.pusher_position),
        )  # fmt: skip
        return occlusion is not None and occlusion <= UNCOVERED


def rng_of(run, heap):
    return np.random.default_rng([run.seed, heap])


def free(run, heap):
    env, obs = run.env, run.begun(heap)
    policy, actions, over = policy_named("uncover"), 0, False
    policy.reset(rng_of(run, heap))
    while not over:
        obs, _, ended, cut, _ = env.step(policy.act(obs))
        actions, over = actions + 1, ended or cut
    return {"uncovered": bool(env.state.occlusion <= UNCOVERED), "actions": actions}


def in_one_process(run, heap):
    loop = Loop(run, heap)
    robot = loop.robot
    controller = Controller(open_policy(run.policy), BASE_FROM_WORKSPACE, ROBOT, rng_of(run, heap))
    uncovered, refusal = False, ""
    while not (uncovered or refusal or loop.actions > ACTIONS) and robot.now < PATIENCE:
        robot.run(IMAGES_EVERY * STEP, controller)
        loop.heard(robot.motions[-1].goal)
        uncovered = loop.uncovered
        refusal = controller.refusal or robot.guard.refusal
    return {"uncovered": uncovered, "actions": loop.actions, "refusal": refusal}


_CLOCK, _EPISODE = "/clock", 1000.0
"""Where the robot tells its simulated time, and how much of that an episode has at most [s]."""


def by_messages(run, heap):
    return run.robot_side.episode(heap)


def serve(run, domain):
    """The controller's process: an episode begins where the robot's clock jumps."""
    bus, topics, episode, node = Bus(domain), bags.Topics(), -1, None
    camera, policy = own_camera(), open_policy(run.policy)
    while True:
        time.sleep(0.005)
        clock = bus.newest(_CLOCK, "rosgraph_msgs/msg/Clock")
        seen = bus.newest(topics.depth, "sensor_msgs/msg/Image")
        tool = bus.newest(topics.tool, "geometry_msgs/msg/PoseStamped")
        if None in (clock, seen, tool):
            continue
        now = clock.clock.sec + clock.clock.nanosec / 1e9
        if any(of_episode(bags.seconds_of(m.header)) != of_episode(now) for m in (seen, tool)):
            continue
        if of_episode(now) != episode:
            episode = of_episode(now)
            controller = Controller(policy, BASE_FROM_WORKSPACE, ROBOT, rng_of(run, episode))
            node = ControllerNode(controller, camera.pose, bus, topics)
        node.step(now)


def of_episode(seconds):
    return int(seconds // _EPISODE) - 1


class RobotSide:
    """The robot's process. Its time is simulated, and waits for a controller that falls behind."""

    def __init__(self, run):
        self.run, self.topics, domain = run, bags.Topics(), 20 + os.getpid() % 200
        self.bus = Bus(domain)
        command = [sys.executable, "-m", "tests.robot.closed_loop", *sys.argv[1:]]
        self.controller = subprocess.Popen([*command, "--serve", str(domain)])
        atexit.register(self.controller.kill)

    @property
    def command(self):
        return self.bus.newest(bags.COMMANDS_TOPIC, "geometry_msgs/msg/PoseStamped")

    def commanded(self):
        """When the newest command was given [s]."""
        return -1.0 if self.command is None else bags.seconds_of(self.command.header)

    def tell(self, robot, frame):
        if frame:
            publish_frame(self.bus, self.topics, robot.frame(), robot.now)
        clock = header(robot.now, "").stamp
        self.bus.publish(_CLOCK, "rosgraph_msgs/msg/Clock", clock=clock)

    def episode(self, heap):
        loop, bus, topics = Loop(self.run, heap), self.bus, self.topics
        robot = loop.robot
        began = robot.now = (heap + 1) * _EPISODE
        still = RobotNode(Guard(replace(ROBOT, dry_run=True)), bus, topics)
        while of_episode(self.commanded()) != heap:
            still.step(robot.tool(), began)
            self.tell(robot, True)
            time.sleep(0.05)
        node, step, started = RobotNode(robot.guard, bus, topics), 0, time.time()
        uncovered, refusal = False, ""
        while not (uncovered or refusal or loop.actions > ACTIONS) and step * STEP < PATIENCE:
            robot.now = began + step * STEP
            if step % IMAGES_EVERY == 0:
                uncovered = loop.uncovered
            self.tell(robot, step % IMAGES_EVERY == 0)
            point = node.step(robot.tool(), robot.now)
            robot.world.follow(apply(invert(BASE_FROM_WORKSPACE), point))
            told = bus.newest(bags.REASONS_TOPIC, "std_msgs/msg/String")
            said = {"kind": MOVE} if step * STEP < 0.5 else json.loads(told.data)
            refusal = robot.guard.refusal or (said["reason"] if said["kind"] != MOVE else "")
            place = self.command.pose.position
            loop.heard((place.x, place.y, place.z))
            step += 1
            time.sleep(max(0.0, started + step * STEP - time.time()))
            while self.commanded() < robot.now - BEHIND:
                time.sleep(0.002)
        return {"uncovered": uncovered, "actions": loop.actions, "refusal": refusal}


WAYS = {"free": free, "process": in_one_process, "messages": by_messages}


def main(run):
    if run.serve >= 0:
        serve(run, run.serve)
    chosen = run.opened[0].choose("held-out", run.limit)
    known = run.out.read_text().splitlines() if run.out.exists() else []
    done = {(row["heap"], row["way"], row["seed"]) for row in map(json.loads, known)}
    for heap in chosen:
        for way in run.ways:
            if (heap, way, run.seed) not in done:
                row = {"heap": heap, "way": way, "seed": run.seed} | WAYS[way](run, heap)
                with run.out.open("a") as file:
                    print(json.dumps(row), file=file)


if __name__ == "__main__":
    main(tyro.cli(Run))
