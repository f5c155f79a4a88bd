"""`mechsearch grasp score`, `lift`, with `--gripper` too, and `ceiling`; all need PyTorch."""

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mechsearch.cli.command import (
    PICTURES,
    OfObjects,
    Parallel,
    bars,
    save,
    say,
    say_table,
    wrote,
)
from mechsearch.evaluation.episodes import (
    CEILING_METRICS,
    Estimate,
    check_summary,
    mean_interval,
    merge_summary,
    share_interval,
)
from mechsearch.files import write_json
from mechsearch.findings.bootstrap import estimated
from mechsearch.grasp.depth_image import read_view
from mechsearch.grasp.grasp_scene import view_of_heap
from mechsearch.grasp.graspability import rate
from mechsearch.grippers import check_opening, gripper_named
from mechsearch.heaps.dataset import Heap, HeapSet, open_heaps
from mechsearch.pictures.canvas import tiled
from mechsearch.pictures.grasps import draw_grasps, lift_strip
from mechsearch.retrieval.assessment import (
    GraspAssessment,
    GraspTask,
    LiftResult,
    assess_all,
    film_lift,
    shared_network,
    summarise,
    tasks_of_heaps,
)
from mechsearch.retrieval.lifting import (
    LIFT_STATES,
    CeilingConfig,
    LiftPlan,
    Robot,
    TargetLifts,
    ceiling_rows,
    film_target,
    lift_targets,
    reach_of,
)
from mechsearch.types import MechSearchError, Outcome


@dataclass(frozen=True, kw_only=True)
class GraspTargets(OfObjects):
    """Whose grasps a command is about.

    Attributes:
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        opening: Of the gripper [m], 0.05 to 0.06.
    """

    network: Path | None = None
    split: str = "held-out"
    limit: int = 0
    opening: float = 0.056

    def tasks(self, path: Path) -> tuple[list[Heap], list[GraspTask]]:
        """Return the heaps, and for each the task to try the best grasp on its target."""
        options = (self.objects, self.split, self.limit, self.network, self.opening)
        return tasks_of_heaps(path, *options)


@dataclass(frozen=True, kw_only=True)
class ScoreGrasps(GraspTargets):
    """Rate the grasps on targets, in the heaps of a set or in a depth image of your own.

    Attributes:
        heaps: Heap set (.parquet).
        depth: Depth image [m]: .npy, 16-bit .png, float .tif, or .npz with `depth`, `mask` and `K`;
            instead of heaps.
        mask: The target in that image: .npy, a picture, or .npz.
        label: The target's value in a mask of several.
        intrinsics: Its camera [px]: .json or .yaml with fx, fy, cx, cy, or a matrix, such as a ROS
            CameraInfo; or a matrix in .npy or .txt.
        depth_scale: Metres for one unit of the depth image; 0.001 for millimetres.
        out: Picture (.png, .jpg or .webp) of the best grasps to write.
    """

    writes = (("out", PICTURES),)

    heaps: Path | None = None
    depth: Path | None = None
    mask: Path | None = None
    label: int | None = None
    intrinsics: Path | None = None
    depth_scale: float = 1.0
    out: Path | None = None

    def run(self) -> None:
        """Print scores and draw grasps."""
        if self.depth and not self.heaps:
            pictures = [self._score_image(self.depth)]
        elif self.heaps and not self.depth:
            pictures = self._score_heaps(self.heaps)
        else:
            raise MechSearchError("name either --heaps, or --depth with --mask and --intrinsics")
        if self.out:
            save(self.out, tiled(pictures, 4, margin=3).save)

    def _score_heaps(self, path: Path) -> list[Image.Image]:
        heaps, tasks = self.tasks(path)
        tasks = [replace(task, best=0, alone=True) for task in tasks]
        with bars() as progress:
            found = assess_all(tasks, progress=progress)
        columns = ("target", "objects", "occlusion", "graspability", "ten apart", "ceiling")
        rows = []
        for heap, task, a in zip(heaps, tasks, found, strict=True):
            scores = (a.now.score, a.now.diverse, a.alone.score if a.alone else np.nan)
            rows.append((*_target(task), f"{heap.occlusion:.0%}", *map("{:.3f}".format, scores)))
        say_table("Graspability of each target", columns, rows)
        means = summarise(found)
        say(
            f"mean graspability {means.graspability:.3f} over {len(heaps)} heaps ({means.hidden} "
            f"with no visible target), ceiling {means.ceiling:.3f}"
        )
        return [_picture(*drawn) for drawn in zip(tasks, found, strict=True)] if self.out else []

    def _score_image(self, depth: Path) -> Image.Image:
        check_opening(self.opening)
        with warnings.catch_warnings(record=True, action="always", category=UserWarning) as noted:
            files = (depth, self.mask, self.intrinsics, self.depth_scale, self.label)
            view, camera = read_view(*files)
        for each in noted:
            say(f"note: {each.message}")
        ratings = rate(shared_network(self.network), view)
        mean, apart = ratings.graspability.score, ratings.best_apart()
        count = len(ratings.best())
        say(f"graspability {mean:.3f}, the mean quality of the {count} best grasps")
        columns = ("column", "row", "depth [m]", "angle [deg]", "quality", "x y z [m]")
        rows = []
        for g in apart:
            place = g.pose(view.camera)[:3]
            # In the image as it was brought; the view may have been resized.
            column, row, z = camera.project(place)
            cells = f"{column:.0f}", f"{row:.0f}", f"{z:.3f}", f"{np.rad2deg(g.angle):.0f}"
            rows.append((*cells, f"{g.quality:.3f}", " ".join(map("{:+.3f}".format, place))))
        say_table("Best grasps that differ, in the camera's frame", columns, rows)
        return draw_grasps(view, apart, f"graspability {mean:.2f}")


