"""`mechsearch demonstrate` and `mechsearch train`; both need PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, say, spread, wrote
from mechsearch.evaluation.look_ahead import LookAheadConfig
from mechsearch.evaluation.metrics import METRICS
from mechsearch.heaps.dataset import load
from mechsearch.train.checkpoint import CONFIG_FILE
from mechsearch.train.config import PRESETS, TrainConfig, load_config, preset_config
from mechsearch.train.expert import DemonstrateConfig, demonstrate, failed
from mechsearch.train.trial import TrialInputs, crossings, run_trial
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Train(Command):
    """Train an actor on the training half of a heap set, and write a run directory.

    Attributes:
        heaps: Heap set (.parquet).
        out: Run directory to write.
        config: The run.
        objects: Object set; the one that the heaps name by default.
        demonstrations: Folder that `mechsearch demonstrate` wrote; for variants that imitate.
        resume: Whether the run goes on; said by `--resume FOLDER`.
    """

    heaps: Path
    out: Path
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    objects: str = ""
    demonstrations: Path | None = None
    resume: tyro.conf.Suppress[bool] = False

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return options with the defaults of a variant, or of the run to go on with."""
        if not words or words[0] in ("-h", "--help"):
            say(_usage(program))
            raise SystemExit(0)
        if words[0] == "--resume":
            if len(words) < 2 or words[1].startswith("-"):
                raise MechSearchError("--resume needs a run directory, such as runs/method")
            return tyro.cli(
                cls, prog=program, args=list(words[2:]), default=cls._of_run(Path(words[1]))
            )
        config = preset_config(words[0])
        if "--resume" in words:
            raise MechSearchError(
                "a run goes on with what it began with: `mechsearch train --resume FOLDER`, where "
                "--actions may be raised"
            )
        default = cls(tyro.MISSING, tyro.MISSING, config)
        return tyro.cli(cls, prog=f"{program} {words[0]}", args=list(words[1:]), default=default)

    @classmethod
    def _of_run(cls, folder: Path) -> Self:
        config, inputs = load_config(folder / CONFIG_FILE), TrialInputs.of_run(folder)
        return cls(inputs.heaps, folder, config, inputs.objects, inputs.demonstrations, resume=True)

    def run(self) -> None:
        """Train, with a progress bar that shows the last evaluation."""
        inputs = TrialInputs(self.heaps, self.objects, self.demonstrations)
        with bars() as progress:
            scores = run_trial(self.config, inputs, self.out, self.resume, progress)
        if scores:
            shown = [f"{name} {scores[name]:.3g}" for name in METRICS if name in scores]
            say(f"last evaluation: {', '.join(shown)}")
        others = crossings(self.out)
        if others:
            say(f"it went on with {', '.join(others)}: not the bits of a run that never stopped")
        wrote(self.out)


@dataclass(frozen=True)
class Demonstrate(Command):
    """Try every teacher's push on the training heaps in the simulator, and record the best.

    Attributes:
        heaps: Heap set (.parquet).
        out: Folder to write; one that was cut off goes on.
        objects: Object set; the one that the heaps name by default.
        first: Index of the first training heap.
        count: Number of training heaps; 0 takes all.
        starts: Starting positions tried on each heap.
        seed: Of the starting positions.
        look_ahead: How far to look.
        workers: Processes; the demonstrations do not depend on their number.
        ray: Spread the work by Ray instead.
        ray_address: Of a Ray cluster, all of whose processors work; "auto" finds one that runs.
    """

    heaps: Path
    out: Path
    objects: str = ""
    first: int = 0
    count: int = 0
    starts: int = 1
    seed: int = 0
    look_ahead: LookAheadConfig = field(default_factory=LookAheadConfig)
    workers: int = WORKERS
    ray: bool = False
    ray_address: str = ""

    def run(self) -> None:
        """Record the demonstrations, and say how many succeeded."""
        heap_set = load(self.heaps)
        config = DemonstrateConfig(
            heaps=self.heaps,
            objects=self.objects or str(heap_set.manifest["config"]["objects"]),
            first=self.first,
            count=self.count,
            starts=self.starts,
            seed=self.seed,
            look_ahead=self.look_ahead,
        )
        crew = spread(self.workers, self.ray, self.ray_address)
        with crew as (workers, mapper), bars() as progress:
            store = demonstrate(config, self.out, workers, progress, mapper)
        shown, lost = store.names(), failed(self.out)
        say(f"{len(shown)} demonstrations; on {len(lost)} heaps no push succeeded")
        wrote(self.out)


def _usage(program: str) -> str:
    return "\n".join(
        [
            f"usage: {program} VARIANT --heaps FILE --out FOLDER [OPTIONS]",
            f"       {program} --resume FOLDER [--actions INT]",
            "",
            f"Variants: {', '.join(PRESETS)}.",
            f"`{program} VARIANT --help` tells every option with the variant's own default.",
        ]
    )
