"""`mechsearch grasp score` and `mechsearch grasp lift`; both need PyTorch."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.files import write_whole
from mechsearch.findings.tables import Table, to_text
from mechsearch.grasp.depth_image import read_view
from mechsearch.grasp.grasp_view import check_opening, view_of_heap
from mechsearch.grasp.graspability import rate
from mechsearch.heaps.dataset import Heap
from mechsearch.pictures.canvas import tiled
from mechsearch.pictures.grasps import draw_grasps, lift_strip
from mechsearch.retrieval.assessment import (
    GraspAssessment,
    GraspTask,
    assess_all,
    film_lift,
    shared_network,
    summarise,
    tasks_of_heaps,
)
from mechsearch.types import MechSearchError


@dataclass(frozen=True, kw_only=True)
class GraspTargets(Command):
    """Whose grasps a command is about.

    Attributes:
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        objects: Object set; the one that the heaps name by default.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        opening: Of the gripper [m], 0.05 to 0.06.
    """

    network: Path | None = None
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    opening: float = 0.056

    def tasks(self, path: Path) -> tuple[list[Heap], list[GraspTask]]:
        """Return the heaps, and for each the task to try the best grasp on its target."""
        check_opening(self.opening)
        shared_network(self.network)
        return tasks_of_heaps(
            path, self.objects, self.split, self.limit, self.network, self.opening
        )


@dataclass(frozen=True, kw_only=True)
class ScoreGrasps(GraspTargets):
    """Rate the grasps on targets, in the heaps of a set or in a depth image of your own.

    Attributes:
        heaps: Heap set (.parquet).
        depth: Depth image [m]: .npy, .png, or .npz with `depth`, `mask` and `K`; instead of heaps.
        mask: The target in that image, where it is not 0: .npy, .png or .npz.
        intrinsics: Of its camera: .json with fx, fy, cx, cy [px].
        depth_scale: Metres for one unit of the depth image; 0.001 for millimetres.
        out: Picture (.png) of the best grasps to write.
    """

    heaps: Path | None = None
    depth: Path | None = None
    mask: Path | None = None
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
            write_whole(self.out, tiled(pictures, 4, margin=3).save)
            wrote(self.out)

    def _score_heaps(self, path: Path) -> list[Image.Image]:
        heaps, tasks = self.tasks(path)
        tasks = [replace(task, best=0, alone=True) for task in tasks]
        with bars() as progress:
            found = assess_all(tasks, progress=progress)
        rows = tuple(
            (
                *_target(task), f"{heap.occlusion:.0%}", f"{a.now.score:.3f}",
                f"{a.now.diverse:.3f}", f"{a.alone.score:.3f}" if a.alone else "",
            )
            for heap, task, a in zip(heaps, tasks, found, strict=True)
        )  # fmt: skip
        columns = ("target", "objects", "occlusion", "graspability", "ten apart", "ceiling")
        say(to_text(Table("Graspability of each target", columns, rows)))
        means = summarise(found)
        say(
            f"mean graspability {means.graspability:.3f} over {len(heaps)} heaps ({means.hidden} "
            f"with no visible target), ceiling {means.ceiling:.3f}"
        )
        return [_picture(*drawn) for drawn in zip(tasks, found, strict=True)] if self.out else []

    def _score_image(self, depth: Path) -> Image.Image:
        check_opening(self.opening)
        view = read_view(depth, self.mask, self.intrinsics, self.depth_scale)
        ratings = rate(shared_network(self.network), view)
        mean, apart = ratings.graspability.score, ratings.best_apart()
        count = len(ratings.best())
        say(f"graspability {mean:.3f}, the mean quality of the {count} best grasps")
        rows = tuple(
            (
                f"{g.column:.0f}", f"{g.row:.0f}", f"{g.depth:.3f}",
                f"{np.rad2deg(g.angle):.0f}", f"{g.quality:.3f}",
                " ".join(f"{value:+.3f}" for value in g.pose(view.camera)[:3]),
            )
            for g in apart
        )  # fmt: skip
        columns = ("column", "row", "depth [m]", "angle [deg]", "quality", "x y z [m]")
        say(to_text(Table("Best grasps that differ, in the camera's frame", columns, rows)))
        return draw_grasps(view, apart, f"graspability {mean:.2f}")


@dataclass(frozen=True, kw_only=True)
class LiftGrasps(GraspTargets):
    """Lift each target with the grasp that a network finds best, in simulation.

    Attributes:
        heaps: Heap set (.parquet).
        out: Picture (.png) to write: a strip of frames for each heap.
        repeats: Perturbed executions of each grasp.
        seed: Of the perturbations.
        workers: Processes; the outcomes do not depend on their number.
    """

    heaps: Path
    out: Path | None = None
    repeats: int = 5
    seed: int = 0
    workers: int = WORKERS

    def run(self) -> None:
        """Plan, lift, print outcomes and draw."""
        if self.repeats < 0:
            raise MechSearchError(f"{self.repeats} repeats; expected 0 or more")
        _, tasks = self.tasks(self.heaps)
        tasks = [replace(task, repeats=self.repeats, seed=self._seed(task)) for task in tasks]
        with bars() as progress:
            found = assess_all(tasks, self.workers, progress)
        rows = tuple(
            (
                *_target(task), f"{a.now.score:.2f}", str(a.retrieved or "not visible"),
                f"{a.lifts[0].probability if a.lifts else 0:.0%}",
            )
            for task, a in zip(tasks, found, strict=True)
        )  # fmt: skip
        columns = ("target", "objects", "graspability", "as planned", "perturbed")
        say(to_text(Table("The best grasp on each target, executed", columns, rows)))
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
            write_whole(self.out, tiled(strips, 1, gap=0).save)
            wrote(self.out)

    def _seed(self, task: GraspTask) -> int:
        return int(np.random.SeedSequence([self.seed, task.heap_seed]).generate_state(1)[0])


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
