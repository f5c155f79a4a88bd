"""What the grasps of any gripper come to: those chosen, those drawn, and all of them together.

A grasp that a quality network chose has to beat the first random one that geometry alone promises:
in the heap as dropped, after pushes, and with the target alone. How many targets a robot could
retrieve at all is the share that any of many grasps lifts, once all clutter is gone.
"""

import multiprocessing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch

from mechsearch.evaluation.episodes import (
    ATTEMPTS,
    CEILING_METRICS,
    SummaryRow,
    share_interval,
)
from mechsearch.grasp.grasp_scene import grasp_renderer, see_heap
from mechsearch.grasp.learning.states import STATE_KINDS, states_of
from mechsearch.grasp.planner import GraspPlanner
from mechsearch.grippers import (
    LEAST_VISIBLE,
    GraspView,
    gripper_named,
    height_map,
    propose,
    segment_view,
)
from mechsearch.heaps.dataset import Heap, object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import Progress, map_in_order, silent
from mechsearch.retrieval.assessment import LiftResult
from mechsearch.sim import GripperWorld, LiftFrame, Perturbation, perturbed
from mechsearch.types import Array, Floats, MechSearchError, Outcome

LIFT_STATES = ("dropped", "pushed", "alone")
"""In which a target is grasped: see `states.STATE_KINDS`."""


@dataclass(frozen=True)
class Robot:
    """Grippers, and what rates their grasps.

    Attributes:
        grippers: By name; the first one pushes.
        networks: File of each one's network; none takes the shipped ones.
    """

    grippers: tuple[str, ...]
    networks: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        for name in self.grippers:
            gripper_named(name)
        if not self.grippers or len(self.networks) not in (0, len(self.grippers)):
            raise MechSearchError(
                f"{len(self.networks)} networks for {len(self.grippers)} grippers; expected one "
                "for each of at least one gripper, or none for the shipped ones"
            )

    def planners(self) -> list[GraspPlanner]:
        """Return one for each gripper.

        Raises:
            MechSearchError: If a network is missing, damaged, or of another gripper or version.
        """
        files = self.networks or (None,) * len(self.grippers)
        return [_planner(name, file) for name, file in zip(self.grippers, files, strict=True)]


@dataclass(frozen=True, eq=False)
class TargetLifts:
    """What became of one target in one state, grasped in two ways by one gripper.

    Attributes:
        heap: Seed of the heap.
        state: One of `LIFT_STATES`.
        present: Which of the heap's objects are there (n,), indices; the target is one of them.
        poses: Of theirs (n, 7).
        grasp: The best-rated one (7,), or None where there is none.
        quality: As rated; not a number where there is no grasp.
        chosen: What it came to; None where there is none.
        drawn: What the first random grasp that geometry promises came to; None likewise.
    """

    heap: int
    state: str
    present: Array
    poses: Floats
    grasp: Floats | None
    quality: float
    chosen: LiftResult | None
    drawn: LiftResult | None


@dataclass(frozen=True)
class LiftPlan:
    """Which grasps to try.

    Attributes:
        objects: Object set, as given to `load_object_set`.
        robot: With one gripper.
        states: In which of `LIFT_STATES`.
        repeats: Executions of each grasp with errors of place, direction and friction, beside the
            exact one.
        seed: Of pushes, proposals and perturbations.
    """

    objects: str
    robot: Robot
    states: tuple[str, ...] = LIFT_STATES
    repeats: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        unknown = set(self.states) - set(LIFT_STATES)
        if unknown or not self.states:
            raise MechSearchError(
                f"unknown states {', '.join(sorted(unknown)) or 'none'}; choose some of "
                f"{', '.join(LIFT_STATES)}"
            )
        if self.repeats < 0:
            raise MechSearchError(f"{self.repeats} repeats; expected 0 or more")


