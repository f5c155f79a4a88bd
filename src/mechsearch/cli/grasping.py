"""`mechsearch grasp score` and `mechsearch grasp lift`; both need PyTorch."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.metrics import score
from mechsearch.files import write_whole
from mechsearch.grasp.depth_image import read_view
from mechsearch.grasp.film import lift_strip
from mechsearch.grasp.grasp_view import check_opening, view_of_heap
from mechsearch.grasp.graspability import BEST, rate
from mechsearch.grasp.network import SHIPPED_GRASP_NETWORK
from mechsearch.grasp.picture import draw_grasps, grid, stacked
from mechsearch.heaps.dataset import open_heaps
from mechsearch.heaps.heap import Heap
from mechsearch.objects.model import ObjectModel
from mechsearch.report.tables import Table, cell, to_text
from mechsearch.retrieval.assessment import (
    AssessmentSummary,
    GraspAssessment,
    GraspTask,
    assess_all,
    film_lift,
    shared_network,
    summarise,
)
from mechsearch.retrieval.episodes import mean_graspability
from mechsearch.sim.gripper import Gripper
from mechsearch.types import Floats, MechSearchError


@dataclass(frozen=True)
class ScoreGrasps(Command):
    """Rate the grasps on targets, in the heaps of a set or in a depth image of your own.

    Attributes:
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        heaps: Heap set (.parquet).
        depth: Depth image [m]: .npy, .png, or .npz with `depth`, `mask` and `K`; instead of heaps.
        mask: The target in that image, where it is not 0: .npy, .png or .npz.
        intrinsics: Of its camera: .json with fx, fy, cx, cy [px].
        depth_scale: Metres for one unit of the depth image; 0.001 for millimetres.
        out: Picture (.png) of the best grasps to write.
        objects: Object set; the one that the heaps name by default.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        opening: Of the gripper [m], 0.05 to 0.06.
    """

    network: Path | None = None
    heaps: Path | None = None
    depth: Path | None = None
    mask: Path | None = None
    intrinsics: Path | None = None
    depth_scale: float = 1.0
    out: Path | None = None
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    opening: float = 0.056

    def run(self) -> None:
        """Print scores and draw grasps."""
        if (self.heaps is None) == (self.depth is None):
            raise MechSearchError("name either --heaps, or --depth with --mask and --intrinsics")
        check_opening(self.opening)
        shared_network(self._network)
        picture = self._score_image(self.depth) if self.depth else self._score_heaps(self.heaps)
        if self.out and picture:
            write_whole(self.out, picture.save)
            wrote(self.out)

    @property
    def _network(self) -> Path:
        return self.network or SHIPPED_GRASP_NETWORK

    def _score_image(self, depth: Path) -> Image.Image:
        view = read_view(depth, self.mask, self.intrinsics, self.depth_scale)
        ratings = rate(shared_network(self._network), view)
        found, apart = ratings.graspability, ratings.best_apart(BEST)
        count = len(ratings.best(BEST))
        say(f"graspability {found.score:.3f}, the mean quality of the {count} best grasps")
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
        return grid([draw_grasps(view, apart, f"graspability {found.score:.2f}")])

    def _score_heaps(self, path: Path | None) -> Image.Image | None:
        assert path is not None
        spec, heaps, models = _chosen(path, self.objects, self.split, self.limit)
        tasks = [
            GraspTask(spec, h.objects, h.poses, h.target, self._network, alone=True, best=0)
            for h in heaps
        ]
        with bars() as progress:
            found = assess_all(tasks, progress=progress)
        say(to_text(_score_table(heaps, found)))
        means = summarise(found)
        say(
            f"mean graspability {means.graspability:.3f} over {len(heaps)} heaps ({means.hidden} "
            f"with no visible target), ceiling {means.ceiling:.3f}"
        )
        if not self.out:
            return None
        return grid([self._picture(*drawn) for drawn in zip(heaps, models, found, strict=True)])

    def _picture(
        self, heap: Heap, models: list[ObjectModel], found: GraspAssessment
    ) -> Image.Image:
        view = view_of_heap(models, heap.poses, heap.target)
        if not found.now.visible:
            # Nothing to draw on the target: the whole image, without grasps.
            view = replace(view, mask=np.ones_like(view.mask))
            return draw_grasps(view, [], f"{_target(heap)}: not visible", self.opening, margin=0)
        grasps = rate(shared_network(self._network), view).best_apart(BEST)
        return draw_grasps(view, grasps, f"{_target(heap)}: {found.now.score:.2f}", self.opening)


@dataclass(frozen=True)
class LiftGrasps(Command):
    """Lift each target with the grasp that a network finds best, in simulation.

    Attributes:
        heaps: Heap set (.parquet).
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        out: Picture (.png) to write: a strip of frames for each heap.
        objects: Object set; the one that the heaps name by default.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        repeats: Perturbed executions of each grasp.
        seed: Of the perturbations.
        opening: Of the gripper [m], 0.05 to 0.06.
        workers: Processes; the outcomes do not depend on their number.
    """

    heaps: Path
    network: Path | None = None
    out: Path | None = None
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    repeats: int = 5
    seed: int = 0
    opening: float = 0.056
    workers: int = WORKERS

    def run(self) -> None:
        """Plan, lift, print outcomes and draw."""
        check_opening(self.opening)
        if self.repeats < 0:
            raise MechSearchError(f"{self.repeats} repeats; expected 0 or more")
        network = self.network or SHIPPED_GRASP_NETWORK
        shared_network(network)
        spec, heaps, models = _chosen(self.heaps, self.objects, self.split, self.limit)
        tasks = [self._task(spec, network, heap) for heap in heaps]
        with bars() as progress:
            found = assess_all(tasks, self.workers, progress)
        say(to_text(_lift_table(heaps, found)))
        say(_described(summarise(found), len(heaps)))
        if self.out:
            strips = [
                self._strip(heap, own, assessment.now.best)
                for heap, own, assessment in zip(heaps, models, found, strict=True)
                if assessment.now.best is not None
            ]
            if not strips:
                raise MechSearchError("no target is visible in these heaps: there is no film")
            write_whole(self.out, stacked(strips).save)
            wrote(self.out)

    def _task(self, objects: str, network: Path, heap: Heap) -> GraspTask:
        seed = int(np.random.SeedSequence([self.seed, heap.seed]).generate_state(1)[0])
        return GraspTask(
            objects, heap.objects, heap.poses, heap.target, network, repeats=self.repeats,
            seed=seed, gripper=Gripper(opening=self.opening),
        )  # fmt: skip

    def _strip(self, heap: Heap, models: list[ObjectModel], grasp: Floats) -> Image.Image:
        gripper = Gripper(opening=self.opening)
        outcome, film = film_lift(models, heap.poses, heap.target, grasp, gripper)
        return lift_strip(film, models, gripper, heap.target, f"{_target(heap)}: {outcome}")


def retrieval_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieved before [%]", "after [%]",
    )  # fmt: skip
    rows = tuple(_retrieval_row(name, evaluation) for name, evaluation in evaluations.items())
    return Table("Graspability and retrieval of the target", columns, rows)


def _retrieval_row(name: str, evaluation: Evaluation) -> tuple[str, ...]:
    before, after, alone = mean_graspability(evaluation)
    scores = score(evaluation.episodes)
    return (
        name, f"{before:.2f}", f"{after:.2f}",
        cell("graspability_change", scores["graspability_change"], signed=True), f"{alone:.2f}",
        cell("retrieval_before", scores["retrieval_before"]),
        cell("retrieval_after", scores["retrieval_after"]),
    )  # fmt: skip


def _score_table(heaps: list[Heap], found: list[GraspAssessment]) -> Table:
    rows = tuple(
        (
            _target(heap), str(len(heap.objects)), f"{heap.occlusion:.0%}", f"{a.now.score:.3f}",
            f"{a.now.diverse:.3f}", f"{a.alone.score:.3f}" if a.alone else "",
        )
        for heap, a in zip(heaps, found, strict=True)
    )  # fmt: skip
    columns = ("target", "objects", "occlusion", "graspability", "ten apart", "ceiling")
    return Table("Graspability of each target", columns, rows)


def _lift_table(heaps: list[Heap], found: list[GraspAssessment]) -> Table:
    rows = tuple(
        (
            _target(heap), str(len(heap.objects)), f"{a.now.score:.2f}",
            str(a.retrieved or "not visible"), f"{a.lifts[0].probability if a.lifts else 0:.0%}",
        )
        for heap, a in zip(heaps, found, strict=True)
    )  # fmt: skip
    columns = ("target", "objects", "graspability", "as planned", "perturbed")
    return Table("The best grasp on each target, executed", columns, rows)


def _described(means: AssessmentSummary, targets: int) -> str:
    counts = ", ".join(f"{name} {count}" for name, count in means.outcomes.items())
    return (
        f"{counts}\nretrieval {means.retrieved:.0%} of {targets} targets as planned, "
        f"{means.probability:.0%} of all perturbed executions"
    )


def _chosen(
    path: Path, objects: str, split: str, limit: int
) -> tuple[str, list[Heap], list[list[ObjectModel]]]:
    """Return an object set as it is named, heaps, and the objects of each."""
    heap_set, found = open_heaps(path, objects)
    heaps = [heap_set.heaps[i] for i in heap_set.choose(split, limit)]
    models = [[found.models[name] for name in heap.objects] for heap in heaps]
    return objects or heap_set.objects, heaps, models


def _target(heap: Heap) -> str:
    return heap.objects[heap.target].replace("_", " ")
