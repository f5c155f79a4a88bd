"""A floating parallel-jaw gripper: a palm that moves along its approach, and two coupled fingers.

The gripper's frame has its origin at the grasp centre, x along the closing direction and z against
the approach, so a gripper that points straight down has its z axis up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from mechsearch.objects.model import ObjectModel
from mechsearch.types import Floats, MechSearchError

# With the engine's defaults the squeeze drives the light fingers a centimetre past their stops.
_FIRM_TIME, _FIRM = [0.01, 1.0], [0.99, 0.999, 0.0005, 0.5, 2.0]


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

    def __post_init__(self) -> None:
        if not 0.01 <= self.opening <= 0.2:
            raise MechSearchError(
                f"a gripper that opens {self.opening} m; expected 0.01 to 0.2 m, such as 0.056"
            )

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

    def models(self) -> list[ObjectModel]:
        """Return palm and both fingers for rendering, each about its own centre."""
        return [
            _box_model("palm", self.palm_box, (84, 88, 98)),
            _box_model("finger0", self.finger_box, (38, 40, 46)),
            _box_model("finger1", self.finger_box, (38, 40, 46)),
        ]


def _box_model(name: str, half: Floats, colour: tuple[int, int, int]) -> ObjectModel:
    box = trimesh.creation.box(2 * half)
    vertices, faces = np.array(box.vertices, np.float64), np.array(box.faces, np.int32)
    texels = np.full((len(faces), 1, 3), colour, np.uint8)
    return ObjectModel(
        name, "robot", vertices, faces, texels, (vertices,), 1.0, np.eye(3), 0.5, 0.0
    )


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
    for i, side in enumerate((1.0, -1.0)):
        finger = palm.add_body()
        finger.name = f"finger{i}"
        finger.pos = gripper.finger_place * [side, 1.0, 1.0]
        set_inertia(finger, gripper.finger_mass)
        add_slide(finger, f"finger{i}", (-side, 0.0, 0.0), (0.0, gripper.opening / 2))
        limits = (-gripper.squeeze, gripper.squeeze)
        add_servo(spec, f"finger{i}", 2000.0, gripper.finger_mass, limits)
        bits = touches | table, touches
        _add_box(finger, f"finger{i}", gripper.finger_box, np.zeros(3), gripper, *bits)
    exclusion = spec.add_exclude()
    exclusion.bodyname1, exclusion.bodyname2 = "finger0", "finger1"
    # Both fingers travel alike, as one motor drives them.
    coupling = spec.add_equality()
    coupling.type = mujoco.mjtEq.mjEQ_JOINT
    coupling.objtype = mujoco.mjtObj.mjOBJ_JOINT
    coupling.name1, coupling.name2 = "finger0", "finger1"
    coupling.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
    coupling.solref, coupling.solimp = _FIRM_TIME, _FIRM


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