@dataclass(frozen=True, kw_only=True)
class LiftGrasps(GraspTargets, Parallel):
    """Lift each target with the grasp that a network finds best, in simulation.

    With `--gripper NAME`, of any gripper: `--gripper NAME --help` tells its options.

    Attributes:
        heaps: Heap set (.parquet).
        out: Picture (.png, .jpg or .webp) to write: a strip of frames for each heap.
        repeats: Perturbed executions of each grasp.
        seed: Of the perturbations.
    """

    writes = (("out", PICTURES),)

    heaps: Path
    out: Path | None = None
    repeats: int = 5
    seed: int = 0

    def run(self) -> None:
        """Plan, lift, print outcomes and draw."""
        if self.repeats < 0:
            raise MechSearchError(f"{self.repeats} repeats; expected 0 or more")
        _, tasks = self.tasks(self.heaps)
        seeds = [np.random.SeedSequence([self.seed, task.heap_seed]) for task in tasks]
        tasks = [
            replace(task, repeats=self.repeats, seed=int(seed.generate_state(1)[0]))
            for task, seed in zip(tasks, seeds, strict=True)
        ]
        with bars() as progress:
            found = assess_all(tasks, self.workers, progress)
        columns = ("target", "objects", "graspability", "as planned", "perturbed")
        rows = []
        for task, a in zip(tasks, found, strict=True):
            planned, share = a.retrieved or "not visible", a.lifts[0].probability if a.lifts else 0
            rows.append((*_target(task), f"{a.now.score:.2f}", planned, f"{share:.0%}"))
        say_table("The best grasp on each target, executed", columns, rows)
        means = summarise(found)
        say(", ".join(f"{name} {count}" for name, count in means.outcomes.items()))
        say(
            f"retrieval {means.retrieved:.0%} of {len(tasks)} targets as planned, "
            f"{means.probability:.0%} of all perturbed executions"
        )
        if self.out:
            strips = [_strip(task, a) for task, a in zip(tasks, found, strict=True) if a.lifts]
            if not strips:
                raise MechSearchError("no target is visible in these heaps: there is no film")
            save(self.out, tiled(strips, 1, gap=0).save)


