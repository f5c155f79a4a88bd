"""The physics engine's state, what moves it, and whether it lies still."""

from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from importlib.metadata import version
from math import isfinite
from typing import Protocol

import mujoco
import numpy as np

from mechsearch.grippers import AnyGripper
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.arm import Arm, ArmMotion
from mechsearch.sim.scene import (
    PhysicsConfig,
    Pusher,
    Tool,
    Wall,
    Workspace,
    compile_scene,
    reset_data,
)
from mechsearch.sim.travel import FreeTravel, Outlines, clear_steps, free_travel
from mechsearch.types import Array, Floats, check_extra

ENGINE_VERSION = str(mujoco.__version__)
ENGINES = ("mujoco", "bullet")
"""What may compute the physics of pushes; all else, such as grippers, is MuJoCo's."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_AWAY = np.array([0.0, 0.0, 5.0])
_SUNK = -0.01
"""Height below which a centre of mass on the table has gone through it [m]."""

_REST_CHECK = 4
"""Steps between two looks whether an action is over early."""

REST_LIMIT = 0.001
"""At rest, no object moves farther than this [m] in one more simulated second."""

_LOOK = 0.25
"""Time between two looks at a settling heap [s]."""

AWAKE = PhysicsConfig(sleep_speed=0.0)
"""Physics in which nothing sleeps: rest is measured, not assumed."""


class HeapWorld(Protocol):
    """What an environment needs of physics, whichever engine computes it."""

    config: PhysicsConfig
    """Numerical choices; the steps are the engine's own."""

    workspace: Workspace
    """Table and bounds."""

    motion: ArmMotion | None
    """What the last push was where an arm pushes; None for a free pusher."""

    @property
    def poses(self) -> Floats:
        """Poses (N, 7) of all objects."""

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""

    def settled(self, poses: Array) -> Floats:
        """Return where a heap's objects, as its file has them (N, 7), come to rest.

        Raises:
            RuntimeError: If they do not in this engine.
        """

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), and the pusher where it is told."""

    def remove(self, index: int) -> None:
        """Take one object out of everything's way, as it is."""

    def pusher_is_free(self) -> bool:
        """Return whether nothing touches the pusher where it stands."""

    def step(self, steps: int) -> None:
        """Advance by a number of time steps."""

    def push(self, target: Array) -> bool:
        """Move the fingertip towards `target` (3,) [m]: one action's worth of simulated time.

        Returns:
            Whether anything was simulated; if not, every object lies exactly where it lay.
        """

    def failure(self) -> str | None:
        """Return the name of a simulator failure, or None while physics can be trusted."""

    def snapshot(self) -> Floats:
        """Return all that the next step depends on.

        Raises:
            MechSearchError: If the engine cannot.
        """

    def restore(self, state: Array) -> None:
        """Return to a snapshot of this world.

        Raises:
            MechSearchError: If the engine cannot.
        """


