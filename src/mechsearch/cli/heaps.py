"""`mechsearch heaps`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mechsearch.cli.command import WORKERS, Command, bars, objects_of, say, spread, wrote
from mechsearch.files import write_whole
from mechsearch.findings.tables import Table, to_text
from mechsearch.heaps.choice import evenly_spread
from mechsearch.heaps.dataset import HeapSet, load, verify
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.heaps.heap import Heap
from mechsearch.pictures.sheet import heap_sheet


@dataclass(frozen=True)
class Generate(Command):
    """Drop objects into heaps, and keep those that hide a target by 10 to 90 %.

    Attributes:
        out: Heap set to write (.parquet).
        config: What to generate.
        workers: Processes; the heaps do not depend on their number.
        ray: Spread the work by Ray instead.
        ray_address: Of a Ray cluster, all of whose processors work; "auto" finds one that runs.
    """

    out: Path
    config: Annotated[GenerateConfig, tyro.conf.arg(name="")] = field(
        default_factory=GenerateConfig
    )
    workers: int = WORKERS
    ray: bool = False
    ray_address: str = ""

    def run(self) -> None:
        """Generate and write the heap set."""
        crew = spread(self.workers, self.ray, self.ray_address)
        with crew as (workers, mapper), bars() as progress:
            heap_set = generate(self.config, self.out, workers, progress, mapper)
        say(describe(heap_set))
        for count, lost in heap_set.manifest.get("lost_attempts", {}).items():
            for number, reason in lost.items():
                say(f"drop {number} of {count} objects is left out, it failed twice: {reason}")
        wrote(self.out)


@dataclass(frozen=True)
class Show(Command):
    """Say what is in a heap set, and draw it.

    Attributes:
        heaps: Heap set (.parquet).
        out: Picture to write; none by default.
        limit: Heaps to draw, spread evenly over the set.
        objects: Object set; the one that the heaps name by default.
    """

    heaps: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None
    limit: int = 12
    objects: str = ""

    def run(self) -> None:
        """Print a summary and draw the heaps."""
        heap_set = load(self.heaps)
        say(describe(heap_set))
        if self.out:
            number = min(self.limit, len(heap_set.heaps))
            chosen = [heap_set.heaps[i] for i in evenly_spread(len(heap_set.heaps), number)]
            models = objects_of(heap_set, self.objects).models
            write_whole(self.out, heap_sheet(chosen, models, heap_set.camera).save)
            wrote(self.out)


@dataclass(frozen=True)
class Verify(Command):
    """Restore every heap; prove that it rests and that its target is occluded as recorded.

    Attributes:
        heaps: Heap set (.parquet).
        objects: Object set; the one that the heaps name by default.
        workers: Processes.
    """

    heaps: Annotated[Path, tyro.conf.Positional]
    objects: str = ""
    workers: int = WORKERS

    def run(self) -> None:
        """Verify; exit with 1 if a heap fails."""
        heap_set = load(self.heaps)
        named = self.objects or str(heap_set.manifest["config"]["objects"])
        with bars() as progress:
            checks = list(verify(heap_set, named, self.workers, progress))
        for check in checks:
            if not check.passed:
                say(
                    f"heap {check.seed} moves {check.drift * 1000:.2f} mm in a second; its "
                    f"occlusion is off by {check.occlusion_error:+.2e}"
                )
        failed = sum(not check.passed for check in checks)
        furthest = max(check.drift for check in checks) * 1000
        say(
            f"{len(checks) - failed} of {len(checks)} heaps rest (at most {furthest:.2f} mm in a "
            "second) with the occlusion recorded"
        )
        if failed:
            raise SystemExit(1)


def describe(heap_set: HeapSet) -> str:
    """Return what is in a heap set, by object count."""
    manifest = heap_set.manifest
    groups: dict[int, list[Heap]] = {}
    for heap in heap_set.heaps:
        groups.setdefault(heap.count, []).append(heap)
    rows = tuple(_row(count, heaps) for count, heaps in sorted(groups.items()))
    columns = ("objects", "training", "held out", "occlusion", "lowest", "highest")
    config = manifest["config"]
    caption = (
        f"{len(heap_set.heaps)} {config['condition']} heaps of {config['objects']} objects, seed "
        f"{config['seed']}, {manifest['acceptance_rate']:.0%} of the drops accepted\n"
        f"sha256 {heap_set.hash}"
    )
    return to_text(Table(caption, columns, rows))


def _row(count: int, heaps: list[Heap]) -> tuple[str, ...]:
    occlusions = [heap.occlusion for heap in heaps]
    held_out = sum(heap.held_out for heap in heaps)
    shares = (np.mean(occlusions), min(occlusions), max(occlusions))
    numbers = (count, len(heaps) - held_out, held_out)
    return (*map(str, numbers), *(f"{share:.0%}" for share in shares))
