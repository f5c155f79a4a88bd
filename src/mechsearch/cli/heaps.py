"""`mechsearch heaps`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import (
    FLAT,
    PICTURES,
    Command,
    OfObjects,
    Parallel,
    Spread,
    bars,
    save,
    say,
    say_table,
    wrote,
)
from mechsearch.heaps.dataset import HeapSet, join_heaps, load_heaps, objects_of
from mechsearch.heaps.generate import GenerateConfig, generate, verify
from mechsearch.pictures.sheet import heap_sheet


@dataclass(frozen=True)
class Generate(Spread):
    """Drop objects into heaps, and keep those that hide a target by 10 to 90 %.

    Attributes:
        out: Heap set to write (.parquet).
        config: What to generate.
    """

    keeps = "the drops so far are"

    out: Path
    config: Annotated[GenerateConfig, FLAT] = field(default_factory=GenerateConfig)

    def run(self) -> None:
        """Generate and write the heap set."""
        with self.spread() as (workers, mapper), bars() as progress:
            heap_set = generate(self.config, self.out, workers, progress, mapper)
        describe(heap_set)
        for count, lost in heap_set.manifest.get("lost_attempts", {}).items():
            for number, reason in lost.items():
                say(f"drop {number} of {count} objects is left out, it failed twice: {reason}")
        wrote(self.out)


@dataclass(frozen=True)
class JoinHeaps(Command):
    """Write one heap set of the heaps of several, such as single and dual ones.

    Attributes:
        heaps: Heap sets (.parquet) of the same objects.
        out: Heap set to write.
    """

    heaps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="HEAPS [...]")]
    out: Path

    def run(self) -> None:
        """Join and write them."""
        describe(join_heaps([load_heaps(path) for path in self.heaps], self.out))
        wrote(self.out)


@dataclass(frozen=True)
class ShowHeaps(OfObjects):
    """Say what is in a heap set, and draw it.

    Attributes:
        heaps: Heap set (.parquet), or household-single or household-dual, the embedded ones.
        out: Picture to write (.png, .jpg or .webp); none by default.
        limit: Heaps to draw, spread evenly over the set.
    """

    writes = (("out", PICTURES),)

    heaps: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None
    limit: int = 12

    def run(self) -> None:
        """Print a summary and draw the heaps."""
        heap_set = load_heaps(self.heaps)
        describe(heap_set)
        if self.out:
            objects = objects_of(heap_set, self.objects)
            limit = min(self.limit, len(heap_set.heaps))
            chosen = [heap_set.heaps[i] for i in heap_set.choose("all", limit)]
            save(self.out, heap_sheet(chosen, objects.models, heap_set.camera).save)


@dataclass(frozen=True)
class VerifyHeaps(OfObjects, Parallel):
    """Restore every heap; prove that it rests and that its target is occluded as recorded.

    Attributes:
        heaps: Heap set (.parquet), or household-single or household-dual, the embedded ones.
    """

    heaps: Annotated[Path, tyro.conf.Positional]

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


def describe(heap_set: HeapSet) -> None:
    """Say what is in a heap set, by object count."""
    columns = ("objects", "training", "held out", "occlusion", "lowest", "highest")
    rows = [
        [*map(str, (part.count, part.train, part.held_out)), *map("{:.0%}".format, part.occlusion)]
        for part in heap_set.summary()
    ]
    caption = (
        f"{len(heap_set.heaps)} {heap_set.condition} heaps of {heap_set.objects} objects, seed "
        f"{heap_set.manifest['config']['seed']}, {heap_set.manifest['acceptance_rate']:.0%} of the "
        f"drops accepted\nsha256 {heap_set.hash}"
    )
    say_table(caption, columns, rows)
