"""The ceiling of retrieval: a policy that tries its decisions in the simulator first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mechsearch.camera import preset
from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.trial import from_start, imageless, roll_out
from mechsearch.evaluation.policies import RETRIEVE
from mechsearch.grasp.planner import RatedGrasps
from mechsearch.pushes.push import draw_pushes
from mechsearch.pushes.view import PlannedPush, look
from mechsearch.retrieval.grasper import Candidate, Grasper
from mechsearch.retrieval.policies import occluders
from mechsearch.types import ACTOR_KEYS, GRASP_KEYS, Array, Floats, MechSearchError, Observation


@dataclass(frozen=True)
class OracleConfig:
    """How much to try.

    Attributes:
        grasps: Grasps tried where the target lies, with each gripper.
        pushes: Pushes tried where none of them works.
        removals: Objects whose removal is tried then.
        after: Grasps tried after each of those.
    """

    grasps: int = 12
    pushes: int = 16
    removals: int = 2
    after: int = 3


class RetrieveOracle:
    """Grasps what would work; else does what would let a grasp work, by the fewest actions.

    It needs snapshots of the simulator, which no robot has. What it tries is counted apart.
    """

    goal = RETRIEVE
    keys: tuple[str, ...] = (*ACTOR_KEYS, *GRASP_KEYS)

    def __init__(self, config: OracleConfig | None = None) -> None:
        """Set how much to try."""
        self.config = config or OracleConfig()
        self.grasper = Grasper()
        self.simulated_actions = 0
        self._env: RetrieveEnv | None = None

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers; see `Grasper.equip`."""
        self.grasper.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; what is tried is drawn from `rng`."""
        self._rng = rng
        self.grasper.reset(rng)
        self._left: list[Array] = []
        self.simulated_actions = 0

    def plan(self, env: RetrieveEnv) -> None:
        """Take the environment whose future is tried."""
        if env is not self._env:
            self._env, self._twin = env, imageless(env)
            self._eyes = RetrieveEnv(
                env.heaps, env.objects, replace(env.config, keys=GRASP_KEYS, privileged=False)
            )

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision.

        Raises:
            MechSearchError: If it was not handed its environment.
        """
        if self._env is None:
            raise MechSearchError("the oracle tries in the simulator; expected plan(env) first")
        if not self._left:
            self._left = self._best(self._env.snapshot(), obs)[::-1]
        return np.asarray(self._left.pop(), np.float64)

    def _best(self, start: dict[str, Array], obs: Observation) -> list[Array]:
        """Return what to do from here."""
        config, view = self.config, self.grasper.view(obs)
        here = self._apart(self.grasper.candidates(view), config.grasps)
        if (found := self._working(start, here)) is not None:
            return [found]
        plans = [*self._removals(obs), *self._pushes(start, obs)]
        ways = []
        for plan in plans:
            end = self._end(start, plan)
            if end is None:
                continue
            seen = self._eyes.restore(end)
            after = self._apart(self.grasper.candidates(self.grasper.view(seen)), config.after)
            works = self._working(end, after) is not None
            best = after[0].quality if after else 0.0
            ways.append((works, best - 0.01 * len(plan), plan))
        if ways:
            return max(ways, key=lambda way: way[:2])[2]
        candidate = (here or [self.grasper.blind(view)])[0]
        self.grasper.remember(view, candidate)
        return [Decision.grasp(candidate.pose, candidate.gripper).vector()]

    def _apart(self, candidates: Sequence[Candidate], count: int) -> list[Candidate]:
        """Return the best grasps of each gripper of which no two are alike."""
        kept = []
        for number in range(len(self.grasper.grippers)):
            own = [c for c in candidates if c.gripper == number]
            poses = np.array([c.pose for c in own]).reshape(-1, 7)
            best = RatedGrasps(poses, np.array([c.quality for c in own])).apart(count)
            pairs = zip(best.poses, best.quality.tolist(), strict=True)
            kept += [Candidate(number, pose, quality) for pose, quality in pairs]
        return sorted(kept, key=lambda candidate: -candidate.quality)

    def _working(self, start: dict[str, Array], tried: Sequence[Candidate]) -> Array | None:
        """Return the first grasp that retrieves the target from a state."""
        for candidate in tried:
            vector = Decision.grasp(candidate.pose, candidate.gripper).vector()
            self._twin.restore(from_start(start))
            self.simulated_actions += 1
            if self._twin.step(vector)[4]["retrieved"]:
                return vector
        return None

    def _removals(self, obs: Observation) -> list[list[Array]]:
        plans: list[list[Array]] = []
        for occluder in occluders(obs["grasp_depth"], obs["segments"])[: self.config.removals]:
            view = self.grasper.view(obs, occluder.segment)
            for candidate in self._apart(self.grasper.candidates(view, False), 1):
                plans.append([Decision.remove(candidate.pose, candidate.gripper).vector()])
        return plans

    def _pushes(self, start: dict[str, Array], obs: Observation) -> list[list[Array]]:
        task = self._twin.config
        sight = look(obs, preset(task.camera, task.image_size))
        if sight.centre is None:
            sight = replace(sight, centre=self.grasper.middle(self.grasper.view(obs)))
        plans = []
        for push in draw_pushes(self.config.pushes, self._rng):
            planned = PlannedPush(push, sight)

            def propose(seen: Observation, planned: PlannedPush = planned) -> Array | None:
                action = planned.act(seen)
                return None if action is None else Decision.push(action).vector()

            rollout = roll_out(self._twin, self._twin.restore(from_start(start)), propose)
            self.simulated_actions += len(rollout.actions)
            if rollout.end is None and rollout.actions:
                plans.append(rollout.actions)
        return plans

    def _end(self, start: dict[str, Array], plan: Sequence[Array]) -> dict[str, Array] | None:
        """Return where a plan leads, at rest, or None where it ends the episode."""
        self._twin.restore(from_start(start))
        for vector in plan:
            info = self._twin.step(vector)[4]
            self.simulated_actions += 1
            if info["end"] is not None:
                return None
        return self._twin.snapshot()
