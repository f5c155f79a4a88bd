"""`mechsearch train`; needs PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import tyro

from mechsearch.cli.command import Command, bars, say, wrote
from mechsearch.evaluation.metrics import METRICS
from mechsearch.files.layout import CONFIG_FILE
from mechsearch.train.config import PRESETS, TrainConfig, load_config, preset_config
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
        resume: Whether the run goes on; said by `--resume FOLDER`.
    """

    heaps: Path
    out: Path
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    objects: str = ""
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
        return cls(inputs.heaps, folder, config, inputs.objects, resume=True)

    def run(self) -> None:
        """Train, with a progress bar that shows the last evaluation."""
        inputs = TrialInputs(self.heaps, self.objects)
        with bars() as progress:
            scores = run_trial(self.config, inputs, self.out, self.resume, progress)
        if scores:
            shown = [f"{name} {scores[name]:.3g}" for name in METRICS if name in scores]
            say(f"last evaluation: {', '.join(shown)}")
        others = crossings(self.out)
        if others:
            say(f"it went on with {', '.join(others)}: not the bits of a run that never stopped")
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
