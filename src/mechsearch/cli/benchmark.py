"""`mechsearch benchmark`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from mechsearch.benchmark.environment import fixed_task, open_split
from mechsearch.benchmark.protocol import HEAPS_FOLDER, SPLITS, TASKS, entry
from mechsearch.benchmark.submission import (
    SUFFIX,
    check_free,
    enter,
    entered,
    load_submission,
    page,
    place_of,
    save_submission,
    submission_of,
    verified,
)
from mechsearch.cli.command import Command, OfObjects, Spread, bars, say_table, wrote
from mechsearch.env import RetrievalTask, TaskConfig
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.policies import RETRIEVE
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, in_task
from mechsearch.files import check_place, write_text
from mechsearch.heaps.dataset import load_heaps
from mechsearch.types import MechSearchError

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
        tasks = [(name, str(task.version), task.ranked_by) for name, task in TASKS.items()]
        say_table("Tasks", ("task", "version", "sorted by"), tasks)
        rows = [
            (name, split.what, split.file, split.heap_set[:12],
             "yes" if (self.heaps / split.file).is_file() else "no")
            for name, split in SPLITS.items()
        ]  # fmt: skip
        columns = ("split", "heaps", "file", "sha256", f"in {self.heaps}")
        say_table("Splits", columns, rows)


@dataclass(frozen=True)
class RunBenchmark(OfObjects, Spread):
    """Let a policy act on every heap of a split, and write episodes and card as a submission.

    Attributes:
        policy: As for `mechsearch evaluate`, or episodes recorded on those heaps (.npz).
        task: Such as uncover; see `mechsearch benchmark list`.
        split: Such as single.
        authors: Who submits it.
        out: Submission to write (.npz); by default NAME-TASK-SPLIT.npz.
        name: Of the submission; by default the policy's own.
        heaps: Folder of the heap sets.
        gripper: Of policies that retrieve, such as jaws-85, or several joined by a plus sign.
        seed: Of the policy's own randomness.
        training_heaps: Heap sets (.parquet) that the policy, or a network that it uses, learnt on;
            their training halves count.
        privileged: Whether training used what only a simulator knows.
        executed: Actions executed in training; by default what a trained policy says.
        tried: Actions tried in training in copies of the simulator.
        weights: Where weights or code are to be had.
    """

    policy: Annotated[str, tyro.conf.Positional]
    task: str
    split: str
    authors: str
    out: Path | None = None
    name: str = ""
    heaps: Path = Path(HEAPS_FOLDER)
    gripper: str = ""
    seed: int = 0
    training_heaps: tuple[Path, ...] = ()
    privileged: bool = False
    executed: int | None = None
    tried: int = 0
    weights: str = ""

    def run(self) -> None:
        """Act, or read what was recorded, and write the submission."""
        goal = entry(TASKS, "task", self.task).goal
        file, heap_set, _ = open_split(self.split, self.heaps, self.objects)
        learnt_on = [load_heaps(path) for path in self.training_heaps]
        objects = {name for heaps in learnt_on for heap in heaps.train for name in heap.objects}
        known = sorted(objects & set(SPLITS[self.split].unseen))
        if known:
            raise MechSearchError(
                f"the training heaps held {', '.join(known)}, which no policy has seen that enters "
                f"the split {self.split}"
            )
        if self.out:
            check_place(self.out)

        def fixed(own: TaskConfig) -> TaskConfig:
            if isinstance(own, RetrievalTask) != (goal == RETRIEVE):
                raise MechSearchError(
                    f"{self.policy} is not a policy for the task {self.task}; expected one whose "
                    f"goal is to {goal}"
                )
            grippers = own.grippers if isinstance(own, RetrievalTask) else ()
            return fixed_task(self.task, heap_set.camera, own.image_size, grippers)

        if self.policy.endswith(SUFFIX):
            evaluation = load_episodes(Path(self.policy))
        else:
            split = SPLITS[self.split]
            plan = EvaluationPlan(
                self.policy, file, self.name, self.objects, split.part, split.limit, self.seed,
                grippers=tuple(self.gripper.split("+")) if self.gripper else (),
            )  # fmt: skip
            plan = in_task(plan, fixed)
            with self.spread() as (workers, mapper), bars() as progress:
                evaluation = evaluate_plan(plan, workers, progress, mapper)
        header = evaluation.header
        if (header["trained"] or goal == RETRIEVE) and not learnt_on:
            raise MechSearchError(
                f"{header['name']} learnt, or uses networks that did; name the heap sets by "
                "--training-heaps"
            )
        executed = header["training_actions"] if self.executed is None else self.executed
        told: dict[str, Any] = {
            "name": self.name or header["name"],
            "authors": self.authors,
            "privileged": self.privileged,
            "executed_actions": executed,
            "tried_actions": self.tried,
            "training_heaps": tuple(heaps.hash for heaps in learnt_on),
            "training_objects": tuple(sorted(objects)),
            "weights": self.weights,
        }
        made = submission_of(evaluation, self.task, self.split, told, heap_set.camera)
        out = self.out or Path(f"{made.card.name}-{self.task}-{self.split}{SUFFIX}")
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