def _picture(task: GraspTask, found: GraspAssessment) -> Image.Image:
    view, (name, _) = view_of_heap(task.models, task.poses, task.target), _target(task)
    if not found.now.visible:
        # Nothing to draw on the target: the whole image, without grasps.
        view = replace(view, mask=np.ones_like(view.mask))
        return draw_grasps(view, [], f"{name}: not visible", task.opening, margin=0)
    grasps = rate(shared_network(task.network), view).best_apart()
    return draw_grasps(view, grasps, f"{name}: {found.now.score:.2f}", task.opening)


def _strip(task: GraspTask, found: GraspAssessment) -> Image.Image:
    assert found.now.best is not None
    models, gripper = task.models, task.gripper
    outcome, film = film_lift(models, task.poses, task.target, found.now.best, gripper)
    return lift_strip(film, models, gripper, task.target, f"{_target(task)[0]}: {outcome}")


def _target(task: GraspTask) -> tuple[str, str]:
    return task.names[task.target].replace("_", " "), str(len(task.names))


@dataclass(frozen=True, kw_only=True)
class GripperTargets(OfObjects, Parallel):
    """Whose grasps a command is about.

    Attributes:
        heaps: Heap set (.parquet).
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        seed: Of all randomness.
    """

    heaps: Path
    split: str = "held-out"
    limit: int = 0
    seed: int = 0

    def opened(self) -> tuple[HeapSet, list[Heap], str]:
        """Return the heap set, the heaps that are meant, and their object set."""
        heap_set, _ = open_heaps(self.heaps, self.objects)
        heaps = [heap_set.heaps[i] for i in heap_set.choose(self.split, self.limit)]
        return heap_set, heaps, self.objects or heap_set.objects


@dataclass(frozen=True, kw_only=True)
class LiftChosen(GripperTargets):
    """Lift each target with the best-rated grasp, and with the first that geometry promises.

    Both are tried in the heap as dropped, after random pushes and with the target alone. Where
    there is no grasp to try, the target is not lifted.

    Attributes:
        gripper: By name: jaws-56, jaws-85 or suction.
        network: Its quality network (.safetensors), to take instead of the shipped one.
        states: Some of dropped, pushed and alone.
        repeats: Executions of each grasp with errors of place, direction and friction, beside the
            exact one.
        out: Picture (.png, .jpg or .webp) to write: of each heap, a strip of frames of the
            best-rated grasp, in the first state.
        table: File (.json) to write: the shares and their differences.
    """

    writes = (("out", PICTURES), ("table", (".json",)))

    gripper: str
    network: Path | None = None
    states: tuple[str, ...] = LIFT_STATES
    repeats: int = 0
    out: Path | None = None
    table: Path | None = None

    def run(self) -> None:
        """Plan, lift, print outcomes and draw."""
        networks = (self.network,) if self.network else ()
        robot = Robot((self.gripper,), networks)
        _, heaps, objects = self.opened()
        plan = LiftPlan(objects, robot, self.states, self.repeats, self.seed)
        with bars() as progress:
            found = lift_targets(heaps, plan, self.workers, progress)
        rows, table = [], []
        for state in self.states:
            own = [lifts for lifts in found if lifts.state == state]
            for executed in ("as planned", "perturbed") if self.repeats else ("as planned",):
                if own:
                    row = _gain(own, executed == "perturbed")
                    table.append({"state": state, "executed": executed, **row})
                    rows.append((state, executed, str(len(own)), *_cells(row)))
        columns = ("state", "executed", "targets", "best-rated", "first drawn", "gain")
        say_table(f"Share of targets that {self.gripper} lifts", columns, rows)
        self._say_outcomes(found)
        if self.table:
            write_json(self.table, {"gripper": self.gripper, "seed": self.seed, "rows": table})
            wrote(self.table)
        if self.out:
            self._draw(self.out, heaps, plan, found)

    def _say_outcomes(self, found: Sequence[TargetLifts]) -> None:
        tried = [str(lifts.chosen.planned) for lifts in found if lifts.chosen]
        counts = {name: tried.count(name) for name in map(str, Outcome) if name in tried}
        counts["no grasp"] = len(found) - len(tried)
        said = ", ".join(f"{name} {count}" for name, count in counts.items())
        none = sum(lifts.drawn is None for lifts in found)
        say(f"best-rated: {said}\nfirst drawn: no grasp {none}")

    def _draw(
        self, path: Path, heaps: Sequence[Heap], plan: LiftPlan, found: Sequence[TargetLifts]
    ) -> None:
        by_seed = {heap.seed: heap for heap in heaps}
        strips = []
        for lifts in found:
            if lifts.state == self.states[0] and lifts.chosen:
                heap = by_seed[lifts.heap]
                film, models, place = film_target(heap, plan, lifts)
                name = heap.objects[heap.target].replace("_", " ")
                caption = f"{name}: {lifts.quality:.2f}, {lifts.chosen.planned}"
                gripper = gripper_named(self.gripper)
                strips.append(lift_strip(film, models, gripper, place, caption))
        if not strips:
            raise MechSearchError("no target can be grasped in these heaps: there is no film")
        save(path, tiled(strips, 1, gap=0).save)


