"""`mechsearch grasp score` and `mechsearch grasp lift`; both need PyTorch."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.files import write_whole
from mechsearch.grasp.film import lift_strip
from mechsearch.grasp.image_file import read_view
from mechsearch.grasp.network import GraspNetwork, load_network
from mechsearch.grasp.picture import draw_grasps, grid, stacked
from mechsearch.grasp.policy import rate
from mechsearch.grasp.quality import BEST, Graspability, ceiling, graspability
from mechsearch.grasp.retrieval import Lifted, LiftTask, lift_all
from mechsearch.grasp.view import (
    GraspView,
    check_opening,
    view_of_heap,
)
from mechsearch.heaps.dataset import HeapSet, check_objects, load_heaps, object_set
from mechsearch.heaps.heap import Heap, evenly_spread
from mechsearch.objects.model import ObjectModel
from mechsearch.report.tables import Table, to_text
from mechsearch.sim.gripper import Gripper
from mechsearch.sim.lift import LiftFrame, LiftWorld, Outcome
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Score(Command):
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
        network = load_network(self.network)
        if self.depth is not None:
            view = read_view(self.depth, self.mask, self.intrinsics, self.depth_scale)
            pictures = [self._score_image(network, view)]
        else:
            assert self.heaps is not None
            pictures = self._score_heaps(network, self.heaps)
        if self.out:
            write_whole(self.out, grid(pictures).save)
            wrote(self.out)

    def _score_image(self, network: GraspNetwork, view: GraspView) -> Image.Image:
        ratings = rate(network, view)
        grasps = ratings.best(BEST)
        score = float(np.mean([grasp.quality for grasp in grasps]))
        say(f"graspability {score:.3f}, the mean quality of the {len(grasps)} best grasps")
        rows = tuple(
            (
                f"{g.column:.0f}", f"{g.row:.0f}", f"{g.depth:.3f}",
                f"{np.rad2deg(g.angle):.0f}", f"{g.quality:.3f}",
                " ".join(f"{value:+.3f}" for value in g.pose(view.camera)[:3]),
            )
            for g in ratings.best_apart(BEST)
        )  # fmt: skip
        columns = ("column", "row", "depth [m]", "angle [deg]", "quality", "x y z [m]")
        say(to_text(Table("Best grasps that differ, in the camera's frame", columns, rows)))
        return draw_grasps(view, ratings.best_apart(BEST), f"graspability {score:.2f}")

    def _score_heaps(self, network: GraspNetwork, path: Path) -> list[Image.Image]:
        heap_set, heaps = chosen_heaps(path, self.objects, self.split, self.limit)
        known = object_set(self.objects or heap_set.objects).models
        rows, found, pictures = [], [], []
        with bars() as progress:
            for i, heap in enumerate(heaps):
                models = [known[name] for name in heap.objects]
                now = graspability(network, models, heap.poses, heap.target)
                alone = ceiling(network, models[heap.target], heap.poses[heap.target])
                found.append((now, alone))
                rows.append(_scored(heap, now, alone))
                if self.out:
                    pictures.append(_picture(network, heap, models, now, self.opening))
                progress("scored", i + 1, len(heaps))
        columns = ("target", "objects", "occlusion", "graspability", "ten apart", "ceiling")
        means = [np.mean([value.score for value in side]) for side in zip(*found, strict=True)]
        hidden = sum(not now.visible for now, _ in found)
        say(to_text(Table("Graspability of each target", columns, tuple(rows))))
        say(
            f"mean graspability {means[0]:.3f} over {len(heaps)} heaps ({hidden} with no visible "
            f"target), ceiling {means[1]:.3f}"
        )
        return pictures


@dataclass(frozen=True)
class Lift(Command):
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
        network = load_network(self.network)
        heap_set, heaps = chosen_heaps(self.heaps, self.objects, self.split, self.limit)
        spec = self.objects or str(heap_set.manifest["config"]["objects"])
        known = object_set(self.objects or heap_set.objects).models
        tasks, scores = [], []
        with bars() as progress:
            for i, heap in enumerate(heaps):
                models = [known[name] for name in heap.objects]
                now = graspability(network, models, heap.poses, heap.target)
                tasks.append(self._task(spec, heap, now))
                scores.append(now)
                progress("planned", i + 1, len(heaps))
            results = []
            for i, result in enumerate(lift_all(tasks, self.workers)):
                results.append(result)
                progress("lifted", i + 1, len(heaps))
        self._report(heaps, scores, results)
        if self.out:
            strips = [
                _strip(task, heap, [known[name] for name in heap.objects])
                for task, heap in zip(tasks, heaps, strict=True)
                if len(task.grasps)
            ]
            if not strips:
                raise MechSearchError("no target is visible in these heaps: there is no film")
            write_whole(self.out, stacked(strips).save)
            wrote(self.out)

    def _task(self, spec: str, heap: Heap, now: Graspability) -> LiftTask:
        grasps = np.empty((0, 7)) if now.best is None else now.best[None]
        gripper = Gripper(opening=self.opening)
        seed = int(np.random.SeedSequence([self.seed, heap.seed]).generate_state(1)[0])
        return LiftTask(
            spec, heap.objects, heap.poses, heap.target, grasps, self.repeats, seed, gripper
        )

    def _report(
        self, heaps: Sequence[Heap], scores: Sequence[Graspability], results: list[list[Lifted]]
    ) -> None:
        rows, outcomes = [], Counter[str]()
        planned = probability = 0.0
        for heap, score, lifted in zip(heaps, scores, results, strict=True):
            cells = (heap.objects[heap.target].replace("_", " "), str(len(heap.objects)))
            if not lifted:
                rows.append((*cells, f"{score.score:.2f}", "not visible", "0%"))
                continue
            result = lifted[0]
            planned += result.planned is Outcome.SUCCESS
            probability += result.probability
            outcomes.update(map(str, result.repeats or (result.planned,)))
            rows.append(
                (*cells, f"{score.score:.2f}", str(result.planned), f"{result.probability:.0%}")
            )
        columns = ("target", "objects", "graspability", "as planned", "perturbed")
        say(to_text(Table("The best grasp on each target, executed", columns, tuple(rows))))
        say(", ".join(f"{name} {count}" for name, count in outcomes.most_common()))
        say(
            f"retrieval {planned / len(heaps):.0%} of {len(heaps)} targets as planned, "
            f"{probability / len(heaps):.0%} of all perturbed executions"
        )


def chosen_heaps(path: Path, objects: str, split: str, limit: int) -> tuple[HeapSet, list[Heap]]:
    """Return a heap set and the heaps of a split, evenly spread where there is a limit.

    Raises:
        MechSearchError: If the objects differ, or split or limit do not fit the set.
    """
    heap_set = load_heaps(path)
    check_objects(heap_set, object_set(objects or heap_set.objects))
    splits = {"held-out": heap_set.held_out, "train": heap_set.train, "all": list(heap_set.heaps)}
    if split not in splits:
        raise MechSearchError(f"unknown split {split!r}; choose one of {', '.join(splits)}")
    heaps = splits[split]
    if not heaps or not 0 <= limit <= len(heaps):
        raise MechSearchError(
            f"{limit or 'all'} heaps asked for; {path} has {len(heaps)} {split} heaps"
        )
    return heap_set, [heaps[i] for i in evenly_spread(len(heaps), limit or len(heaps))]


def _scored(heap: Heap, now: Graspability, alone: Graspability) -> tuple[str, ...]:
    return (
        heap.objects[heap.target].replace("_", " "), str(len(heap.objects)),
        f"{heap.occlusion:.0%}", f"{now.score:.3f}", f"{now.diverse:.3f}", f"{alone.score:.3f}",
    )  # fmt: skip


def _picture(
    network: GraspNetwork,
    heap: Heap,
    models: list[ObjectModel],
    now: Graspability,
    opening: float,
) -> Image.Image:
    view = view_of_heap(models, heap.poses, heap.target)
    name = heap.objects[heap.target].replace("_", " ")
    if not now.visible:
        # Nothing to draw on the target: the whole image, without grasps.
        view = replace(view, mask=np.ones_like(view.mask))
        return draw_grasps(view, [], f"{name}: not visible", opening, margin=0)
    grasps = rate(network, view).best_apart(BEST)
    return draw_grasps(view, grasps, f"{name}: {now.score:.2f}", opening)


def _strip(task: LiftTask, heap: Heap, models: list[ObjectModel]) -> Image.Image:
    film: list[LiftFrame] = []
    world = LiftWorld(models, task.gripper, task.config)
    outcome = world.lift(task.poses, task.target, task.grasps[0], film=film)
    caption = f"{heap.objects[heap.target].replace('_', ' ')}: {outcome}"
    return lift_strip(film, models, task.gripper, task.target, caption)
