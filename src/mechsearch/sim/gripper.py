"""Grippers: parallel jaws, of a palm and two coupled fingers, and a suction cup; presets by name.

A gripper's frame has its origin at the grasp centre, x along the closing direction and z against
the approach, so a gripper that points straight down has its z axis up. Of a suction cup, the grasp
centre is the middle of its lip.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from mechsearch.geometry import apply, transform_from_pose
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Floats, MechSearchError

# With the engine's defaults the squeeze drives the light fingers a centimetre past their stops.
_FIRM_TIME, _FIRM = [0.01, 1.0], [0.99, 0.999, 0.0005, 0.5, 2.0]


_SIDES = "left", "right"

_DRIVE = 2.0
"""Inertia of a travelling gripper's geared drive, as its fingers feel it [kg]: what slips out of
them is not shot away."""

PUSHING_STIFFNESS, GRASPING_STIFFNESS = 2000.0, 20000.0
"""Of what carries a travelling gripper, along each axis [N/m]: soft like the pusher, or stiff."""


HAND_LENGTH = 0.2
"""From an arm's flange to the tips of the gripper that it holds [m], as long as the pusher."""

_HAND_RADIUS = 0.035
"""Of what is between flange and palm [m]."""


@dataclass(frozen=True)
class Cylinder:
    """An upright part of an end effector, its heights above the lowest point [m]."""

    radius: float
    low: float
    high: float


@dataclass(frozen=True)
class Gripper:
    """Geometry and control of the jaws.

    Attributes:
        opening: Between the open fingers [m].
        thickness: Of a finger along the closing direction [m].
        width: Of a finger across it [m].
        length: Of a finger, from its tip to the palm [m].
        reach: How far the tips are beyond the grasp centre [m].
        clearance: Least distance between tips and table [m].
        squeeze: Force of each finger [N].
        press: Largest force along the approach; more blocks the descent [N].
        pull: Largest force against the approach [N].
        mass: Of the palm [kg].
        finger_mass: Of each finger [kg].
        friction: Sliding coefficient between fingers and objects.
        closing: Time that the fingers take to close [s].
    """

    opening: float = 0.056
    thickness: float = 0.008
    width: float = 0.016
    length: float = 0.06
    reach: float = 0.01
    clearance: float = 0.002
    squeeze: float = 20.0
    press: float = 30.0
    pull: float = 100.0
    mass: float = 0.5
    finger_mass: float = 0.05
    friction: float = 0.5
    closing: float = 0.22

    def __post_init__(self) -> None:
        if not 0.01 <= self.opening <= 0.2:
            raise MechSearchError(
                f"a gripper that opens {self.opening} m; expected 0.01 to 0.2 m, such as 0.056"
            )

    @property
    def stiffness(self) -> float:
        """Of what carries it while it pushes [N/m]."""
        return PUSHING_STIFFNESS

    @property
    def force(self) -> float:
        """Largest along each axis while it pushes [N]."""
        return self.press

    @property
    def finger_box(self) -> Floats:
        """Half the sides (3,) of a finger [m]."""
        return np.array([self.thickness, self.width, self.length]) / 2

    @property
    def palm_box(self) -> Floats:
        """Half the sides (3,) of the palm [m]."""
        return np.array([self.opening / 2 + self.thickness, 0.015, 0.01])

    @property
    def finger_place(self) -> Floats:
        """Centre (3,) of the open finger on the positive side [m]; the other mirrors it."""
        return np.array([(self.opening + self.thickness) / 2, 0.0, self.length / 2 - self.reach])

    @property
    def palm_place(self) -> Floats:
        """Centre (3,) of the palm [m]."""
        return np.array([0.0, 0.0, self.length - self.reach + self.palm_box[2]])

    @property
    def boxes(self) -> tuple[tuple[Floats, Floats], ...]:
        """Half the sides and the centre (3,) of each part of the open gripper [m]."""
        mirrored = self.finger_place * [-1.0, 1.0, 1.0]
        fingers = (self.finger_box, self.finger_place), (self.finger_box, mirrored)
        return (*fingers, (self.palm_box, self.palm_place))

    @property
    def closed(self) -> float:
        """Travel of a finger [m] beyond the other, so that even what is thin feels all force."""
        return self.opening / 2 + 0.012

    @property
    def outline(self) -> tuple[Cylinder, ...]:
        """What the closed jaws fill, from the tips upwards."""
        fingers = float(np.hypot(self.thickness, self.width / 2))
        palm = float(np.hypot(*self.palm_box[:2]))
        top = self.length + 2 * float(self.palm_box[2])
        return Cylinder(fingers, 0.0, self.length), Cylinder(palm, self.length, top)

    @property
    def places(self) -> Floats:
        """Centres (3, 3) of palm and open fingers, in the order of `models` [m]."""
        return np.stack([self.palm_place, *(place for _, place in self.boxes[:2])])

    def models(self) -> list[ObjectModel]:
        """Return palm and both fingers for rendering, each about its own centre."""
        return [
            _box_model("palm", self.palm_box, (84, 88, 98)),
            _box_model("finger0", self.finger_box, (38, 40, 46)),
            _box_model("finger1", self.finger_box, (38, 40, 46)),
        ]

    def closed_model(self) -> ObjectModel:
        """Return the closed jaws for rendering, their tips at the origin."""
        palm = self.palm_place + np.array([0.0, 0.0, self.reach])
        finger = np.array([self.thickness, 0.0, self.length]) / 2
        return _joined(self.models(), [palm, finger, finger * [-1.0, 1.0, 1.0]])