def lift_targets(
    heaps: Sequence[Heap], plan: LiftPlan, workers: int = 1, progress: Progress = silent
) -> list[TargetLifts]:
    """Return what became of the targets of heaps, in every state that came to rest.

    Args:
        heaps: Of the plan's objects.
        plan: Which grasps to try.
        workers: Processes; the results do not depend on their number.
        progress: Told after each heap.

    Raises:
        MechSearchError: If there is no network of the gripper.
    """
    # A network that is no good is refused before any work.
    plan.robot.planners()
    found: list[TargetLifts] = []
    for done, lifts in enumerate(map_in_order(partial(_lifted, plan), heaps, workers), start=1):
        found += lifts
        progress("heaps lifted from", done, len(heaps))
    return found


def film_target(
    heap: Heap, plan: LiftPlan, lifts: TargetLifts
) -> tuple[list[LiftFrame], list[ObjectModel], int]:
    """Return the film of a chosen grasp, the models in it, and the target's place among them."""
    models = [_models(heap, plan.objects)[i] for i in lifts.present]
    world = GripperWorld(models, [gripper_named(plan.robot.grippers[0])])
    film: list[LiftFrame] = []
    place = int(np.flatnonzero(lifts.present == heap.target)[0])
    if lifts.grasp is not None:
        world.try_grasp(lifts.poses, place, lifts.grasp, film=film)
    return film, models, place


@dataclass(frozen=True)
class Reach:
    """Which of a target's grasps retrieve it once all clutter is gone.

    Attributes:
        rank: Of the best-rated one that does, from 1; 0 where none of those tried does.
        retrievable: Whether any grasp does, geometric ones included.
    """

    rank: int
    retrievable: bool

    def scores(self) -> dict[str, bool]:
        """Return each of `CEILING_METRICS`."""
        within = {name: 0 < self.rank <= most for name, most in ATTEMPTS.items()}
        return {**within, "retrievable": self.retrievable}


@dataclass(frozen=True)
class CeilingConfig:
    """How many grasps to try on each target.

    Attributes:
        rated: The best apart, of each gripper.
        geometric: More that geometry alone promises, of each gripper.
        seed: Of the proposals.
    """

    rated: int = 30
    geometric: int = 150
    seed: int = 0

    def __post_init__(self) -> None:
        if self.rated < 1 or self.geometric < 0:
            raise MechSearchError(
                f"{self.rated} rated and {self.geometric} geometric grasps; expected at least 1 "
                "and 0"
            )


def reach_of(
    heaps: Sequence[Heap],
    objects: str,
    robot: Robot,
    config: CeilingConfig,
    workers: int = 1,
    progress: Progress = silent,
) -> list[Reach]:
    """Return which of the grasps on each heap's target work, all clutter removed.

    Args:
        heaps: The heaps.
        objects: Object set, as given to `load_object_set`.
        robot: Whose grasps, of all grippers together.
        config: How many.
        workers: Processes; the results do not depend on their number.
        progress: Told after each heap.

    Raises:
        MechSearchError: If there is no network of a gripper.
    """
    robot.planners()
    reach = partial(_reach, objects=objects, robot=robot, config=config)
    found: list[Reach] = []
    for each in map_in_order(reach, heaps, workers):
        found.append(each)
        progress("targets tried", len(found), len(heaps))
    return found


def ceiling_rows(
    experiment: str, condition: str, robot: Robot, seed: int, found: Sequence[Reach]
) -> list[SummaryRow]:
    """Return the rows that a ceiling enters into a summary, one for each of `CEILING_METRICS`."""
    variant = "-".join(("ceiling", *robot.grippers))
    scores = [each.scores() for each in found]
    rows = []
    for name in CEILING_METRICS:
        share = share_interval([each[name] for each in scores])
        numbers = share.mean, share.ci_low, share.ci_high
        rows.append(SummaryRow(experiment, condition, variant, seed, 0, name, *numbers))
    return rows


@dataclass(frozen=True, eq=False)
class _Scene:
    """A target in one state: its view, and a world to grasp it in."""

    kind: int
    present: Array
    poses: Floats
    place: int
    view: GraspView
    world: GripperWorld


