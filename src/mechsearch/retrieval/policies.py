"""Policies that retrieve without having learnt to: grasp; uncover and grasp; clear and grasp.

Their ceiling is the oracle, which tries its decisions in the simulator first.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from mechsearch.camera import preset
from mechsearch.env import (
    Decision,
    RetrieveEnv,
    Rollout,
    TaskConfig,
    imageless,
    once,
    pushing,
    roll_out,
)
from mechsearch.evaluation.policies import RETRIEVE, policy_named
from mechsearch.grippers import GraspView, RatedGrasps
from mechsearch.pushes.push import PlannedPush, draw_pushes, look
from mechsearch.retrieval.grasper import Candidate, Grasper, occluders, weighed_grasps
from mechsearch.types import (
    ACTOR_KEYS,
    BUDGET_KEYS,
    GRASP_KEYS,
    OCCLUSION_KEY,
    RETRIEVAL_KEYS,
    Array,
    Floats,
    MechSearchError,
    Observation,
    Weighed,
    select,
)

_SAME = 0.02
"""Distance between the poses, as vectors (7,), up to which two removals are the same."""


class GraspOnly:
    """Grasps the target again and again, the best-rated way; what failed is rated lower."""

    goal = RETRIEVE
    keys: tuple[str, ...] = (*GRASP_KEYS, *BUDGET_KEYS)

    def __init__(self) -> None:
        """Begin without a gripper; see `equip`."""
        self.grasper = Grasper()
        self._found: Sequence[Candidate] = ()

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers; see `Grasper.equip`."""
        self.grasper.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; proposals come from `rng`."""
        self.grasper.reset(rng)
        self._found = ()

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        return self.grasp(self.grasper.view(obs))

    @property
    def weighed(self) -> Weighed | None:
        """The grasps that the last decision was chosen among; see `Weighed`."""
        return weighed_grasps(self._found)

    def grasp(self, view: GraspView) -> Floats:
        """Return the vector (9,) of the most promising grasp of the target."""
        found = self.grasper.candidates(view) or [self.grasper.blind(view)]
        self._found = found
        self.grasper.remember(view, found[0])
        return Decision.grasp(found[0].pose, found[0].gripper).vector()


class UncoverThenGrasp(GraspOnly):
    """Pushes by a shipped policy until the simulator says that the target is uncovered.

    A robot has no such word: that is this baseline's advantage.
    """

    keys: tuple[str, ...] = (*ACTOR_KEYS, *GRASP_KEYS, *BUDGET_KEYS, OCCLUSION_KEY)

    def __init__(
        self, pusher: str = "uncover", uncovered_at: float = TaskConfig.uncovered_at
    ) -> None:
        """Take who pushes, as for `make_policy`, and from which occlusion on it need not."""
        super().__init__()
        self._pusher, self._uncovered_at = policy_named(pusher), uncovered_at
        # Who pushes sees through one camera alone.
        self.camera = getattr(self._pusher, "camera", None)
        self.image_size = getattr(self._pusher, "image_size", None)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; pushes and proposals come from `rng`."""
        super().reset(rng)
        self._pusher.reset(rng)
        self._uncovered = False

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        self._uncovered |= float(obs[OCCLUSION_KEY][0]) <= self._uncovered_at
        if self._uncovered or not obs["pushes_left"][0]:
            return super().act(obs)
        return Decision.push(self._pusher.act(select(obs, self._pusher.keys))).vector()

    @property
    def weighed(self) -> Weighed | None:
        """What the last decision was chosen among: pushes, or grasps."""
        return super().weighed or getattr(self._pusher, "weighed", None)


class ClearThenGrasp(GraspOnly):
    """Puts aside what lies on the target, the topmost first, and then grasps it.

    It is the classical heuristic of mechanical search.
    """

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; proposals come from `rng`."""
        super().reset(rng)
        self._tried: list[Floats] = []

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        self._found = ()
        if obs["removals_left"][0]:
            for occluder in occluders(obs["grasp_depth"], obs["segments"]):
                view = self.grasper.view(obs, occluder.segment)
                untried = [c for c in self.grasper.candidates(view, False) if self._is_new(c)]
                if untried:
                    self._tried.append(untried[0].pose)
                    return Decision.remove(untried[0].pose, untried[0].gripper).vector()
        return super().act(obs)

    def _is_new(self, candidate: Candidate) -> bool:
        away = [np.linalg.norm(candidate.pose - pose) for pose in self._tried]
        return bool(min(away, default=np.inf) > _SAME)


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
