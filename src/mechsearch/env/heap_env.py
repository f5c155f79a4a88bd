"""The decision process: nudge a heap until its target is uncovered (paper, section III-A)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np

from mechsearch.env.reward import reward_of
from mechsearch.env.scene import HeapScene, SceneEnv, choose_heaps, displacement
from mechsearch.env.scene import HeapState as HeapState
from mechsearch.env.scene import start_options as start_options
from mechsearch.env.task import HeapEnvConfig, with_settings
from mechsearch.env.task import TaskConfig as TaskConfig
from mechsearch.env.task import task_from_json as task_from_json
from mechsearch.heaps.dataset import Heap
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.sim import FREE, ArmWorld, HeapWorld, arm_named, heap_world, pusher_model
from mechsearch.types import Array, Floats, MechSearchError, check_extra

_UNSEEN = -1.0
"""Average chance of being uncovered before any look; see `segmenter.Judge.averaged`."""


class HeapEnv(SceneEnv[HeapWorld]):
    """Episodes over a list of heaps.

    `reset(options=...)` takes `heap`, the index of the heap, and `fixed_start`, whether the end
    effector starts where this heap's own seed says, so that all policies start alike.
    `info` holds `reward_terms`, `occlusion`, `end` (None while the episode goes on, else
    "uncovered", "stopped", "action limit", "lost" or "failure: ..."), `failure` (a simulator
    failure's name or None: such a transition must not be learnt from), `clutter_moved` (mean
    displacement of the non-target objects in this action [m]) and `target_moved` [m]. Where an arm
    pushes, there are also `refused`, the reason for which it did not move or None, and `motion`, a
    `sim.ArmMotion`. "stopped" is the end where the task's `stop` looks at images.

    Attributes:
        on_demand: Whether `step` returns images that are made only when they are read, which has to
            be before the next action: a mapping, and no dict. Whoever acts by whole pushes reads
            one image in eight.
    """

    on_demand = False

    def __init__(
        self,
        heaps: Sequence[Heap],
        objects: ObjectSet,
        config: HeapEnvConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Prepare the task; nothing is simulated yet.

        Args:
            heaps: Start states.
            objects: The set that the heaps' names refer to.
            config: The task.
            render_mode: "rgb_array" or None.

        Raises:
            MechSearchError: If there is no heap, one names an unknown object, the reward's function
                is no good, `config` or `render_mode` is none, or what an arm needs is missing.
        """
        self.config = HeapEnvConfig() if config is None else config
        super().__init__(self.config, HeapEnvConfig, render_mode)
        if self.config.robot != FREE:
            check_extra(f"robot {self.config.robot!r}", "arms")
        self._scene = HeapScene(
            heaps, objects, self.config, self.config.all_keys, self._world_of,
            pusher_model(self.config.pusher),
        )  # fmt: skip
        self.heaps, self.objects = self._scene.heaps, objects
        self._reward, terms = reward_of(self.config.reward)
        self.no_reward = dict.fromkeys(terms, 0.0)
        self.observation_space = self._scene.observer.space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._actions, self._sure, self._over = 0, _UNSEEN, True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode.

        Raises:
            MechSearchError: If an option is unknown or no good.
            RuntimeError: If the heap does not come to rest in the task's engine.
        """
        super().reset(seed=seed)
        scene = self._scene
        index = scene.reset(self.np_random, options)
        self._actions, self._sure = 0, _UNSEEN
        self._over = False
        return scene.observe(0), {"occlusion": scene.occlusion, "heap": index}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Execute one action.

        Raises:
            MechSearchError: If the action is malformed, or the episode is over.
        """
        offset = displacement(action)
        if self._over:
            raise MechSearchError("the episode is over; call reset before the next step")
        scene, config = self._scene, self.config
        command = scene.world.pusher_position + offset
        target = config.workspace.clip(command)
        before = scene.occlusion
        failure = scene.push(target)
        self._actions += 1
        clutter, target_moved = scene.clutter, scene.target_moved
        if failure is not None:
            # The last trusted state is shown, and no reward given.
            return self._result(
                self.no_reward, clutter, target_moved, f"failure: {failure}", failure
            )
        reward = self._reward(
            before, scene.occlusion, clutter, target_moved,
            max(map(abs, (command - target).tolist())) > 1e-9, config.uncovered_at, config.reward,
        )  # fmt: skip
        return self._result(reward, clutter, target_moved, self._end())

    def snapshot(self) -> dict[str, Array]:
        """Return all that the rest of the episode depends on, as arrays."""
        counts = {"actions": np.array(self._actions), "over": np.array(self._over)}
        if self._scene.judge is not None:
            counts["sure"] = np.array(self._sure)
        return self._scene.snapshot() | counts

    def restore(self, snapshot: dict[str, Array]) -> dict[str, Array]:
        """Return to a snapshot, exactly; return its observation.

        Raises:
            MechSearchError: If it is none of an environment of this kind with the same heaps.
        """
        judged = () if self._scene.judge is None else ("sure",)
        counts = self._scene.restore(snapshot, ("actions", "over", *judged))
        self._actions, over, self._sure = (*counts, _UNSEEN)[:3]
        self._over = bool(over)
        return self._scene.observe(self._actions)

    def _world_of(self, models: Sequence[ObjectModel]) -> HeapWorld:
        config, arm = self.config, arm_named(self.config.robot)
        if arm is not None:
            return ArmWorld(models, arm, config.workspace, config.pusher, config.physics)
        return heap_world(config.engine, models, config.workspace, config.pusher, config.physics)

    def _end(self) -> str | None:
        """Return how the episode ends with an action that physics survived, or None."""
        scene, config = self._scene, self.config
        if not scene.target_is_present:
            return "lost"
        if config.simulator_stops and scene.occlusion <= config.uncovered_at:
            return "uncovered"
        if scene.judge is not None:
            self._sure = scene.judge.averaged(self._sure, scene.chance_uncovered(self._actions))
            if scene.judge.ends(self._sure):
                return "stopped"
        return "action limit" if self._actions >= config.max_actions else None

    def _result(
        self,
        reward: Mapping[str, float],
        clutter: Floats,
        target_moved: float,
        end: str | None,
        failure: str | None = None,
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        scene = self._scene
        self._over, terminated = end is not None, end in ("lost", "uncovered", "stopped")
        info = {
            "reward_terms": dict(reward),
            "occlusion": scene.occlusion,
            "end": end,
            "failure": failure,
            "clutter_moved": float(clutter.sum()) / max(len(clutter), 1),
            "target_moved": target_moved,
        }
        if scene.world.motion is not None:
            info |= {"refused": scene.world.motion.refusal, "motion": scene.world.motion}
        truncated = self._over and not terminated
        observe = scene.observe_on_demand if self.on_demand else scene.observe
        return (
            cast(dict[str, Array], observe(self._actions)),
            float(sum(reward.values())),
            terminated,
            truncated,
            info,
        )


def make_env(
    condition: str = "single",
    heaps: str | Path | None = None,
    objects: str = "household",
    split: str = "train",
    config: HeapEnvConfig | None = None,
    render_mode: str | None = None,
    **settings: Any,
) -> HeapEnv:
    """Return an environment.

    Args:
        condition: "single" or "dual"; chooses among the embedded heaps.
        heaps: Heap set file; None takes the embedded heaps of household objects.
        objects: Object set that the heaps were made with.
        split: "held-out", "train" or "all" of the heaps.
        config: The task.
        render_mode: "rgb_array" or None.
        settings: Fields of the configuration to replace, such as `privileged=True`.

    Raises:
        MechSearchError: If a name or setting is unknown, or heaps and objects do not fit.
    """
    chosen, object_set, camera = choose_heaps(condition, heaps, objects, split)
    task = with_settings(HeapEnvConfig, config, camera, settings)
    return HeapEnv(chosen, object_set, task, render_mode)
