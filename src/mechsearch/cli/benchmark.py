"""`mechsearch benchmark`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.benchmark.protocol import BENCHMARK_SPLITS, BENCHMARK_TASKS, HEAPS_FOLDER
from mechsearch.benchmark.submission import (
    SUFFIX,
    Entrant,
    act,
    check_free,
    enter,
    entered,
    load_submission,
    page,
    place_of,
    save_submission,
    verified,
)
from mechsearch.cli.command import FLAT, Command, OfObjects, Spread, bars, say_table, wrote
from mechsearch.files import check_place, write_text

_RESULTS = Path("results/benchmark")


@dataclass(frozen=True)
class ListSplits(Command):
    """List the benchmark's tasks, splits and heap sets.

    Attributes:
        heaps: Folder of the heap sets.
    """

    heaps: Path = Path(HEAPS_FOLDER)

    def run(self) -> None:
        """Print both tables."""
        tasks = [
            (name, str(task.version), task.ranked_by) for name, task in BENCHMARK_TASKS.items()
        ]
        say_table("Tasks", ("task", "version", "sorted by"), tasks)
        rows = [
            (name, split.what, split.file, split.heap_set[:12],
             "yes" if (self.heaps / split.file).is_file() else "no")
            for name, split in BENCHMARK_SPLITS.items()
        ]  # fmt: skip
        columns = ("split", "heaps", "file", "sha256", f"in {self.heaps}")
        say_table("Splits", columns, rows)


@dataclass(frozen=True)
class RunBenchmark(OfObjects, Spread):
    """Let a policy act on every heap of a split, and write episodes and card as a submission.

    Attributes:
        policy: As for `mechsearch evaluate`, or episodes recorded on those heaps (.npz).
        entrant: Who enters it, and where.
        out: Submission to write (.npz); by default NAME-TASK-SPLIT.npz.
        heaps: Folder of the heap sets.
    """

    policy: Annotated[str, tyro.conf.Positional]
    entrant: Annotated[Entrant, FLAT]
    out: Path | None = None
    heaps: Path = Path(HEAPS_FOLDER)

    def run(self) -> None:
        """Act, or read what was recorded, and write the submission."""
        if self.out:
            check_place(self.out)
        with self.spread() as (workers, mapper), bars() as progress:
            made = act(
                self.policy, self.entrant, self.heaps, self.objects, workers, progress, mapper
            )
        card = made.card
        out = self.out or Path(f"{card.name}-{card.task}-{card.split}{SUFFIX}")
        save_submission(out, made)
        wrote(out)


@dataclass(frozen=True)
class Submit(OfObjects, Spread):
    """Play submissions again, and enter those that are what they claim.

    Attributes:
        submissions: Files that `mechsearch benchmark run` wrote (.npz).
        heaps: Folder of the heap sets.
        results: Folder of all submissions.
    """

    submissions: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SUBMISSION [...]")
    ]
    heaps: Path = Path(HEAPS_FOLDER)
    results: Path = _RESULTS

    def run(self) -> None:
        """Verify and enter, one after another."""
        read = [load_submission(path) for path in self.submissions]
        for submission in read:
            check_free(place_of(submission.card, self.results))
        with self.spread() as (workers, mapper):
            for submission in read:
                with bars() as progress:
                    found = verified(
                        submission, self.heaps, self.objects, workers, progress, mapper
                    )
                wrote(enter(found, self.results))


@dataclass(frozen=True)
class TabulateSubmissions(Command):
    """Write the table of all submissions, a page in Markdown.

    Attributes:
        results: Folder of all submissions.
        out: The page.
    """

    results: Path = _RESULTS
    out: Path = Path("docs/benchmark-table.md")

    def run(self) -> None:
        """Write the page."""
        write_text(self.out, page(list(entered(self.results))))
        wrote(self.out)
