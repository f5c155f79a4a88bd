"""The suction cup's seal, and its lift test: descend until it touches, seal, lift, shake."""

from collections import deque
from typing import Protocol

import numpy as np

from mechsearch.geometry import apply, invert, transform_from_pose
from mechsearch.grippers import SuctionCup
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.lift import LiftConfig, LiftFrame
from mechsearch.types import Floats, Outcome

_AROUND = 24
"""Points of the lip at which the surface is looked for."""

_SEATED = 4.0
"""Force with which a cup is pressed on before the vacuum is drawn [N]."""

_DRAWING = 0.1
"""Time for which the cup stands on what it seals before it lifts it [s]."""

_DAMPED = 4
"""Steps over which soft bellows spread a jerk."""


def seal_of(cup: SuctionCup, lip: Floats, model: ObjectModel, pose: Floats) -> bool:
    """Return whether an object's surface closes a cup all around its lip.

    Args:
        cup: Its geometry.
        lip: Pose (7,) of the lip's middle, z axis away from the surface.
        model: The object.
        pose: Of the object (7,).
    """
    to_lip = invert(transform_from_pose(lip)) @ transform_from_pose(pose)
    vertices = apply(to_lip, model.vertices)
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.concatenate([[[0.0, 0.0]], 0.5 * cup.radius * circle[::3], cup.radius * circle])
    heights = _highest(vertices[model.faces], points)
    if not np.isfinite(heights).all():
        return False
    # Soft bellows follow a plane; what is left between it and the lip would leak.
    plane = np.column_stack([points, np.ones(len(points))])
    slope, *_ = np.linalg.lstsq(plane, heights, rcond=None)
    gap = (heights - plane @ slope)[-_AROUND:]
    flat = np.ptp(gap) <= cup.roughness and np.hypot(*slope[:2]) <= np.tan(cup.tilt)
    return bool(flat and np.abs(heights[-_AROUND:]).max() <= cup.stroke)


