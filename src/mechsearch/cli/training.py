"""`mechsearch demonstrate` and `mechsearch train`; both need PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, objects_of, say, spread, wrote
from mechsearch.env.heap_env import HeapEnv
from mechsearch.evaluation.look_ahead import LookAheadConfig
from mechsearch.heaps.dataset import HeapSet, check_objects, load
from mechsearch.runs import read_json, write_json
from mechsearch.train.assemble import assemble
from mechsearch.train.checkpoint import CONFIG_FILE
from mechsearch.train.collector import Env
from mechsearch.train.config import PRESETS, TrainConfig, load_config, preset_config
from mechsearch.train.demonstrations import Demonstration, DemonstrationStore
from mechsearch.train.expert import DemonstrateConfig, LookAheadExpert, demonstrate, failed
from mechsearch.train.imitate import Expert, imitate
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
        config = load_config(folder / CONFIG_FILE)
        inputs = read_json(folder / INPUTS_FILE, "record of a run's inputs")
        shown = inputs["demonstrations"]
        return cls(
            Path(inputs["heaps"]),
            folder,
            config,
            inputs["objects"],
            Path(shown) if shown else None,
            resume=True,
        )

    def run(self) -> None:
        """Train, with a progress bar that shows the last evaluation."""
        heap_set = load(self.heaps)
        objects = objects_of(heap_set, self.objects)
        check_objects(heap_set, objects)
        shown = self._demonstrations(heap_set)
        self._record_inputs(heap_set)
        parts = assemble(self.config, heap_set, objects)
        with bars() as progress:
            if shown is None:
                scores = train(self.config, parts, self.out, self.resume, progress)
            else:
                expert = _expert_for(parts.env)
                scores = imitate(self.config, shown, self.out, parts, expert, self.resume, progress)
        if scores:
            values = ", ".join(f"{name} {value:.3g}" for name, value in scores.items())
            say(f"last evaluation, on validation heaps: {values}")
        wrote(self.out)

    def _demonstrations(self, heap_set: HeapSet) -> list[Demonstration] | None:
        """Return what is to be imitated, or None where the variant does not imitate.

        Raises:
            MechSearchError: If demonstrations are missing, not asked for, or of other heaps.
        """
        imitation = self.config.imitation
        if bool(imitation.updates) != bool(self.demonstrations):
            raise MechSearchError(
                f"{self.config.name} imitates; give it --demonstrations, a folder that "
                "`mechsearch demonstrate` wrote"
                if imitation.updates
                else f"{self.config.name} does not imitate; leave --demonstrations out"
            )
        if self.demonstrations is None:
            return None
        store = DemonstrationStore(self.demonstrations)
        if store.facts().get("heap_set") != heap_set.hash:
            raise MechSearchError(
                f"the demonstrations at {self.demonstrations} are of other heaps than {self.heaps}"
            )
        return store.read_all(imitation.demonstrations)

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
            shown = str(self.demonstrations.resolve()) if self.demonstrations else None
            inputs = {"heaps": heaps, "heap_set": heap_set.hash, "objects": objects}
            write_json(file, inputs | {"demonstrations": shown})


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


def _expert_for(task: Env) -> Expert:
    """Return the look-ahead expert for corrections in an environment over heaps."""
    look_ahead = LookAheadExpert(_over_heaps(task))
    return lambda env: look_ahead(_over_heaps(env))


def _over_heaps(env: Env) -> HeapEnv:
    if not isinstance(env, HeapEnv):
        raise MechSearchError(f"the expert plans over heaps, not in a {type(env).__name__}")
    return env


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
