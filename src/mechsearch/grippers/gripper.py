"""Grippers: parallel jaws, of a palm and two coupled fingers, and a suction cup; presets by name.

A gripper's frame has its origin at the grasp centre, x along the closing direction and z against
the approach, so a gripper that points straight down has its z axis up. Of a suction cup, the grasp
centre is the middle of its lip.
"""

from dataclasses import dataclass

import numpy as np

from mechsearch.types import Floats, MechSearchError

PUSHING_STIFFNESS = 2000.0
"""Of what carries a travelling gripper while it pushes, along each axis [N/m]: as soft as the
pusher."""


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