@dataclass(frozen=True)
class SuctionCup:
    """A vacuum cup at the end of a tube.

    A seal needs a surface all around the lip that is flat to within `roughness` of a plane, tilted
    by at most `tilt`. It holds as long as the lip is pressed on everywhere: of the vacuum's force
    F and a load's pull P (negative where it pushes), what is left, F - P, presses the lip on. A
    bending moment of (F - P) radius moves that pressure to the lip's edge and opens the other side;
    friction holds shear and twist. Vacuum is for gentle motion (makers ask for a safety factor of
    two), so it is lifted in twice the time of jaws, and shaken at half their frequency.

    Attributes:
        radius: Of the lip [m].
        vacuum: Below the pressure around [Pa].
        roughness: Largest range of distances from a plane along the lip [m].
        tilt: Largest angle between the surface's normal and the cup's axis [rad].
        stroke: By which the bellows give way [m].
        friction: Sliding coefficient of the lip.
        tube: Radius of the tube [m].
        length: Of cup and tube [m].
        press: Force with which it is pressed on; the largest along each axis while pushing [N].
        pull: Largest force of what carries it [N].
        mass: Of cup and tube [kg].
    """

    radius: float = 0.01
    vacuum: float = 80e3
    roughness: float = 0.0015
    tilt: float = float(np.deg2rad(20.0))
    stroke: float = 0.008
    friction: float = 0.5
    tube: float = 0.008
    length: float = 0.15
    press: float = 30.0
    pull: float = 100.0
    mass: float = 0.3

    @property
    def force(self) -> float:
        """With which the vacuum holds a load [N]."""
        return self.vacuum * float(np.pi) * self.radius**2

    @property
    def reach(self) -> float:
        """How far the cup's lowest point is beyond the grasp centre [m]."""
        return 0.0

    @property
    def boxes(self) -> tuple[tuple[Floats, Floats], ...]:
        """Half the sides and the centre (3,) of what holds cup and tube [m]."""
        half = np.array([self.radius, self.radius, self.length / 2])
        return ((half, np.array([0.0, 0.0, self.length / 2])),)

    @property
    def outline(self) -> tuple[Cylinder, ...]:
        """What cup and tube fill, from the lip upwards."""
        return (Cylinder(self.radius, 0.0, self.length),)

    @property
    def places(self) -> Floats:
        """Centres (2, 3) of lip and tube, in the order of `models` [m]."""
        return np.array([[0.0, 0.0, 0.002], [0.0, 0.0, (self.length + 0.004) / 2]])

    def models(self) -> list[ObjectModel]:
        """Return lip and tube for rendering, each about its own centre."""
        lip = trimesh.creation.cylinder(self.radius, 0.004, sections=24)
        tube = trimesh.creation.cylinder(self.tube, self.length - 0.004, sections=24)
        return [
            _mesh_model("lip", lip, (150, 60, 50)),
            _mesh_model("tube", tube, (84, 88, 98)),
        ]

    def closed_model(self) -> ObjectModel:
        """Return cup and tube for rendering, the lip's middle at the origin."""
        return _joined(self.models(), self.places)


AnyGripper = Gripper | SuctionCup

GRIPPERS: dict[str, AnyGripper] = {
    "jaws-56": Gripper(),
    # Opening, force and speed as in the data sheet of a common adaptive gripper: 85 mm, 20 to
    # 235 N, at most 150 mm/s between the fingers; pads 22 mm wide.
    "jaws-85": Gripper(
        opening=0.085, thickness=0.008, width=0.022, length=0.09, squeeze=60.0, mass=0.9,
        closing=0.57,
    ),
    # Vacuum as in the data sheets of common electric vacuum grippers: up to 80 %.
    "suction": SuctionCup(),
}  # fmt: skip
"""Grippers by name; the published network knows the jaws of 56 mm."""