def _highest(triangles: Floats, points: Floats) -> Floats:
    """Return the greatest height (P,) of triangles (T, 3, 3) at points (P, 2); -inf beside them."""
    low, high = triangles[:, :, :2].min(axis=1), triangles[:, :, :2].max(axis=1)
    near = ((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1)
    a, b, c = np.moveaxis(triangles[near], 1, 0)
    u, v = (b - a)[:, :2], (c - a)[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    kept = np.abs(area) > 1e-14
    a, b, c, u, v, area = (part[kept] for part in (a, b, c, u, v, area))
    away = points[:, None] - a[:, :2]
    s = (away[..., 0] * v[:, 1] - away[..., 1] * v[:, 0]) / area
    t = (u[:, 0] * away[..., 1] - u[:, 1] * away[..., 0]) / area
    inside = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
    height = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    highest: Floats = np.where(inside, height, -np.inf).max(axis=1, initial=-np.inf)
    return highest


def holds(cup: SuctionCup, load: Floats) -> bool:
    """Return whether a sealed cup bears a load; see `SuctionCup`.

    Args:
        cup: Its force and size.
        load: Force [N] and torque [N m] (6,) that the object puts on the lip, z along the cup.
    """
    left = cup.force + float(load[2])
    bending, twisting = np.hypot(load[3], load[4]), abs(load[5])
    return bool(
        left > 0
        and bending <= left * cup.radius
        and np.hypot(load[0], load[1]) <= cup.friction * left
        and twisting <= cup.friction * left * cup.radius
    )


class CupRig(Protocol):
    """A suction cup in a scene; heights are over the grasp, along it [m]."""

    gripper: SuctionCup
    config: LiftConfig

    @property
    def height(self) -> float:
        """Where the lip is."""

    @property
    def load(self) -> Floats:
        """Force [N] and torque [N m] (6,) of the object on the lip, along the lip's axes."""

    def drive(self, height: float) -> None:
        """Advance one step towards a height [m]."""

    def touched(self) -> set[int]:
        """Return the objects that touch the lip."""

    def seal(self, number: int) -> bool:
        """Hold an object if it closes the cup all around; return whether it does."""

    def let_go(self) -> None:
        """End the vacuum."""

    def object_poses(self) -> Floats:
        """Return the poses (N, 7) of all objects."""

    def gripper_poses(self) -> Floats:
        """Return the poses (P, 7) of the rendered parts."""

    def unsound(self) -> bool:
        """Return whether the physics went wrong."""


class SuctionTest:
    """One suction grasp under way, the counterpart of `lift.LiftTest`."""

    def __init__(
        self, rig: CupRig, poses: Floats, target: int, height: float, film: list[LiftFrame] | None
    ) -> None:
        """Take a cup at a height [m] above its grasp, objects at rest at `poses` (N, 7)."""
        self._rig, self._poses, self._target, self._film = rig, poses, target, film
        self._config, self._start, self._clock = rig.config, height, 0
        self._sealed: int | None = None
        self._loads: deque[Floats] = deque(maxlen=_DAMPED)

    def run(self) -> Outcome:
        """Execute the grasp."""
        rig, target = self._rig, self._target
        touched = self._descend()
        if rig.unsound():
            return Outcome.FAILURE
        if not touched:
            return Outcome.MISSED
        if rig.height > self._rig.gripper.stroke:
            return Outcome.BLOCKED
        sealed = next((number for number in sorted(touched) if rig.seal(number)), None)
        if sealed is None:
            return Outcome.NO_SEAL
        self._sealed = sealed
        bears = self._lift(self._draw())
        if rig.unsound():
            return Outcome.FAILURE
        if not bears:
            return Outcome.SLIPPED if sealed == target else Outcome.MISSED
        lifted = self.lifted()
        if target not in lifted:
            return Outcome.WRONG_OBJECT
        if len(lifted) > 1:
            return Outcome.TWO_OBJECTS
        bears = self._shake()
        if rig.unsound():
            return Outcome.FAILURE
        return Outcome.SUCCESS if bears else Outcome.DROPPED

    def lifted(self) -> set[int]:
        """Return the objects that rose with the cup, if it still holds one."""
        if self._sealed is None:
            return set()
        rise = self._rig.object_poses()[:, 2] - self._poses[:, 2]
        high = set(np.flatnonzero(rise > self._config.risen * self._config.height).tolist())
        return high if self._sealed in high else set()

    def _descend(self) -> set[int]:
        """Go down until the lip is pressed on; return the objects that it touches then."""
        config, rig = self._config, self._rig
        depth = rig.gripper.stroke
        steps = config.steps((self._start + depth) / config.descent_speed)
        for step in range(steps):
            goal = self._start - (self._start + depth) * (step + 1) / steps
            self._step("descend", goal)
            if rig.load[2] > _SEATED and (touched := rig.touched()):
                return touched
        return rig.touched()

    def _draw(self) -> float:
        """Stand while the vacuum is drawn: a jerk of landing must not break the seal.

        Returns:
            Height that the cup is held to while it presses [m], somewhat below where it is.
        """
        height = self._rig.height
        for _ in range(self._config.steps(_DRAWING)):
            self._step("seal", height)
        return height

    def _lift(self, low: float) -> bool:
        """Lift from where the cup is held to, so that the load comes on gently.

        Returns:
            False as soon as the seal breaks.
        """
        config = self._config
        steps = config.steps(config.lifting)
        for step in range(steps):
            share = (1 - np.cos(np.pi * (step + 1) / steps)) / 2
            self._step("lift", low + (config.height - low) * share)
            if self._breaks():
                return False
        return True

    def _shake(self) -> bool:
        config = self._config
        for step in range(config.steps(config.shaking)):
            seconds = (step + 1) * config.physics.time_step
            # From rest: a sine would begin with a jerk.
            sway = config.shake * (np.cos(2 * np.pi * config.frequency * seconds) - 1)
            self._step("shake", config.height + sway)
            if self._breaks():
                return False
        return True

    def _breaks(self) -> bool:
        """Return whether the load breaks the seal now; then the object is let go."""
        self._loads.append(self._rig.load)
        if holds(self._rig.gripper, np.mean(self._loads, axis=0)):
            return False
        self._rig.let_go()
        self._sealed = None
        return True

    def _step(self, phase: str, height: float) -> None:
        self._rig.drive(height)
        self._clock += 1
        if self._film is not None and self._clock % 5 == 0:
            poses = self._rig.object_poses()
            self._film.append(LiftFrame(phase, poses, self._rig.gripper_poses()))