@dataclass(frozen=True, kw_only=True)
class FindCeiling(GripperTargets):
    """Find the share of targets that any grasp lifts once all clutter is gone.

    Attributes:
        gripper: By name, or several joined by a plus sign, such as jaws-85+suction.
        networks: Their quality networks (.safetensors), one for each gripper, to take instead of
            the shipped ones.
        rated: The best apart that are tried, of each gripper.
        geometric: More that geometry alone promises, of each gripper.
        summary: Table (.csv) in which to enter the shares.
        experiment: First column of that table.
    """

    writes = (("summary", ()),)

    gripper: str
    networks: tuple[Path, ...] = ()
    rated: int = 30
    geometric: int = 150
    summary: Path | None = None
    experiment: str = "retrieval"

    def run(self) -> None:
        """Try, print, and enter the shares."""
        robot = Robot(tuple(self.gripper.split("+")), self.networks)
        config = CeilingConfig(self.rated, self.geometric, self.seed)
        check_summary(self.summary)
        heap_set, heaps, objects = self.opened()
        with bars() as progress:
            found = reach_of(heaps, objects, robot, config, self.workers, progress)
        rows = ceiling_rows(self.experiment, heap_set.condition, robot, self.seed, found)
        shares = {row.metric: _share(row.mean, row.ci_low, row.ci_high) for row in rows}
        cells = [(name.replace("_", " "), shares[name]) for name in CEILING_METRICS]
        say_table(f"{len(found)} targets without clutter, {self.gripper}", ("", "share"), cells)
        if self.summary:
            merge_summary(self.summary, rows)
            wrote(self.summary)


def _gain(lifts: Sequence[TargetLifts], perturbed: bool) -> dict[str, Any]:
    """Return the shares of targets that both grasps lift, and the gain, paired over heaps."""

    def lifted(result: LiftResult | None) -> float:
        if result is None:
            return 0.0
        return result.probability if perturbed else float(result.planned is Outcome.SUCCESS)

    chosen, drawn = (
        [lifted(way) for way in ways]
        for ways in zip(*((each.chosen, each.drawn) for each in lifts), strict=True)
    )
    interval = mean_interval if perturbed else share_interval
    pair = [np.array([chosen]), np.array([drawn])]
    return {
        "chosen": asdict(interval(chosen)),
        "drawn": asdict(interval(drawn)),
        "gain": asdict(estimated(pair, lambda means: means[0] - means[1])),
    }


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    found = [Estimate(**row[name]) for name in ("chosen", "drawn", "gain")]
    *shares, gain = (_share(each.mean, each.ci_low, each.ci_high) for each in found)
    return (*shares, gain if found[2].mean < 0 else f"+{gain}")


def _share(mean: float, low: float, high: float) -> str:
    return f"{mean:.3f} ({low:.3f} to {high:.3f})"