def gripper_named(name: str) -> AnyGripper:
    """Return a gripper.

    Raises:
        MechSearchError: If there is none of that name.
    """
    if name not in GRIPPERS:
        raise MechSearchError(f"unknown gripper {name!r}; choose one of {', '.join(GRIPPERS)}")
    return GRIPPERS[name]


def open_parts(gripper: AnyGripper, pose: Floats) -> Floats:
    """Return the poses (P, 7) of an open gripper's rendered parts, its frame being at `pose`."""
    centres = apply(transform_from_pose(pose), gripper.places)
    return np.hstack([centres, np.broadcast_to(pose[3:], (len(centres), 4))])


def _box_model(name: str, half: Floats, colour: tuple[int, int, int]) -> ObjectModel:
    return _mesh_model(name, trimesh.creation.box(2 * half), colour)


def _mesh_model(name: str, mesh: trimesh.Trimesh, colour: tuple[int, int, int]) -> ObjectModel:
    vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32)
    texels = np.full((len(faces), 1, 3), colour, np.uint8)
    return ObjectModel(
        name, "robot", vertices, faces, texels, (vertices,), 1.0, np.eye(3), 0.5, 0.0
    )


def _joined(models: Sequence[ObjectModel], places: Sequence[Floats] | Floats) -> ObjectModel:
    """Return one model of several, each at its place (3,)."""
    starts = np.cumsum([0, *(len(model.vertices) for model in models[:-1])])
    vertices = np.concatenate([m.vertices + at for m, at in zip(models, places, strict=True)])
    faces = np.concatenate([m.faces + at for m, at in zip(models, starts, strict=True)])
    texels = np.concatenate([model.texels for model in models])
    return ObjectModel(
        "gripper", "robot", vertices, faces.astype(np.int32), texels, (vertices,), 1.0,
        np.eye(3), 0.5, 0.0,
    )  # fmt: skip


def add_gripper(spec: mujoco.MjSpec, gripper: Gripper, touches: int, table: int) -> None:
    """Add a gripper to a scene: one slide along its approach, one for each finger.

    Args:
        spec: The scene.
        gripper: Its geometry and control.
        touches: Collision bit of the objects.
        table: Collision bit of the table.
    """
    palm = spec.worldbody.add_body()
    palm.name = "gripper"
    set_inertia(palm, gripper.mass)
    add_slide(palm, "approach", (0.0, 0.0, 1.0), (-1.0, 5.0))
    stiffness = 5000.0
    add_servo(spec, "approach", stiffness, gripper.mass, (-gripper.press, gripper.pull))
    _add_box(palm, "palm", gripper.palm_box, gripper.palm_place, gripper, touches | table, touches)
    fingers = "finger0", "finger1"
    for name, side in zip(fingers, (1.0, -1.0), strict=True):
        bits = touches | table, touches
        _add_finger(spec, palm, name, side, gripper.finger_place, gripper, bits)
    _couple(spec, fingers)


def _add_finger(
    spec: mujoco.MjSpec,
    palm: mujoco.MjsBody,
    name: str,
    side: float,
    place: Floats,
    gripper: Gripper,
    bits: tuple[int, int],
    drive: float = 0.0,
) -> None:
    finger = palm.add_body()
    finger.name = name
    finger.pos = place * [side, 1.0, 1.0]
    set_inertia(finger, gripper.finger_mass)
    add_slide(finger, name, (-side, 0.0, 0.0), (0.0, gripper.opening / 2))
    limits = (-gripper.squeeze, gripper.squeeze)
    add_servo(spec, name, 2000.0, gripper.finger_mass + drive, limits)
    finger.joints[0].armature = drive
    _add_box(finger, name, gripper.finger_box, np.zeros(3), gripper, *bits)


def _couple(spec: mujoco.MjSpec, fingers: tuple[str, str]) -> None:
    """Let both fingers travel alike, as one motor drives them."""
    exclusion = spec.add_exclude()
    exclusion.bodyname1, exclusion.bodyname2 = fingers
    coupling = spec.add_equality()
    coupling.type = mujoco.mjtEq.mjEQ_JOINT
    coupling.objtype = mujoco.mjtObj.mjOBJ_JOINT
    coupling.name1, coupling.name2 = fingers
    coupling.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
    coupling.solref, coupling.solimp = _FIRM_TIME, _FIRM