class World:
    """Objects on a table, and a pusher or a confining wall.

    Attributes:
        motion: What the last push was where an arm pushes; None for a free pusher.
    """

    motion: ArmMotion | None = None

    def __init__(
        self,
        models: Sequence[ObjectModel],
        workspace: Workspace | None = None,
        pusher: Tool | None = None,
        walls: Sequence[Wall] = (),
        config: PhysicsConfig | None = None,
        grippers: Sequence[AnyGripper] = (),
        arm: Arm | None = None,
    ) -> None:
        """Compile a scene.

        Args:
            models: The objects, in the order of all poses.
            workspace: Table and bounds.
            pusher: The end effector, or None for a world without one.
            walls: Confining walls.
            config: Numerical choices.
            grippers: Travelling ones in place of a pusher: the first pushes, its jaws closed.
            arm: What holds the pusher, or a gripper in its place; None leaves it free.
        """
        self.config = config or PhysicsConfig()
        self.workspace = workspace or Workspace()
        self.count = len(models)
        self._pusher: Pusher | AnyGripper | None = grippers[0] if grippers else pusher
        self._outlines = Outlines([model.parts for model in models])
        self._model = compile_scene(
            models, self.workspace, pusher, walls, self.config, travelling=grippers, arm=arm
        )
        self._data = mujoco.MjData(self._model)
        reset_data(self._model, self._data)
        self._size = mujoco.mj_stateSize(self._model, _STATE)
        self._robot_geoms = np.flatnonzero(self._model.geom_bodyid > self.count)
        self._tip = self._data.qpos[7 * self.count :][:3]
        limits = np.full(self._model.nv, self.config.still_speed)
        limits[: 6 * self.count].reshape(-1, 6)[:, 3:] = self.config.still_spin
        self._slowness = 1.0 / limits
        # Views of the engine's memory: each look through its binding would cost a microsecond.
        self._qpos, self._qvel = self._data.qpos, self._data.qvel
        self._objects: Floats = self._qpos[: 7 * self.count].reshape(-1, 7)
        self._set_point, self._command = self._data.act[:3], self._data.ctrl[:3]
        self._asleep, self._warnings = self._data.tree_asleep, self._data.warning.number

    @property
    def poses(self) -> Floats:
        """Poses (N, 7) of all objects."""
        return self._objects.copy()

    @property
    def velocities(self) -> Floats:
        """Linear and angular velocities (N, 6) of all objects [m/s, rad/s]."""
        return np.array(self._data.qvel[: 6 * self.count]).reshape(-1, 6)

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""
        return np.array(self._tip)

    @property
    def pusher_force(self) -> Floats:
        """Force (3,) [N] with which the pusher is driven: at rest, against what blocks it."""
        return np.array(self._data.actuator_force[:3])

    def settled(self, poses: Array) -> Floats:
        """Return `poses` (N, 7): heaps have come to rest in this engine when they are made."""
        return np.asarray(poses, np.float64)

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), and the pusher where it is told."""
        reset_data(self._model, self._data)
        self._data.qpos[: 7 * self.count] = np.asarray(poses, np.float64).ravel()
        if self._pusher is not None:
            self.place_pusher(_AWAY if pusher_position is None else pusher_position)

    def place(self, index: int, pose: Array) -> None:
        """Put one object at rest at a pose (7,)."""
        self._data.qpos[7 * index : 7 * index + 7] = pose
        self._data.qvel[6 * index : 6 * index + 6] = 0.0

    def remove(self, index: int) -> None:
        """Take one object out of everything's way, as it is."""
        self._data.qpos[7 * index] += 10.0 * (index + 1)
        self._data.qvel[6 * index : 6 * index + 6] = 0.0

    def place_pusher(self, position: Array) -> None:
        """Put the pusher at rest at a position (3,) [m]."""
        self._tip[:] = position
        self._qvel[6 * self.count :] = 0.0
        self._set_point[:] = position
        self._command[:] = 0.0

    def pusher_is_free(self) -> bool:
        """Return whether nothing touches the pusher where it stands."""
        mujoco.mj_forward(self._model, self._data)
        pairs = self._data.contact.geom[: self._data.ncon]
        return not bool(np.isin(pairs, self._robot_geoms).any())

    def remove_walls(self) -> None:
        """Take the confining walls away."""
        self._data.mocap_pos[:, 2] = -20.0

    def step(self, steps: int) -> None:
        """Advance by a number of time steps."""
        mujoco.mj_step(self._model, self._data, steps)

    def follow(self, set_point: Array, steps: int = 1) -> None:
        """Let the pusher's servo follow a set point (3,) [m] for some time steps."""
        self._set_point[:] = set_point
        self._command[:] = 0.0
        self.step(steps)

    def push(self, target: Array) -> bool:
        """Move the fingertip towards `target` (3,) [m]: one action's worth of simulated time.

        Where the heap lies still, the pusher travels exactly, and the objects stay exactly, until
        it comes near the first of them: up to there is nothing to simulate. What follows depends
        on the state alone, as a snapshot holds it.

        Returns:
            Whether anything was simulated; if not, every object lies exactly where it lay.
        """
        config, goal = self.config, np.asarray(target, np.float64)
        start = self.pusher_position
        ends = self._data.time + config.steps * config.time_step
        step = self._free_steps(start, goal)
        if step == config.steps:
            self.place_pusher(goal)
        else:
            self._wake()
            self._enter(start, goal - start, step)
            self.step(max(config.action_steps - step, 0))
            self._command[:] = 0.0
            self._rest(config.steps - max(step, config.action_steps))
        self._data.time = ends
        return step < config.steps

    def _free_steps(self, start: Floats, goal: Floats) -> int:
        """Return how many steps of an action towards `goal` nothing but the pusher moves."""
        config = self.config
        if self._pusher is None or not isfinite(config.clearance) or not self._lies_still():
            return 0
        path = start + self._travel.position[:, None] * (goal - start)
        boxes = self._outlines.boxes(self._objects)
        return min(
            clear_steps(path, boxes, part, config.clearance) for part in self._pusher.outline
        )

    @cached_property
    def _travel(self) -> FreeTravel:
        assert self._pusher is not None
        return free_travel(self._pusher, self.config)

    def _enter(self, start: Floats, command: Floats, step: int) -> None:
        """Put the pusher where `step` steps of free travel have brought it."""
        config = self.config
        speed = command / (config.action_steps * config.time_step)
        self._set_point[:] = start
        if step:
            answer = self._travel
            self._tip[:] = start + answer.position[step] * command
            self._qvel[6 * self.count :][:3] = answer.velocity[step] * command
            self._set_point[:] = start + answer.set_point[step] * command
        self._command[:] = speed if step < config.action_steps else 0.0

    def _rest(self, steps: int) -> None:
        """Simulate the end of an action, as long as anything moves."""
        while steps > 0:
            if self.config.stops_when_still and self._lies_still():
                return
            self.step(min(steps, _REST_CHECK))
            steps -= _REST_CHECK

    def _lies_still(self) -> bool:
        """Return whether neither an object nor the pusher moves."""
        return bool(np.abs(self._qvel * self._slowness).max(initial=0.0) < 1.0)

    def _wake(self) -> None:
        """Wake all objects, and let those at rest fall asleep after one step.

        Who slept is no part of a snapshot: an action that began with sleepers could not be
        repeated exactly.
        """
        if not self.config.sleep_speed:
            return
        if (self._asleep >= 0).any():
            # The engine's documented way to wake: a velocity of minus zero.
            self._qvel[self._qvel == 0.0] = -0.0
            mujoco.mj_kinematics(self._model, self._data)
            self._qvel += 0.0
        self._asleep[:] = -1

    def penetrations(self) -> Floats:
        """Return the overlap (C,) of every contact [m], in the last computed step."""
        distances: Floats = np.array(self._data.contact.dist[: self._data.ncon], np.float64)
        return np.maximum(-distances, 0.0)

    def failure(self) -> str | None:
        """Return the name of a simulator failure, or None while physics can be trusted."""
        data, config, poses = self._data, self.config, self._objects
        highest = np.abs(self._qvel).max(initial=0.0)
        if not (isfinite(np.abs(self._qpos).max(initial=0.0)) and isfinite(highest)):
            return "not a number"
        if (self._warnings > 1).any():
            return "solver warning"
        # No axis is faster than the whole: most of the time there is nothing to look at.
        if poses[:, 2].min(initial=0.0) < _SUNK or 2.0 * highest > config.explosion_speed:
            found = runaway(poses, self.velocities, self.workspace, config)
            if found is not None:
                return found
        overlap = -float(data.contact.dist[: data.ncon].min(initial=0.0))
        return "deep penetration" if overlap > config.deep_penetration else None

    def snapshot(self) -> Floats:
        """Return all that the next step depends on; `restore` continues bit by bit."""
        state = np.empty(self._size)
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return state

    def restore(self, state: Array) -> None:
        """Return to a snapshot of this world."""
        mujoco.mj_setState(self._model, self._data, np.asarray(state, np.float64), _STATE)
        self._warnings[:] = 1


