"""A policy that weighs pushes, removals and grasps by the chance to have the target in the end."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import binary_dilation

from mechsearch.algorithm import at_least
from mechsearch.camera import preset
from mechsearch.env import Decision, TaskConfig
from mechsearch.evaluation.policies import RETRIEVE
from mechsearch.grippers import GraspView, height_map, surroundings
from mechsearch.pushes.push import PlannedPush, Sight, draw_pushes, look
from mechsearch.retrieval.grasper import TARGET, Candidate, Grasper, occluders, weighed_grasps
from mechsearch.retrieval_values.value import RetrievalValue
from mechsearch.retrieval_values.view import (
    Option,
    PushOption,
    RemovalOption,
    Situation,
    view_options,
)
from mechsearch.types import (
    GRASP,
    PUSH,
    REMOVE,
    RETRIEVAL_KEYS,
    Array,
    Floats,
    Observation,
    Weighed,
)

_AROUND = 14
"""Pixels about the target within which another object may be in the way [px]."""

_SAME = 0.015
"""A removal nearer than this to one that was made is the same [m]."""


@dataclass(frozen=True)
class RetrievePolicyConfig:
    """How decisions are made.

    Attributes:
        pushes: Random pushes to judge each time.
        removals: Objects around the target to judge the removal of.
        proposals: Grasps of the target that are rated with each gripper.
        least: Chance of its best grasp from which an object's removal is considered.
        sure: Chance from which on a grasp is made at once.
        action: What a push action costs, in chance.
        removal: What a removal costs, in chance.
        clearing: What it is worth, in chance, that an object is gone which lies on the target:
            the network judges the next grasp alone, and more may have to go before that.
        clutter: What each metre of moved clutter costs, in chance.
        margin: By how much an option must promise more than grasping at once.
        camera: View of the images, a name for `camera.preset`.
        image_size: Side of the images [px].
    """

    pushes: int = 48
    removals: int = 4
    proposals: int = 100
    least: float = 0.2
    sure: float = 0.9
    action: float = 0.02
    removal: float = 0.03
    clearing: float = 0.5
    clutter: float = 1.0
    margin: float = 0.05
    camera: str = TaskConfig.camera
    image_size: int = TaskConfig.image_size

    def __post_init__(self) -> None:
        at_least(0, self, "pushes", "removals")
        at_least(1, self, "proposals")


class RetrievePolicy:
    """Grasps, or pushes or removes first where that promises a better grasp."""

    goal = RETRIEVE
    keys: tuple[str, ...] = RETRIEVAL_KEYS

    def __init__(self, networks: Sequence[RetrievalValue], config: RetrievePolicyConfig) -> None:
        """Keep copies of the networks.

        Args:
            networks: Whose mean counts; without any, options are drawn by chance.
            config: How decisions are made.
        """
        self.networks = [copy.deepcopy(network).eval() for network in networks]
        self.config = config
        self.camera = preset(config.camera, config.image_size)
        self.grasper = Grasper(config.proposals)
        self.reset(np.random.default_rng(0))

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers; see `Grasper.equip`."""
        self.grasper.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; pushes and proposals come from `rng`."""
        self._rng = rng
        self._push: PlannedPush | None = None
        self._removed: list[Floats] = []
        self._judged: tuple[Sequence[Option], Floats] | None = None
        self.weighed: Weighed | None = None
        self.grasper.reset(rng)

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        action = None if self._push is None else self._push.act(obs)
        self.weighed = None
        if action is not None and obs["pushes_left"][0]:
            return Decision.push(action).vector()
        self._push = None
        decided = self.decide(obs)
        if isinstance(decided, Candidate):
            return Decision.grasp(decided.pose, decided.gripper).vector()
        if isinstance(decided, RemovalOption):
            return Decision.remove(decided.grasp.pose, decided.grasp.gripper).vector()
        self._push = decided.begun()
        action = self._push.act(obs)
        return Decision.push(np.zeros(3) if action is None else action).vector()

    def decide(self, obs: Observation) -> Option | Candidate:
        """Return what to do next, and remember it: an option, or a grasp of the target."""
        view = self.grasper.view(obs)
        grasps = self.grasper.candidates(view)
        self._judged = None
        if not grasps or grasps[0].quality < self.config.sure:
            option = self._better(obs, view, grasps)
            if option is not None:
                if isinstance(option, RemovalOption):
                    self._removed.append(option.grasp.pose[:3])
                self.weighed = self._compared(grasps, option)
                return option
        self.weighed = self._compared(grasps, None)
        return self.grasp(view, grasps)

    def _compared(self, grasps: Sequence[Candidate], decided: Option | None) -> Weighed | None:
        """Return what was weighed: grasps of the target, then the options that were judged."""
        found = weighed_grasps(grasps)
        if self._judged is None:
            return found if decided is None else None
        options, worth = self._judged
        kinds = [REMOVE if isinstance(o, RemovalOption) else PUSH for o in options]
        ways = [o.grasp.pose if isinstance(o, RemovalOption) else o.planned.way for o in options]
        kept, values = ((), ()) if found is None else (found.ways, found.values)
        chosen = 0 if decided is None else len(kept) + options.index(decided)
        return Weighed(
            (*[GRASP] * len(kept), *kinds), (*kept, *ways), np.concatenate([values, worth]),
            chosen, f"chance to grasp the target {'' if found is None else 'now, or '}afterwards",
        )  # fmt: skip

    def grasp(self, view: GraspView, grasps: Sequence[Candidate]) -> Candidate:
        """Return the best grasp, a blind one where there is none, and remember it."""
        best = grasps[0] if grasps else self.grasper.blind(view)
        self.grasper.remember(view, best)
        return best

    def _better(
        self, obs: Observation, view: GraspView, grasps: Sequence[Candidate]
    ) -> Option | None:
        """Return the option that promises more than grasping at once, if there is one."""
        options = self.options(obs, view)
        if not options:
            return None
        if not view.mask.any():
            # Nothing is known of a hidden target but where it was: what lies there goes first.
            removals = [option for option in options if isinstance(option, RemovalOption)]
            return max(removals, key=lambda o: o.height) if removals else options[0]
        situation = self.situation(view, grasps)
        worth = self.judge(options, situation)
        self._judged = options, worth
        first = int(np.argmax(worth))
        return options[first] if worth[first] > situation.chance + self.config.margin else None

    def situation(self, view: GraspView, grasps: Sequence[Candidate]) -> Situation:
        """Return what decisions about a visible target are made from."""
        return Situation(height_map(view), self.grasper.middle(view)[:2], grasps)

    def options(self, obs: Observation, view: GraspView) -> list[Option]:
        """Return pushes and removals that could be made: as many as are left and configured."""
        found: list[Option] = []
        if obs["removals_left"][0]:
            found += self._removals(obs, view)
        if obs["pushes_left"][0]:
            sight = self.sight(obs, view)
            pushes = draw_pushes(self.config.pushes, self._rng)
            found += [PushOption.plan(push, sight) for push in pushes]
        return found

    def sight(self, obs: Observation, view: GraspView) -> Sight:
        """Return what pushes are planned in; a hidden target counts as where it was seen last."""
        sight = look(obs, self.camera)
        centre = self.grasper.middle(view) if sight.centre is None else sight.centre
        return replace(sight, centre=centre)

    def judge(self, options: Sequence[Option], situation: Situation) -> Floats:
        """Return what options are worth (n,): the chance afterwards, with gains, less costs."""
        config = self.config
        views = view_options(options, situation)
        patches, numbers = torch.from_numpy(views.patches), torch.from_numpy(views.numbers)
        found = [network.predict(patches, numbers) for network in self.networks]
        if not found:
            return self._rng.uniform(0, 1, len(options))
        chance = torch.stack([o.chance for o in found]).mean(dim=0).double().numpy()
        clutter = torch.stack([o.clutter_moved for o in found]).mean(dim=0).double().numpy()
        removes = np.array([isinstance(option, RemovalOption) for option in options])
        actions = np.array([option.actions for option in options])
        clears = np.array([
            option.grasp.quality * option.occludes if isinstance(option, RemovalOption) else 0.0
            for option in options
        ])  # fmt: skip
        cost = config.action * actions + config.removal * removes + config.clutter * clutter
        return np.asarray(chance + config.clearing * clears - cost)

    def _removals(self, obs: Observation, view: GraspView) -> list[Option]:
        """Return what could be put aside: objects about the target, those closest to it first."""
        segments, found = obs["segments"], list[Option]()
        covering = {occluder.segment for occluder in occluders(obs["grasp_depth"], segments)}
        for number in self._around(segments, view):
            own = self.grasper.view(obs, number)
            grasps = [c for c in self.grasper.candidates(own, False) if self._is_new(c)]
            if grasps and grasps[0].quality >= self.config.least:
                rows, columns = (axis[::4] for axis in np.nonzero(own.mask))
                points = own.camera.points_at(columns, rows, own.depth[rows, columns])
                top = float(points[:, 2].max())
                found.append(RemovalOption(grasps[0], points[:, :2], top, number in covering))
        return found

    def _around(self, segments: Array, view: GraspView) -> list[int]:
        """Return the segments with the most pixels about the target's visible part.

        A hidden target counts as one pixel, where it was seen last.
        """
        mask = view.mask
        if not mask.any():
            mask = np.zeros_like(mask)
            column, row, _ = view.camera.project(self.grasper.middle(view)[None])[0]
            mask[round(row), round(column)] = True
        part = surroundings(mask, _AROUND + 1)
        near = binary_dilation(mask[part], iterations=_AROUND)
        numbers = segments[part]
        count = np.bincount(numbers[near & (numbers > TARGET)], minlength=TARGET + 1)
        order = np.argsort(-count, kind="stable")[: self.config.removals]
        return [int(number) for number in order if count[number]]

    def _is_new(self, candidate: Candidate) -> bool:
        away = [np.linalg.norm(candidate.pose[:3] - place) for place in self._removed]
        return bool(min(away, default=np.inf) > _SAME)