def add_travelling_gripper(
    spec: mujoco.MjSpec, index: int, gripper: Gripper, touches: int, table: int
) -> None:
    """Add a gripper that travels: three slides of its tips, then one for each finger.

    Its orientation is that of the body "wrist" and its number, which no joint turns.

    Args:
        spec: The scene.
        index: Number of the gripper, which ends the names of all its parts.
        gripper: Its geometry and control.
        touches: Collision bit of the objects.
        table: Collision bit of the table.
    """
    wrist = _add_arm(spec, index, gripper.mass + 2 * gripper.finger_mass, gripper.press)
    set_inertia(wrist, gripper.mass)
    tips = np.array([0.0, 0.0, gripper.reach])
    bits = touches | table, touches
    _add_box(wrist, f"palm{index}", gripper.palm_box, gripper.palm_place + tips, gripper, *bits)
    fingers = f"finger{index}{_SIDES[0]}", f"finger{index}{_SIDES[1]}"
    for name, side in zip(fingers, (1.0, -1.0), strict=True):
        _add_finger(spec, wrist, name, side, gripper.finger_place + tips, gripper, bits, _DRIVE)
    _couple(spec, fingers)


def hold_gripper(
    spec: mujoco.MjSpec,
    flange: mujoco.MjsBody,
    gripper: Gripper,
    kind: int,
    affinity: int,
    with_fingers: bool = True,
) -> None:
    """Put a gripper into an arm's hand, its parts named as those of the first that travels.

    It has weight, and between flange and palm a hand like those that are sold, of which nothing is
    to be met by a gripper that no arm carries. The site "tip" is between its closed tips.

    Args:
        spec: The scene.
        flange: Of the arm, z away from it.
        gripper: Its geometry and control.
        kind: Bits of what it is.
        affinity: Bits of what it meets.
        with_fingers: Whether they move; otherwise they stay open.
    """
    wrist = flange.add_body()
    wrist.name = "wrist0"
    wrist.pos, wrist.quat = [0.0, 0.0, HAND_LENGTH], [0.0, 1.0, 0.0, 0.0]
    mass = gripper.mass if with_fingers else gripper.mass + 2 * gripper.finger_mass
    set_inertia(wrist, mass)
    tips = np.array([0.0, 0.0, gripper.reach])
    palm = gripper.palm_place + tips
    wrist.ipos = palm
    _add_box(wrist, "palm0", gripper.palm_box, palm, gripper, kind, affinity)
    hand = wrist.add_geom()
    hand.name = "hand"
    hand.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    low = float(palm[2] + gripper.palm_box[2]) + _HAND_RADIUS
    hand.fromto = [0, 0, low, 0, 0, max(HAND_LENGTH - _HAND_RADIUS, low + 0.001)]
    hand.size = [_HAND_RADIUS, 0, 0]
    hand.friction = [gripper.friction, 0.005, 0.0001]
    hand.contype, hand.conaffinity = kind, affinity
    tip = wrist.add_site()
    tip.name = "tip"
    fingers = f"finger0{_SIDES[0]}", f"finger0{_SIDES[1]}"
    for name, side in zip(fingers, (1.0, -1.0), strict=True):
        place = gripper.finger_place + tips
        if with_fingers:
            _add_finger(spec, wrist, name, side, place, gripper, (kind, affinity), _DRIVE)
            continue
        here = place * [side, 1.0, 1.0]
        _add_box(wrist, name, gripper.finger_box, here, gripper, kind, affinity)
    if with_fingers:
        _couple(spec, fingers)
    for body in (wrist, *wrist.bodies):
        body.gravcomp = 0.0


def close_jaws(model: mujoco.MjModel, data: mujoco.MjData, index: int, gripper: Gripper) -> None:
    """Put the fingers of a travelling gripper where they are when closed on nothing."""
    for side in _SIDES:
        finger = f"finger{index}{side}"
        data.qpos[model.joint(finger).qposadr] = gripper.opening / 2
        data.ctrl[model.actuator(finger).id] = gripper.closed


def _add_arm(spec: mujoco.MjSpec, index: int, mass: float, force: float) -> mujoco.MjsBody:
    """Add what carries a gripper along three axes, and return its wrist."""
    arm = spec.worldbody.add_body()
    arm.name = f"arm{index}"
    set_inertia(arm, 0.1)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        add_slide(arm, f"arm{index}{name}", axis)
        limits = (-force, force)
        servo = add_servo(spec, f"arm{index}{name}", PUSHING_STIFFNESS, 0.1 + mass, limits)
        # An integrated-velocity servo: its set point moves at the commanded velocity.
        servo.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
    wrist = arm.add_body()
    wrist.name = f"wrist{index}"
    set_inertia(wrist, mass)
    return wrist