def heap_world(
    engine: str,
    models: Sequence[ObjectModel],
    workspace: Workspace,
    pusher: Pusher,
    config: PhysicsConfig,
) -> HeapWorld:
    """Return objects on a table and a pusher, in an engine of `ENGINES`.

    Raises:
        MechSearchError: If the engine is not installed.
    """
    if engine == "mujoco":
        return World(models, workspace, pusher, config=config)
    _ = engine_version(engine)
    made: HeapWorld = import_module(f"mechsearch.sim.{engine}").BulletWorld(
        models, workspace, pusher, config
    )
    return made


def engine_version(engine: str) -> str:
    """Return the version of an engine of `ENGINES`, on which the bits depend.

    Raises:
        MechSearchError: If it is not installed.
    """
    if engine == "mujoco":
        return ENGINE_VERSION
    check_extra(f"the engine {engine} (for Python 3.11: there are no wheels for later)", engine)
    return version("pybullet")


def runaway(
    poses: Floats, velocities: Floats, workspace: Workspace, config: PhysicsConfig
) -> str | None:
    """Return "tunnelling" or "explosion" if an object on the table does that, else None.

    Args:
        poses: Of all objects (N, 7).
        velocities: Linear and angular (N, 6) [m/s, rad/s].
        workspace: Table.
        config: Says what is too fast.
    """
    fast = np.linalg.norm(velocities[:, :3], axis=1) > config.explosion_speed
    on_table = np.abs(poses[:, :2]).max(axis=1) < workspace.table_half - 0.05
    if (on_table & (poses[:, 2] < _SUNK)).any():
        return "tunnelling"
    return "explosion" if (on_table & fast).any() else None


def settle(world: HeapWorld, seconds: float = 4.0, limit: float = REST_LIMIT) -> bool:
    """Step until no object's centre moves faster than `limit` [m/s], or give up.

    What counts is the way from one look to the next: contacts may tremble in place.

    Returns:
        Whether all objects came to rest on the table; it ends when the first has left that.
    """
    chunk = max(1, round(_LOOK / world.config.time_step))
    before = world.poses
    for _ in range(round(seconds / _LOOK)):
        world.step(chunk)
        poses = world.poses
        if world.workspace.off_table(poses).any():
            return False
        way = np.linalg.norm(poses[:, :3] - before[:, :3], axis=1)
        if float(way.max(initial=0.0)) < limit * _LOOK:
            return True
        before = poses
    return False


def drift(models: Sequence[ObjectModel], poses: Array) -> float:
    """Return how far the most restless object moves [m] in one second, started at `poses`.

    A fresh world without sleep is used; a failed simulation drifts infinitely far.
    """
    world = World(models, config=AWAKE)
    world.reset(poses)
    world.step(round(1.0 / world.config.time_step))
    if world.failure() is not None:
        return float("inf")
    moved = world.poses[:, :3] - np.asarray(poses)[:, :3]
    return float(np.linalg.norm(moved, axis=1).max(initial=0.0))
