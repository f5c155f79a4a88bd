"""`mechsearch segment images`, `train`, `test` and `show`; all need PyTorch."""

import json
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from PIL import Image

from mechsearch.benchmark.protocol import UNSEEN
from mechsearch.cli.command import (
    FLAT,
    PICTURES,
    Command,
    OfObjects,
    Parallel,
    bars,
    save,
    say,
    say_table,
    wrote,
)
from mechsearch.evaluation.episodes import load_episodes, mean_interval, share_interval
from mechsearch.observe.masks import LEAST_CONFIDENCE
from mechsearch.pictures.canvas import captioned, tiled, tinted
from mechsearch.segmentation.images import (
    ImageConfig,
    ImageSet,
    load_images,
    make_images,
    see_heaps,
)
from mechsearch.segmentation.judging import Found, found_by, partly_hidden
from mechsearch.segmentation.occlusion_training import OcclusionTrainConfig, train_occlusion
from mechsearch.segmentation.photographs import save_references, views_of_photographs
from mechsearch.segmentation.segmenter import SHIPPED, make_segmenter, visible_target
from mechsearch.segmentation.training import SegmentTrainConfig, train_segmentation


@dataclass(frozen=True)
class MakeImages(OfObjects, Parallel):
    """Render heaps for training: objects, colours, light, table, camera and sensor are drawn.

    A folder that was cut off is continued.

    Attributes:
        heaps: Heap set (.parquet).
        out: Folder for the images.
        episodes: Recorded episodes (.npz) on these heaps: moments of them are shown in place of
            heaps as they were dropped.
        unseen: Keep the benchmark's unseen objects; by default others lie in their places.
        config: What images.
    """

    keeps = "the files of heaps so far are"

    heaps: Path
    out: Path
    episodes: Path | None = None
    unseen: bool = False
    config: Annotated[ImageConfig, FLAT] = field(default_factory=ImageConfig)

    def run(self) -> None:
        """Make the images."""
        without = () if self.unseen else UNSEEN
        config = replace(self.config, without=(*self.config.without, *without))
        courses = None
        if self.episodes is not None:
            records = load_episodes(self.episodes).episodes
            courses = {r.heap_seed: (r.poses, r.ee_positions) for r in records}
        with bars() as progress:
            make_images(self.heaps, self.objects, config, self.out, self.workers, progress, courses)
        wrote(self.out)


@dataclass(frozen=True)
class TrainSegmentation(Command):
    """Train a segmentation network, from scratch, or go on with a training.

    Attributes:
        images: Folders that `mechsearch segment images` wrote; one that is named twice counts
            twice.
        out: Folder for checkpoint and network; one that was cut off is continued.
        start: Network (.safetensors) to begin with, such as one to train further.
        config: How to train.
    """

    keeps = "the updates up to the last checkpoint are"

    images: tuple[Path, ...]
    out: Path
    start: Path | None = None
    config: Annotated[SegmentTrainConfig, FLAT] = field(default_factory=SegmentTrainConfig)

    def run(self) -> None:
        """Train, and say how good the network is on validation heaps."""
        with bars() as progress:
            seen = load_images(self.images, progress)
            history = train_segmentation(seen, self.config, self.out, self.start, progress)
        last = history[-1]
        say(
            f"{last['right']:.1%} of the masks on the right object, IoU {last['iou']:.3f} where "
            f"less than half is hidden, {last['iou_hidden']:.3f} where more is, on validation heaps"
        )
        wrote(self.out)


@dataclass(frozen=True)
class TrainOcclusion(Command):
    """Train a network that estimates how much of an object is hidden, or go on with a training.

    Attributes:
        images: Folders that `mechsearch segment images` wrote; one that is named twice counts
            twice.
        out: Folder for checkpoint and network; one that was cut off is continued.
        config: How to train.
    """

    keeps = "the updates up to the last checkpoint are"

    images: tuple[Path, ...]
    out: Path
    config: Annotated[OcclusionTrainConfig, FLAT] = field(default_factory=OcclusionTrainConfig)

    def run(self) -> None:
        """Train, and say how good the network is on validation heaps."""
        seen = load_images(self.images)
        with bars() as progress:
            last = train_occlusion(seen, self.config, self.out, progress)[-1]
        say(
            f"on validation heaps, occlusion is off by {last['error']:.3f}; of the uncovered, "
            f"{last['recall']:.1%} are found where 95 % of what is found is"
        )
        wrote(self.out)


@dataclass(frozen=True, kw_only=True)
class MakeReference(Command):
    """Write reference views of an object by photographs of it, each with a mask.

    A photograph's mask is what is not transparent in it, or a picture beside it: cup-mask.png of
    cup.jpg, black but for the object.

    Attributes:
        photographs: Pictures, and folders of them.
        out: File (.npz) to write.
        pixel: Side of a pixel at the object [m], the same in all, where it is known.
    """

    writes = (("out", (".npz",)),)

    photographs: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PHOTOGRAPH [...]")
    ]
    out: Path
    pixel: float = 0.0

    def run(self) -> None:
        """Cut the object out of each photograph."""
        references = views_of_photographs(self.photographs, self.pixel)
        save(self.out, lambda to: save_references(to, references))
        say(f"{len(references.width)} views")


