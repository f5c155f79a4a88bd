"""A robot that is reached only through its guard: the free pusher, a camera, a base of its own."""

import numpy as np

from mechsearch.camera import Camera, look_at
from mechsearch.geometry import apply, invert
from mechsearch.heaps.dataset import embedded_file, open_heaps
from mechsearch.render.renderer import Renderer
from mechsearch.robot.controller import CameraFrame
from mechsearch.robot.limits import Guard, Limits, Tool
from mechsearch.sim.scene import Pusher, Workspace, pusher_model
from mechsearch.sim.world import World

STEP = 0.005
"""Time of one step of physics, and of the guard [s]."""

SEEN_HEAP = 1
"""Whose target the shipped segmenter finds."""

IMAGES_EVERY = 10
"""Steps between two images."""

# The table is 0.5 m before the base and 0.1 m above its foot, turned by 90 degrees.
BASE_FROM_WORKSPACE = np.array(
    [[0.0, -1.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]]
)
LIMITS = {"low": (0.18, -0.32, 0.105), "high": (0.82, 0.32, 0.36)}


def own_camera(width=320, height=240, tilt=0.35):
    """A camera of the robot's own, aside of the policy's, in the base frame."""
    pose = np.array(look_at((0.0, -tilt, 1.0), (0, 0, 0.03), (0, 1, 0))).reshape(4, 4)
    focal, centre = 1.4 * height, ((width - 1) / 2, (height - 1) / 2)
    base = BASE_FROM_WORKSPACE @ pose
    return Camera(width, height, focal, focal, *centre, tuple(base.ravel().tolist()))


class SimulatedRobot:
    def __init__(self, heap=0, limits=None, start=(0.2, -0.15, 0.08), walls=(), heaps=None):
        heaps, objects = heaps or open_heaps(embedded_file("single"))
        self.heap = heaps.heaps[heap]
        models = [objects.models[name] for name in self.heap.objects]
        self.target = models[self.heap.target]
        self.world = World(models, Workspace(), Pusher(), walls)
        self.world.reset(self.heap.poses, np.array(start))
        self.renderer = Renderer(models, pusher_model(Pusher()))
        self.limits = limits or Limits(**LIMITS)
        self.guard, self.camera, self.now = Guard(self.limits), own_camera(), 0.0
        self.stop = False
        self.joints = lambda tip: {}
        self.tips, self.forces, self.motions = [], [], []

    def tool(self):
        tip = apply(BASE_FROM_WORKSPACE, self.world.pusher_position)
        force = BASE_FROM_WORKSPACE[:3, :3] @ -self.world.pusher_force
        return Tool(tip, self.now, force, joints=self.joints(tip))

    def frame(self, colour=False):
        pose = invert(BASE_FROM_WORKSPACE) @ self.camera.pose
        camera = Camera(
            *(getattr(self.camera, n) for n in ("width", "height", "fx", "fy", "cx", "cy")),
            tuple(pose.ravel().tolist()),
        )
        tip = Pusher().pose(self.world.pusher_position)
        seen = self.renderer.frame(camera, self.world.poses, tip, colour)
        return CameraFrame(
            seen.depth, seen.modal(self.heap.target), self.camera, self.now, seen.rgb
        )

    def run(self, seconds, controller=None, change=lambda frame: frame):
        """Let time pass: the controller is asked at every image, the guard at every step."""
        for step in range(round(seconds / STEP)):
            if controller is not None and step % IMAGES_EVERY == 0:
                motion = controller.step(change(self.frame()), self.tool(), self.now, self.stop)
                self.motions.append(motion)
                self.guard.receive(motion, self.now)
            point = self.guard.set_point(self.tool(), self.now, self.stop)
            self.world.follow(apply(invert(BASE_FROM_WORKSPACE), point))
            self.now += STEP
            tool = self.tool()
            self.tips.append(tool.position)
            self.forces.append(float(np.linalg.norm(tool.force)))

    @property
    def speeds(self):
        return np.linalg.norm(np.diff(self.tips, axis=0), axis=1) / STEP
