"""`mechsearch heaps`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, open_mapper, say, wrote
from mechsearch.files import write_whole
from mechsearch.findings.tables import Table, to_text
from mechsearch.heaps.dataset import HeapSet, load_heaps, open_heaps
from mechsearch.heaps.generate import GenerateConfig, generate, verify
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
        crew = open_mapper(self.workers, self.ray, self.ray_address)
        with crew as (workers, mapper), bars() as progress:
            heap_set = generate(self.config, self.out, workers, progress, mapper)
        say(describe(heap_set))
        for count, lost in heap_set.manifest.get("lost_attempts", {}).items():
            for number, reason in lost.items():
                say(f"drop {number} of {count} objects is left out, it failed twice: {reason}")
        wrote(self.out)


@dataclass(frozen=True)
class ShowHeaps(Command):
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
        heap_set = load_heaps(self.heaps)
        say(describe(heap_set))
        if self.out:
            _, objects = open_heaps(self.heaps, self.objects)
            limit = min(self.limit, len(heap_set.heaps))
            chosen = [heap_set.heaps[i] for i in heap_set.choose("all", limit)]
            write_whole(self.out, heap_sheet(chosen, objects.models, heap_set.camera).save)
            wrote(self.out)


@dataclass(frozen=True)
class VerifyHeaps(Command):
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
        heap_set = load_heaps(self.heaps)
        with bars() as progress:
            checks = list(verify(heap_set, self.objects, self.workers, progress))
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
    rows = tuple(
        (
            *map(str, (part.count, part.train, part.held_out)),
            *(f"{share:.0%}" for share in part.occlusion),
        )
        for part in heap_set.summary()
    )
    columns = ("objects", "training", "held out", "occlusion", "lowest", "highest")
    caption = (
        f"{len(heap_set.heaps)} {heap_set.condition} heaps of {heap_set.objects} objects, seed "
        f"{heap_set.manifest['config']['seed']}, {heap_set.manifest['acceptance_rate']:.0%} of the "
        f"drops accepted\nsha256 {heap_set.hash}"
    )
    return to_text(Table(caption, columns, rows))
