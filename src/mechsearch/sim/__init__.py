"""Physics: the world, its workspace, the pusher, and settling."""

from mechsearch.sim.arm import ARMS, FREE, Arm, ArmMotion, arm_named
from mechsearch.sim.arm_gripper_world import ArmGripperWorld
from mechsearch.sim.arm_world import ArmWorld, links_of, shown_at
from mechsearch.sim.gripper import closed_gripper_model, gripper_models, open_parts
from mechsearch.sim.gripper_world import GripperWorld
from mechsearch.sim.lift import LiftFrame, LiftWorld, Perturbation, perturbed
from mechsearch.sim.scene import PhysicsConfig, Pusher, Wall, Workspace, pusher_model
from mechsearch.sim.world import (
    AWAKE,
    ENGINE_VERSION,
    ENGINES,
    REST_LIMIT,
    HeapWorld,
    World,
    drift,
    engine_version,
    heap_world,
    settle,
)
