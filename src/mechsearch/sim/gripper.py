"""Grippers in the simulator: what they look like, and their bodies, joints and servos."""

from collections.abc import Sequence

import mujoco
import numpy as np
import trimesh

from mechsearch.geometry import apply, transform_from_pose
from mechsearch.grippers import PUSHING_STIFFNESS, AnyGripper, Gripper, SuctionCup
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Floats

# With the engine's defaults the squeeze drives the light fingers a centimetre past their stops.
_FIRM_TIME, _FIRM = [0.01, 1.0], [0.99, 0.999, 0.0005, 0.5, 2.0]


_SIDES = "left", "right"

_DRIVE = 2.0
"""Inertia of a travelling gripper's geared drive, as its fingers feel it [kg]: what slips out of
them is not shot away."""

GRASPING_STIFFNESS = 20000.0
"""Of what carries a travelling gripper while it grasps, along each axis [N/m]."""


HAND_LENGTH = 0.2
"""From an arm's flange to the tips of the gripper that it holds [m], as long as the pusher."""

_HAND_RADIUS = 0.035
"""Of what is between flange and palm [m]."""


def gripper_models(gripper: AnyGripper) -> list[ObjectModel]:
    """Return a gripper's parts for rendering, each about its own centre; see its `places`.

    Jaws are palm and both fingers, a suction cup is lip and tube.
    """
    if isinstance(gripper, Gripper):
        return [
            _box_model("palm", gripper.palm_box, (84, 88, 98)),
            _box_model("finger0", gripper.finger_box, (38, 40, 46)),
            _box_model("finger1", gripper.finger_box, (38, 40, 46)),
        ]
    lip = trimesh.creation.cylinder(gripper.radius, 0.004, sections=24)
    tube = trimesh.creation.cylinder(gripper.tube, gripper.length - 0.004, sections=24)
    return [
        _mesh_model("lip", lip, (150, 60, 50)),
        _mesh_model("tube", tube, (84, 88, 98)),
    ]


def closed_gripper_model(gripper: AnyGripper) -> ObjectModel:
    """Return a closed gripper for rendering: tips, or the middle of the lip, at the origin."""
    if isinstance(gripper, SuctionCup):
        return _joined(gripper_models(gripper), gripper.places)
    palm = gripper.palm_place + np.array([0.0, 0.0, gripper.reach])
    finger = np.array([gripper.thickness, 0.0, gripper.length]) / 2
    return _joined(gripper_models(gripper), [palm, finger, finger * [-1.0, 1.0, 1.0]])


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
