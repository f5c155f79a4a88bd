"""The decision process of retrieval: push, grasp and put aside until the target is in the hand."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from mechsearch.env.decision import Decision, DecisionSpace, reachable
from mechsearch.env.scene import HeapScene, SceneEnv, choose_heaps, displacement
from mechsearch.env.task import RetrieveConfig, with_settings
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grasp.grasp_scene import numbered
from mechsearch.grippers import Gripper, grasp_camera, gripper_named
from mechsearch.heaps.dataset import Heap
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.observe.observation import KEYS, KINDS, without_holes
from mechsearch.sim import (
    FREE,
    ArmGripperWorld,
    GripperWorld,
    LiftFrame,
    Perturbation,
    arm_named,
    closed_gripper_model,
    perturbed,
)
from mechsearch.types import (
    BUDGET_KEYS,
    DECISION_NAMES,
    GRASP,
    GRASP_KEYS,
    OCCLUSION_KEY,
    PUSH,
    REMOVE,
    USED_UP,
    Array,
    Floats,
    MechSearchError,
    Outcome,
    check_extra,
)


class RetrieveEnv(SceneEnv[GripperWorld | ArmGripperWorld]):
    """Episodes over a list of heaps, each until the target is in the hand.

    An action is the vector (9,) of a `Decision`, and is carried out to its end. A push moves the
    closed jaws of the first gripper by at most 5 cm. A grasp, of the target, and a removal, of any
    other object, descend, close, lift and shake; then

    - the target alone in the hand ends the episode: "retrieved";
    - of a removal, all else that came up goes into a tray, off the table;
    - anything else is lowered to where it was, and released; the gripper leaves, the heap settles.

    The episode ends with "budget" when no grasp is left, or when a decision is of a kind of which
    none is left, which is then not carried out; with "lost" when the target leaves the table; and
    with "failure: ..." when physics fails, which counts as no success and must not be learnt from.
    `reset(options=...)` takes what `HeapEnv.reset` takes.

    `info` holds `reward_terms`, `occlusion`, `end`, `failure`, `clutter_moved` and `target_moved`
    as in `HeapEnv`, where what is lifted off the table has not moved; and `outcome` ("" of a push,
    a value of `types.Outcome`, or "used up"; a removal that put something aside is a success),
    `held` (indices of the objects that came up), `retrieved`, and the numbers so far of `pushes`,
    `grasps`, `removals` and `wrong_objects` (grasps that brought up others without the target).
    Of an arm there are also `refused` and `motion` as in `HeapEnv`; a refused grasp is "blocked".

    Attributes:
        film: Takes the frames of grasps and removals, if it is a list.
    """

    def __init__(
        self,
        heaps: Sequence[Heap],
        objects: ObjectSet,
        config: RetrieveConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Prepare the task; nothing is simulated yet.

        Args:
            heaps: Start states.
            objects: The set that the heaps' names refer to.
            config: The task.
            render_mode: "rgb_array" or None.

        Raises:
            MechSearchError: If there is no heap, one names an unknown object, a key is unknown,
                `config` or `render_mode` is none, or what an arm needs is missing.
        """
        self.config = RetrieveConfig() if config is None else config
        super().__init__(self.config, RetrieveConfig, render_mode)
        if self.config.robot != FREE:
            check_extra(f"robot {self.config.robot!r}", "arms")
        self.film: list[LiftFrame] | None = None
        keys, own = self.config.all_keys, (*GRASP_KEYS, *BUDGET_KEYS, OCCLUSION_KEY)
        unknown = [key for key in keys if key not in (*KEYS, *own)]
        if unknown:
            raise MechSearchError(
                f"unknown observation key {unknown[0]!r}; choose among {', '.join((*KEYS, *own))}"
            )
        self._grippers = [gripper_named(name) for name in self.config.grippers]
        self._scene = HeapScene(
            heaps, objects, self.config, [key for key in keys if key not in own], self._world_of,
            closed_gripper_model(self._grippers[0]), robot_in_view=False,
        )  # fmt: skip
        self.heaps, self.objects = self._scene.heaps, objects
        self.observation_space = gymnasium.spaces.Dict(self._spaces())
        self.action_space = DecisionSpace(len(self._grippers), self.config.workspace)
        self._spent, self._wrong, self._over = [0, 0, 0], 0, True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode; see `HeapEnv.reset`."""
        super().reset(seed=seed)
        index = self._scene.reset(self.np_random, options)
        self._spent, self._wrong, self._over = [0, 0, 0], 0, False
        return self._observe(), {"occlusion": self._scene.occlusion, "heap": index}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Carry out one decision.

        Raises:
            MechSearchError: If the action is no decision, a grasp is out of reach, or the episode
                is over.
        """
        decision = Decision.of(action)
        self._check(decision)
        if self._over:
            raise MechSearchError("the episode is over; call reset before the next step")
        scene, kind = self._scene, decision.kind
        if not self._left(kind):
            scene.stay()
            return self._result(USED_UP, (), "budget")
        self._spent[kind] += 1
        outcome, held, failure = self._push(decision) if kind == PUSH else self._grasp(decision)
        if failure is not None:
            return self._result(outcome, (), f"failure: {failure}", failure)
        end = None
        if held == (scene.heap.target,):
            end = "retrieved"
        elif not scene.target_is_present:
            end = "lost"
        elif not self._left(GRASP):
            end = "budget"
        return self._result(outcome, held, end)

    def snapshot(self) -> dict[str, Array]:
        """Return all that the rest of the episode depends on, as arrays."""
        return self._scene.snapshot() | {
            "actions": np.array(self._spent[PUSH]),
            "grasps": np.array(self._spent[GRASP]),
            "removals": np.array(self._spent[REMOVE]),
            "wrong_objects": np.array(self._wrong),
            "over": np.array(self._over),
        }

    def restore(self, snapshot: dict[str, Array]) -> dict[str, Array]:
        """Return to a snapshot, exactly; return its observation; see `HeapEnv.restore`."""
        names = ("actions", "grasps", "removals", "wrong_objects", "over")
        *self._spent, self._wrong, over = self._scene.restore(snapshot, names)
        self._over = bool(over)
        return self._observe()

    def _world_of(self, models: Sequence[ObjectModel]) -> GripperWorld | ArmGripperWorld:
        config, arm, jaws = self.config, arm_named(self.config.robot), self._grippers[0]
        if arm is not None and isinstance(jaws, Gripper):
            return ArmGripperWorld(models, arm, config.workspace, jaws, config.physics)
        return GripperWorld(models, self._grippers, config.workspace, config.physics)

    def _check(self, decision: Decision) -> None:
        """Refuse what no gripper of this robot can reach."""
        names, workspace = self.config.grippers, self.config.workspace
        if not 0 <= decision.gripper < len(names):
            raise MechSearchError(
                f"gripper {decision.gripper} does not exist; choose 0 to {len(names) - 1} of "
                f"{', '.join(names)}"
            )
        if decision.kind != PUSH and not reachable(np.array(decision.numbers), workspace):
            x, y, z, *quaternion = decision.numbers
            up = float(rotation_from_quaternion(quaternion)[2, 2])
            raise MechSearchError(
                f"a {DECISION_NAMES[decision.kind]} at ({x:.3f}, {y:.3f}, {z:.3f}) m, tilted by "
                f"{np.rad2deg(np.arccos(np.clip(up, -1, 1))):.0f} degrees, is out of reach; "
                f"expected x and y within {workspace.table_half} m of the middle, a height up to "
                f"{workspace.high} m, and a tilt up to 60 degrees"
            )

    def _left(self, kind: int) -> int:
        """Return how many decisions of a kind are left."""
        config = self.config
        most = (config.max_actions, config.max_grasps, config.max_removals)
        return most[kind] - self._spent[kind]

    def _push(self, decision: Decision) -> tuple[str, tuple[int, ...], str | None]:
        """Carry out a push; the result is like that of `_grasp`."""
        command = self._scene.world.pusher_position + displacement(np.array(decision.numbers))
        return "", (), self._scene.push(self.config.workspace.clip(command))

    def _grasp(self, decision: Decision) -> tuple[str, tuple[int, ...], str | None]:
        """Carry out a grasp or a removal; return its outcome, what came up, and a failure."""
        scene, target = self._scene, self._scene.heap.target
        world, removal = scene.world, decision.kind == REMOVE
        pose, friction = self._executed(decision)
        attempt = world.attempt(target, pose, decision.gripper, friction, self.film)
        if world.motion is not None and world.motion.refusal is not None:
            scene.stay()
            return str(attempt.outcome), (), None
        if attempt.outcome == Outcome.FAILURE:
            name = world.failure() or "grasp"
            scene.go_back()
            return str(Outcome.FAILURE), (), name
        held = attempt.held
        away = held if held == (target,) or (removal and target not in held) else ()
        outcome = Outcome.SUCCESS if away else attempt.outcome
        if not away:
            world.release(self.film)
        elif (stowed := world.stow(self.film)) != away:
            # What fell on its way to the tray is not there.
            held = away = stowed
            outcome = Outcome.DROPPED
        world.settle()
        failure = scene.look(away)
        if failure is not None:
            return str(Outcome.FAILURE), (), failure
        self._wrong += bool(held) and not removal and target not in held
        return str(outcome), held, None

    def _executed(self, decision: Decision) -> tuple[Floats, float | None]:
        """Return the pose (7,) that a grasp really has, and its friction; None is the usual one."""
        pose = np.array(decision.numbers)
        if not self.config.perturbed:
            return pose, None
        number = self._spent[GRASP] + self._spent[REMOVE]
        rng = np.random.default_rng([self.heap.seed, 2, number])
        return perturbed(pose, rng, Perturbation())

    def _spaces(self) -> dict[str, gymnasium.Space[Any]]:
        """Return the space of each key, in their order."""
        seen, side = self._scene.observer.space.spaces, grasp_camera().height
        keys = self.config.all_keys
        return {key: seen[key] if key in seen else KINDS[key].space(G=side) for key in keys}

    def _observe(self) -> dict[str, Array]:
        scene, keys = self._scene, self.config.all_keys
        step = sum(self._spent)
        seen = scene.observe(step)
        if any(key in GRASP_KEYS for key in keys):
            poses = scene.poses.copy()
            # What is gone is out of view.
            poses[~scene.present, 0] += 10.0
            depth, seen["segments"], _ = scene.sense(
                grasp_camera(), step, poses, None,
                lambda frame: numbered(frame.ids, len(poses), scene.heap.target)[0], level=True,
            )  # fmt: skip
            seen["grasp_depth"] = without_holes(depth, "grasp_depth", most=1.0)
        for kind, key in enumerate(BUDGET_KEYS):
            seen[key] = np.array([self._left(kind)])
        seen[OCCLUSION_KEY] = np.array([scene.occlusion])
        return {key: seen[key] for key in keys}

    def _result(
        self,
        outcome: str,
        held: tuple[int, ...],
        end: str | None,
        failure: str | None = None,
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        scene, weights = self._scene, self.config.retrieval
        clutter, retrieved = scene.clutter, end == "retrieved"
        clutter_moved = float(clutter.sum()) / max(len(clutter), 1)
        self._over, terminated = end is not None, end in ("lost", "retrieved")
        terms = {
            "retrieved": weights.retrieved * retrieved,
            "actions": -weights.action,
            "clutter_movement": -weights.movement * clutter_moved,
        }
        if failure is not None:
            terms = dict.fromkeys(terms, 0.0)
        info = {
            "reward_terms": terms,
            "occlusion": scene.occlusion,
            "end": end,
            "failure": failure,
            "clutter_moved": clutter_moved,
            "target_moved": scene.target_moved,
            "outcome": outcome,
            "held": held,
            "retrieved": retrieved,
            "pushes": self._spent[PUSH],
            "grasps": self._spent[GRASP],
            "removals": self._spent[REMOVE],
            "wrong_objects": self._wrong,
        }
        if scene.world.motion is not None:
            info |= {"refused": scene.world.motion.refusal, "motion": scene.world.motion}
        truncated = self._over and not terminated
        return self._observe(), float(sum(terms.values())), terminated, truncated, info


def make_retrieve_env(
    condition: str = "single",
    heaps: str | Path | None = None,
    objects: str = "household",
    split: str = "train",
    config: RetrieveConfig | None = None,
    render_mode: str | None = None,
    **settings: Any,
) -> RetrieveEnv:
    """Return an environment of retrieval; arguments and errors are those of `make_env`."""
    chosen, object_set, camera = choose_heaps(condition, heaps, objects, split)
    task = with_settings(RetrieveConfig, config, camera, settings)
    return RetrieveEnv(chosen, object_set, task, render_mode)
