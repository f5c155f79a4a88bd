"""The ceiling of retrieval: a policy that tries its decisions in the simulator first."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from mechsearch.camera import preset
from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.trial import Rollout, imageless, roll_out
from mechsearch.evaluation.policies import RETRIEVE
from mechsearch.grasp.planner import RatedGrasps
from mechsearch.pushes.push import draw_pushes
from mechsearch.pushes.view import PlannedPush, look
from mechsearch.retrieval.grasper import Candidate, Grasper
from mechsearch.retrieval.policies import occluders
from mechsearch.retrieval.proposing import once, pushing
from mechsearch.types import GRASP_KEYS, RETRIEVAL_KEYS, Array, Floats, MechSearchError, Observation

_ACTION = 0.01
"""What each action of a plan costs, in chance."""


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
    """Grasps what would work; else does what would let a grasp work, and then makes that grasp.

    It needs snapshots of the simulator, which no robot has. It tries with the decisions that are
    left, and what it tries is counted apart.
    """

    goal = RETRIEVE
    keys: tuple[str, ...] = RETRIEVAL_KEYS

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
        # Where the target would be seen later is not where it was seen last.
        ahead = copy(self.grasper)
        ways = []
        for rollout in self._rollouts(start, obs):
            plan = list(rollout.actions)
            if rollout.end == "retrieved":
                return plan
            if rollout.end is not None or not plan:
                continue
            end = self._twin.snapshot()
            seen = ahead.view(self._eyes.restore(end))
            after = self._apart(ahead.candidates(seen), config.after)
            chance = after[0].quality if after else 0.0
            grasp = self._working(end, after)
            worth = (grasp is not None, chance - _ACTION * len(plan))
            ways.append((worth, plan if grasp is None else [*plan, grasp]))
        if ways:
            return max(ways, key=itemgetter(0))[1]
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
            self._twin.restore(start)
            self.simulated_actions += 1
            if self._twin.step(vector)[4]["retrieved"]:
                return vector
        return None

    def _rollouts(self, start: dict[str, Array], obs: Observation) -> Iterator[Rollout]:
        """Yield what removals and pushes come to, the twin being where each of them ends."""
        proposals = [*map(once, self._removals(obs)), *map(pushing, self._pushes(obs))]
        for propose in proposals:
            rollout = roll_out(self._twin, self._twin.restore(start), propose)
            self.simulated_actions += len(rollout.actions)
            yield rollout

    def _removals(self, obs: Observation) -> list[Decision]:
        if not obs["removals_left"][0]:
            return []
        found = []
        for occluder in occluders(obs["grasp_depth"], obs["segments"])[: self.config.removals]:
            view = self.grasper.view(obs, occluder.segment)
            best = self._apart(self.grasper.candidates(view, False), 1)
            found += [Decision.remove(each.pose, each.gripper) for each in best]
        return found

    def _pushes(self, obs: Observation) -> list[PlannedPush]:
        if not obs["pushes_left"][0]:
            return []
        task = self._twin.config
        sight = look(obs, preset(task.camera, task.image_size))
        if sight.centre is None:
            sight = replace(sight, centre=self.grasper.middle(self.grasper.view(obs)))
        return [PlannedPush(push, sight) for push in draw_pushes(self.config.pushes, self._rng)]