def stiffen(model: mujoco.MjModel, servos: Sequence[int], stiffness: float) -> None:
    """Give a travelling gripper's servos another stiffness [N/m], critically damped as before."""
    share = stiffness / model.actuator_gainprm[servos, 0]
    model.actuator_gainprm[servos, 0] = stiffness
    model.actuator_biasprm[servos, 1] = -stiffness
    model.actuator_biasprm[servos, 2] *= np.sqrt(share)


def add_travelling_cup(spec: mujoco.MjSpec, index: int, cup: SuctionCup, touches: int) -> None:
    """Add a suction cup that travels, its parts named as those of `add_travelling_gripper`.

    The sensors "force" and "torque" and its number tell what loads the lip, and the equalities
    "seal", its number and an object's are what a seal holds.
    """
    wrist = _add_arm(spec, index, cup.mass, cup.press)
    lip = wrist.add_body()
    lip.name = f"lip{index}"
    set_inertia(lip, 0.01)
    for body, name, radius, low, high in (
        (lip, f"lip{index}", cup.radius, 0.0, 0.004),
        (wrist, f"tube{index}", cup.tube, 0.004, cup.length),
    ):
        geom = body.add_geom()
        geom.name = name
        geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER
        geom.fromto = [0, 0, low, 0, 0, high]
        geom.size = [radius, 0, 0]
        geom.friction = [cup.friction, 0.005, 0.0001]
        geom.priority = 1
        geom.condim = 4
        geom.contype, geom.conaffinity = touches, touches
    site = lip.add_site()
    site.name = f"lip{index}"
    for name, kind in (
        (f"force{index}", mujoco.mjtSensor.mjSENS_FORCE),
        (f"torque{index}", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        sensor = spec.add_sensor()
        sensor.name, sensor.type = name, kind
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site.name


def add_seal(spec: mujoco.MjSpec, index: int, number: int) -> None:
    """Add what can hold an object at a travelling cup's lip; no cup holds anything at first."""
    seal = spec.add_equality()
    seal.name = f"seal{index}object{number}"
    seal.type = mujoco.mjtEq.mjEQ_WELD
    seal.objtype = mujoco.mjtObj.mjOBJ_BODY
    seal.name1, seal.name2 = f"lip{index}", f"object{number}"
    seal.data[10] = 1.0
    seal.active = False


def set_inertia(body: mujoco.MjsBody, mass: float) -> None:
    """Give a part of a robot a mass [kg] without weight: its drive carries it."""
    body.gravcomp = 1.0
    body.mass = mass
    body.inertia = [1e-3, 1e-3, 1e-3]
    body.explicitinertial = True


def add_slide(
    body: mujoco.MjsBody,
    name: str,
    axis: Sequence[float] | Floats,
    limits: tuple[float, float] | None = None,
) -> None:
    """Add a joint that slides along an axis, perhaps between limits [m]."""
    joint = body.add_joint()
    joint.name = name
    joint.type = mujoco.mjtJoint.mjJNT_SLIDE
    joint.axis = axis
    if limits is not None:
        joint.limited = True
        joint.range = limits
        joint.solref_limit, joint.solimp_limit = _FIRM_TIME, _FIRM


def add_servo(
    spec: mujoco.MjSpec, joint: str, stiffness: float, mass: float, limits: tuple[float, float]
) -> mujoco.MjsActuator:
    """Add and return a critically damped position servo of a joint.

    Args:
        spec: The scene.
        joint: Its name.
        stiffness: [N/m].
        mass: What it moves [kg].
        limits: Of its force [N].
    """
    actuator = spec.add_actuator()
    actuator.name = actuator.target = joint
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0] = stiffness
    actuator.biasprm[1] = -stiffness
    actuator.biasprm[2] = -2.0 * float(np.sqrt(stiffness * mass))
    actuator.forcelimited = True
    actuator.forcerange = limits
    return actuator


def _add_box(
    body: mujoco.MjsBody,
    name: str,
    half: Floats,
    place: Floats,
    gripper: Gripper,
    kind: int,
    affinity: int,
) -> None:
    geom = body.add_geom()
    geom.name = name
    geom.type = mujoco.mjtGeom.mjGEOM_BOX
    geom.size, geom.pos = half, place
    geom.friction = [gripper.friction, 0.005, 0.0001]
    # The fingers' own friction counts, not the larger of theirs and the object's.
    geom.priority = 1
    geom.condim = 4
    geom.contype, geom.conaffinity = kind, affinity
