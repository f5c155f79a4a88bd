"""`mechsearch train`; needs PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import tyro

from mechsearch.cli.command import Command, bars, objects_of, say, wrote
from mechsearch.heaps.dataset import HeapSet, check_objects, load
from mechsearch.runs import read_json, write_json
from mechsearch.train.assemble import assemble
from mechsearch.train.checkpoint import CONFIG_FILE
from mechsearch.train.config import PRESETS, TrainConfig, load_config, preset_config
from mechsearch.train.loop import train
from mechsearch.types import MechSearchError

INPUTS_FILE = "inputs.json"
"""What a run was made from, beside its configuration, so that it can go on by itself."""


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
        config = load_config(folder / CONFIG_FILE)
        inputs = read_json(folder / INPUTS_FILE, "record of a run's inputs")
        return cls(Path(inputs["heaps"]), folder, config, inputs["objects"], resume=True)

    def run(self) -> None:
        """Train, with a progress bar that shows the last evaluation."""
        heap_set = load(self.heaps)
        objects = objects_of(heap_set, self.objects)
        check_objects(heap_set, objects)
        self._record_inputs(heap_set)
        parts = assemble(self.config, heap_set, objects)
        with bars() as progress:
            scores = train(self.config, parts, self.out, self.resume, progress)
        shown = ", ".join(f"{name} {value:.3g}" for name, value in scores.items())
        say(f"last evaluation, on validation heaps: {shown}")
        wrote(self.out)

    def _record_inputs(self, heap_set: HeapSet) -> None:
        """Write what the run is made from, or check that it is made from the same.

        Raises:
            MechSearchError: If a run that goes on began with other heaps.
        """
        file = self.out / INPUTS_FILE
        if self.resume:
            began = read_json(file, "record of a run's inputs")["heap_set"]
            if began != heap_set.hash:
                raise MechSearchError(
                    f"{self.out} began with the heap set {began[:12]}..., and {self.heaps} is "
                    f"{heap_set.hash[:12]}...; go on with the same"
                )
        elif not (self.out / CONFIG_FILE).exists():
            objects = self.objects or str(heap_set.manifest["config"]["objects"])
            heaps = str(self.heaps.resolve())
            write_json(file, {"heaps": heaps, "heap_set": heap_set.hash, "objects": objects})


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
