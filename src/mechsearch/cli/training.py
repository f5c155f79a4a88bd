"""`mechsearch train`; needs PyTorch."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, Self, TypeVar

import tyro

from mechsearch.algorithm import A, RunConfig, Schedule
from mechsearch.cli.command import FLAT, Spread, bars, parsed, say, wrote
from mechsearch.env import TaskConfig
from mechsearch.evaluation.episodes import metrics_of
from mechsearch.files import CONFIG_FILE
from mechsearch.training.config import ALGORITHMS, PRESETS, load_config, run_config
from mechsearch.training.run import RunInputs, crossings, train
from mechsearch.training.run_directory import RunDirectory
from mechsearch.types import MechSearchError

T = TypeVar("T", bound=TaskConfig)


@dataclass(frozen=True)
class Train(Spread, Generic[A, T]):
    """Learn on the training half of a heap set, and write a run directory.

    Where pushes are learnt, processes go through episodes and fit networks side by side.

    Attributes:
        heaps: Heap set (.parquet).
        out: Run directory to write.
        name: Variant, under which the run is reported.
        seed: Of everything random.
        schedule: How long the run is, and when it is looked at.
        task: What is learnt.
        algorithm: How it learns.
        objects: Object set; the one that the heaps name by default.
        resume: Whether the run goes on; said by `--resume FOLDER`.
    """

    heaps: Path
    out: Path
    name: str
    seed: int
    schedule: Annotated[Schedule, FLAT]
    task: Annotated[T, FLAT]
    algorithm: Annotated[A, FLAT]
    objects: str = ""
    resume: tyro.conf.Suppress[bool] = False

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return options with the defaults of a variant, or of the run to go on with."""
        if not words or words[0] in ("-h", "--help", "--help-all"):
            say(_usage(program))
            raise SystemExit(0)
        if words[0] == "--resume":
            if len(words) < 2 or words[1].startswith("-"):
                raise MechSearchError("--resume needs a run directory, such as runs/method")
            folder = Path(words[1])
            config, inputs = load_config(folder / CONFIG_FILE), RunInputs.of_run(folder)
            default = cls._of(config, inputs.heaps, folder, inputs.objects, True)
            return cls._parsed(default, program, words[2:])
        config = run_config(words[0])
        if "--resume" in words:
            raise MechSearchError(
                "a run goes on with what it began with: `mechsearch train --resume FOLDER`, where "
                "--actions may be raised"
            )
        default = cls._of(config, tyro.MISSING, tyro.MISSING)
        return cls._parsed(default, f"{program} {words[0]}", words[1:])

    @classmethod
    def _of(cls, c: RunConfig[Any], heaps: Any, out: Any, *others: Any) -> Self:
        task: Any = c.task
        return cls(heaps, out, c.name, c.seed, c.schedule, task, c.algorithm, *others)

    @classmethod
    def _parsed(cls, default: Self, program: str, words: Sequence[str]) -> Self:
        """Return options, those of the default's own algorithm among them."""
        generic: Any = Train
        kind = generic[type(default.algorithm), type(default.task)]
        behind = (type(default.algorithm), type(default.task))
        options: Self = parsed(kind, program, words, behind, default=default)
        return options

    def run(self) -> None:
        """Train, with a progress bar that shows the last evaluation."""
        config = RunConfig(self.name, self.algorithm, self.seed, self.task, self.schedule)
        with bars() as progress, self.spread() as (workers, mapper):
            scores = train(
                config, self.heaps, self.out, self.objects, self.resume, progress, workers, mapper
            )
        if scores:
            shown = [f"{name} {scores[name]:.3g}" for name in metrics_of(scores)]
            say(f"last evaluation: {', '.join(shown)}")
        others = crossings(self.out)
        if others:
            say(f"it went on with {', '.join(others)}: not the bits of a run that never stopped")
        wrote(self.out)

    def interrupted(self, words: Sequence[str]) -> str:
        """Return which checkpoint is left, and the command that goes on from it."""
        if not (self.out / CONFIG_FILE).exists():
            return "nothing was learnt yet; give the same command again"
        said = f"kept is what was learnt in {RunDirectory(self.out).kept} actions, what came after "
        return f"{said}is lost; go on by `mechsearch train --resume {shlex.quote(str(self.out))}`"


def _usage(program: str) -> str:
    return f"""\
usage: {program} VARIANT --heaps FILE --out FOLDER [OPTIONS]
       {program} --resume FOLDER [--actions INT]

Variants: {", ".join(PRESETS)}; algorithms by themselves: {", ".join(ALGORITHMS)};
or package.module:factory, an algorithm of your own.
`{program} VARIANT --help` tells the main options with the variant's own defaults, and
`{program} VARIANT --help-all` every detail of the task and of the algorithm."""