def _scenes(
    heap: Heap, objects: str, robot: Robot, kinds: Sequence[str], seed: int
) -> Iterator[_Scene]:
    """Yield a heap's target in some of `LIFT_STATES`, if it came to rest there."""
    models = _models(heap, objects)
    renderer = grasp_renderer(models)
    rng = np.random.default_rng([seed, heap.seed])
    alone = (heap.target,) if "alone" in kinds else ()
    for state in states_of(models, heap.poses, rng, 0, int("pushed" in kinds), alone):
        if STATE_KINDS[state.kind] in kinds:
            seen = see_heap(renderer, state.poses, heap.target)
            world = GripperWorld(
                [models[i] for i in state.present], [gripper_named(g) for g in robot.grippers]
            )
            yield _Scene(
                state.kind, state.present, state.poses[state.present],
                int(np.flatnonzero(state.present == heap.target)[0]),
                segment_view(seen.depth, seen.segments), world,
            )  # fmt: skip


def _lifted(plan: LiftPlan, heap: Heap) -> list[TargetLifts]:
    """Return what became of one heap's target, a pure function of its arguments."""
    planner, found = plan.robot.planners()[0], []
    for scene in _scenes(heap, plan.objects, plan.robot, plan.states, plan.seed):
        rng = np.random.default_rng([plan.seed, heap.seed, scene.kind])
        rated, drawn = planner.plan(scene.view, rng), planner.drawn(scene.view, rng)
        best = rated.poses[0] if len(rated) else None
        quality = float(rated.quality[0]) if len(rated) else float("nan")
        errors = [plan.seed, heap.seed, scene.kind, 1]
        chosen, first = (_executed(scene, pose, plan.repeats, errors) for pose in (best, drawn))
        found.append(TargetLifts(
            heap.seed, STATE_KINDS[scene.kind], scene.present, scene.poses, best, quality, chosen,
            first,
        ))  # fmt: skip
    return found


def _executed(
    scene: _Scene, pose: Floats | None, repeats: int, errors: Sequence[int]
) -> LiftResult | None:
    """Return what a grasp comes to, all grasps of a state with the same errors."""
    if pose is None:
        return None
    rng, world = np.random.default_rng(errors), scene.world
    planned = world.try_grasp(scene.poses, scene.place, pose)
    draws = [perturbed(pose, rng, Perturbation()) for _ in range(repeats)]
    return LiftResult(planned, tuple(
        world.try_grasp(scene.poses, scene.place, near, friction=friction)
        for near, friction in draws
    ))  # fmt: skip


def _reach(heap: Heap, objects: str, robot: Robot, config: CeilingConfig) -> Reach:
    """Return which grasps on one target work, a pure function of its arguments."""
    for scene in _scenes(heap, objects, robot, ("alone",), config.seed):
        rng = np.random.default_rng([config.seed, heap.seed, scene.kind])
        rated = [
            (quality, number, pose)
            for number, planner in enumerate(robot.planners())
            for found in (planner.plan(scene.view, rng).apart(config.rated),)
            for quality, pose in zip(found.quality.tolist(), found.poses, strict=True)
        ]
        rated.sort(key=lambda grasp: -grasp[0])
        for rank, (_, number, pose) in enumerate(rated, start=1):
            if _works(scene, pose, number):
                return Reach(rank, True)
        if scene.view.mask.sum() >= LEAST_VISIBLE and config.geometric:
            heights = height_map(scene.view)
            for number, gripper in enumerate(scene.world.grippers):
                proposed = propose(heights, rng, config.geometric, gripper)
                if any(_works(scene, pose, number) for pose in proposed):
                    return Reach(0, True)
    return Reach(0, False)


def _works(scene: _Scene, pose: Floats, gripper: int) -> bool:
    outcome = scene.world.try_grasp(scene.poses, scene.place, pose, gripper)
    return outcome is Outcome.SUCCESS


def _models(heap: Heap, objects: str) -> list[ObjectModel]:
    known = object_set(objects).models
    return [known[name] for name in heap.objects]


@lru_cache(maxsize=4)
def _planner(gripper: str, network: Path | None) -> GraspPlanner:
    """Return a planner, loaded once in each process."""
    if multiprocessing.parent_process() is not None:
        # Workers share the processors; more threads in each would only get in their way.
        torch.set_num_threads(1)
    return GraspPlanner(gripper, network)