@dataclass(frozen=True, kw_only=True)
class OfSegmenter(OfObjects, Parallel):
    """A command about masks on images of heaps.

    Attributes:
        heaps: Heap sets (.parquet).
        segmenter: shipped, a network's file (.safetensors), or package.module:factory.
        sensor: Sensor model.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps of each set, spread evenly; 0 takes all.
        seed: Of the sensor.
    """

    heaps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="HEAPS [...]")]
    segmenter: str = SHIPPED
    sensor: str = "stereo"
    split: str = "held-out"
    limit: int = 300
    seed: int = 0

    def seen(self, heaps: Path) -> ImageSet:
        """Return one image of each heap as policies see it."""
        config = ImageConfig(
            1, self.split, self.limit, (self.sensor,), randomised=False, also=(), variants=0,
            seed=self.seed,
        )  # fmt: skip
        with bars() as progress:
            return see_heaps(heaps, self.objects, config, self.workers, progress)


@dataclass(frozen=True, kw_only=True)
class TestSegmentation(OfSegmenter):
    """Hold the masks of a segmenter against the truth, where targets are 10 to 90 % hidden.

    Targets that the benchmark calls unseen, which training never shows, have a row of their own.

    Attributes:
        out: File (.json) to write.
    """

    writes = (("out", (".json",)),)

    out: Path | None = None

    def run(self) -> None:
        """Print a table, two rows for each heap set: of known objects, and of unseen ones."""
        segmenter, rows, report = make_segmenter(self.segmenter), [], dict[str, Any]()
        for heaps in self.heaps:
            seen = self.seen(heaps)
            with bars() as progress:
                told = partial(progress, "masks")
                found = found_by(segmenter, seen, partly_hidden(seen.images), told)
            unseen = np.isin(np.array(seen.names)[found.object], UNSEEN)
            parts = {"known": found.where(~unseen), "unseen": found.where(unseen)}
            report[heaps.stem] = {
                name: _scores(part) for name, part in parts.items() if len(part.iou)
            }
            for name, entry in report[heaps.stem].items():
                rows.append((
                    f"{heaps.stem}, {name}", f"{entry['targets']}",
                    *(_shown(entry[kind]) for kind in ("right", "iou", "iou_hidden")),
                    "-" if (share := entry["right_where_confident"]) is None else f"{share:.3f}",
                    f"{entry['confident']:.3f}", f"{entry['milliseconds']:.0f}",
                ))  # fmt: skip
        columns = (
            *("heaps, objects", "targets", "on the right object", "IoU, under half hidden"),
            *("IoU, over half hidden", "right of confident ones", "confident", "ms"),
        )
        say_table(f"Masks by {self.segmenter}, sensor {self.sensor}", columns, rows)
        if self.out:
            facts = {"segmenter": self.segmenter, "sensor": self.sensor, "split": self.split}
            text = json.dumps({**facts, "seed": self.seed, "heap_sets": report}, indent=1)
            save(self.out, lambda to: to.write_text(text + "\n"))


@dataclass(frozen=True, kw_only=True)
class ShowSegmentation(OfSegmenter):
    """Draw what a segmenter sees, the truth, and the mask that it finds, side by side.

    Attributes:
        out: Picture (.png, .jpg or .webp) to write.
        limit: Number of heaps of each set, spread evenly.
        columns: Heaps in a row.
    """

    writes = (("out", PICTURES),)

    out: Path
    limit: int = 12
    columns: int = 2

    def run(self) -> None:
        """Draw."""
        segmenter, tiles = make_segmenter(self.segmenter), []
        for heaps in self.heaps:
            seen = self.seen(heaps)
            images, references, names = seen.images, seen.references, seen.names
            for index, place in partly_hidden(images):
                number = int(images.objects[index, place])
                segmenter.look_for(references[number])
                rgb, depth, camera = images.seen(index)
                mask, confidence = visible_target(segmenter, rgb, depth, camera, 0.0)
                truth = images.ids[index] == place + 1
                iou = (truth & mask).sum() / (truth | mask).sum()
                views = tiled([Image.fromarray(view) for view in references[number].rgb[:9]], 3, 0)
                pictures = [views, *map(_enlarged, (rgb, tinted(rgb, truth), tinted(rgb, mask)))]
                row = tiled([picture.resize((256, 256)) for picture in pictures], 4, 2)
                sure = "sure" if confidence >= LEAST_CONFIDENCE else "unsure"
                facts = f"{images.hidden[index, place]:.0%} hidden, IoU {iou:.2f}, {sure}"
                title = f"{names[number].replace('_', ' ')}: views, image, truth, mask"
                tiles.append(captioned(row, title, f"{facts} ({confidence:.2f})", text=18))
        save(self.out, tiled(tiles, self.columns, gap=10, margin=10).save)


def _enlarged(rgb: Any) -> Image.Image:
    """Return the middle of an image, where heaps lie."""
    margin = len(rgb) // 5
    return Image.fromarray(rgb[margin : len(rgb) - margin, margin : len(rgb) - margin])


def _scores(found: Found) -> dict[str, Any]:
    """Return means, and intervals of 95 % over heaps, of one target in each heap."""
    less, sure = found.hidden < 0.5, found.confidence >= LEAST_CONFIDENCE
    return {
        "targets": len(found.iou),
        "right": vars(share_interval(found.right.astype(np.float64))),
        **{
            name: vars(mean_interval(found.iou[own])) if own.any() else None
            for name, own in (("iou", less), ("iou_hidden", ~less))
        },
        "confident": float(sure.mean()),
        "right_where_confident": float(found.right[sure].mean()) if sure.any() else None,
        "reliability": found.reliability,
        "milliseconds": float(1000 * np.median(found.seconds)),
    }


def _shown(estimate: dict[str, float] | None) -> str:
    if estimate is None:
        return "-"
    return f"{estimate['mean']:.3f} ({estimate['ci_low']:.3f} to {estimate['ci_high']:.3f})"
