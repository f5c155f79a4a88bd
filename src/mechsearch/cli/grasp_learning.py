"""`mechsearch grasp label`, `train`, `test`, `calibrate`, by gripper too; all need PyTorch."""

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mechsearch.cli.command import (
    FLAT,
    Command,
    OfEpisodes,
    OfObjects,
    Parallel,
    bars,
    say,
    say_table,
    wrote,
)
from mechsearch.files import NETWORK_FILE, write_json, write_text
from mechsearch.grasp.learning.labelling import (
    LabelConfig,
    TrialConfig,
    label_grasps,
    label_trials,
    load_grasps,
    load_rounds,
    load_trials,
)
from mechsearch.grasp.learning.metrics import NetworkComparison
from mechsearch.grasp.learning.training import (
    GraspTrainConfig,
    compare_networks,
    compare_quality_networks,
    train_grasp_network,
    train_quality_network,
)
from mechsearch.grasp.quality_network import quality_file
from mechsearch.heaps.dataset import load_heaps
from mechsearch.retrieval.calibration import calibrate_network
from mechsearch.types import Floats, check_extra


@dataclass(frozen=True)
class LabelGrasps(OfObjects, Parallel):
    """Try grasps on every visible object of every heap, and record what became of them.

    No network proposes them. A folder that was cut off is continued.
    With `--gripper NAME`, of any gripper: `--gripper NAME --help` tells its options.

    Attributes:
        heaps: Heap set (.parquet).
        out: Folder for the labelled grasps.
        config: What to label.
    """

    keeps = "the files of labelled heaps so far are"

    heaps: Path
    out: Path
    config: Annotated[LabelConfig, FLAT] = field(default_factory=LabelConfig)

    def run(self) -> None:
        """Label, and say what became of the grasps."""
        heap_set = load_heaps(self.heaps)
        objects = self.objects or heap_set.objects
        with bars() as progress:
            label_grasps(heap_set, objects, self.config, self.out, self.workers, progress)
        grasps = load_grasps(self.out)
        say(f"{len(grasps)} grasps, {grasps.success.mean():.1%} succeed")
        say(", ".join(f"{name} {count}" for name, count in grasps.counts.most_common()))
        wrote(self.out)


@dataclass(frozen=True)
class TrainGrasps(Command):
    """Train a grasp network on labelled grasps, from scratch, or go on with a training.

    With `--gripper NAME`, of any gripper: `--gripper NAME --help` tells its options.

    Attributes:
        labels: Folder that `mechsearch grasp label` wrote.
        out: Folder for checkpoint and network; one that was cut off is continued.
        config: How to train.
    """

    keeps = "the epochs so far are"

    labels: Path
    out: Path
    config: Annotated[GraspTrainConfig, FLAT] = field(default_factory=GraspTrainConfig)

    def run(self) -> None:
        """Train, and say how good the best epoch is."""
        grasps = load_grasps(self.labels)
        with bars() as progress:
            history = train_grasp_network(grasps, self.config, self.out, progress)
        _say_best(history)
        wrote(self.out / NETWORK_FILE)


@dataclass(frozen=True, kw_only=True)
class JudgingCommand(Command):
    """A command that holds qualities against outcomes.

    Attributes:
        out: File (.json) to write.
        plot: Reliability diagram (.svg) to write.
    """

    writes = (("out", (".json",)), ("plot", (".svg",)))

    out: Path | None = None
    plot: Path | None = None

    def check_places(self) -> None:
        """Refuse a diagram that cannot be drawn here, too."""
        super().check_places()
        if self.plot:
            check_extra("--plot", "report")

    def write(self, found: Mapping[str, Any], curves: Mapping[str, Floats]) -> None:
        """Write what was found, and draw curves (b, 3), where it was asked for."""
        if self.out:
            write_json(self.out, found)
            wrote(self.out)
        if self.plot:
            figures = importlib.import_module("mechsearch.report.figures")
            write_text(self.plot, figures.to_svg(figures.draw_reliability(curves)))
            wrote(self.plot)


@dataclass(frozen=True)
class TestGrasps(JudgingCommand):
    """Judge grasp networks on labelled grasps that they have not learnt from.

    With `--gripper NAME`, of any gripper: `--gripper NAME --help` tells its options.

    Attributes:
        networks: Grasp networks (.safetensors, or the released weights .npz) beside the shipped
            one.
        labels: Folder that `mechsearch grasp label` wrote, such as one of held-out heaps.
    """

    labels: Path
    networks: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NETWORK ...]")
    ] = ()

    def run(self) -> None:
        """Print a table of scores, and by how much the first network is above each other one."""
        grasps = load_grasps(self.labels)
        named = {"shipped": None, **{path.stem: path for path in self.networks}}
        with bars() as progress:
            found = compare_networks(grasps, named, progress)
        _say_comparison(found, f"{len(grasps)} grasps")
        self.write(asdict(found), {k: np.array(v.curve) for k, v in found.networks.items()})


@dataclass(frozen=True)
class CalibrateGrasps(JudgingCommand, OfEpisodes):
    """Hold a network's scores against lift success, on heaps before and after pushing.

    On the first and last state of every recorded episode the best grasps on the target, and as many
    drawn at random, are executed with perturbations. The chance of success is fitted to the quality
    on every second heap and tested on the others.

    Attributes:
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        grasps: Best grasps to try on each state, and as many at random.
        repeats: Perturbed executions of each grasp.
    """

    network: Path | None = None
    grasps: int = 10
    repeats: int = 5

    def run(self) -> None:
        """Try, fit, test and print."""
        states = [
            (self.objects or str(evaluation.header["object_set"]), record)
            for _, evaluation in self.recorded()
            for record in evaluation.episodes
        ]
        with bars() as progress:
            found = calibrate_network(
                self.network, states, self.grasps, self.repeats, self.workers, progress
            )
        rows = [(f"{q:.2f}", f"{share:.2f}", f"{n:.0f}") for q, share, n in found.curve]
        say_table("On the test half", ("fitted chance", "succeed", "executions"), rows)
        say(
            f"fitted chance of success: logistic, {found.slope:.2f} logit(quality) "
            f"{found.offset:+.2f}; one half from a quality of {found.threshold:.2f}\n"
            f"Brier score on {found.executions} executions of the test half: {found.brier:.3f} as "
            f"rated, {found.brier_fitted:.3f} as fitted\n"
            f"Spearman correlation with lift success: quality {found.rank_correlation:.2f}, "
            f"graspability over {2 * len(states)} states {found.score_correlation:.2f}"
        )
        curves = {"quality as rated": found.rated, "chance as fitted": found.curve}
        self.write(found.to_json(), curves)


@dataclass(frozen=True)
class LabelTrials(OfObjects, Parallel):
    """Try a gripper's grasps in many states of every heap, and record what became of them.

    Every visible object is the target in turn. The first round leaves all to chance; with a network
    a share of the grasps are those that it rates best. A folder that was cut off is continued.

    Attributes:
        heaps: Heap set (.parquet).
        out: Folder for the labelled grasps.
        network: Quality network (.safetensors) that picks a share of the grasps.
        config: What to try.
    """

    keeps = LabelGrasps.keeps

    heaps: Path
    out: Path
    network: Path | None = None
    config: Annotated[TrialConfig, FLAT] = field(default_factory=TrialConfig)

    def run(self) -> None:
        """Label, and say what became of the grasps."""
        heap_set = load_heaps(self.heaps)
        objects = self.objects or heap_set.objects
        with bars() as progress:
            label_trials(
                heap_set, objects, self.config, self.out, self.network, self.workers, progress
            )
        trials = load_trials(self.out)
        say(f"{len(trials)} grasps, {trials.success.mean():.1%} of their executions succeed")
        say(", ".join(f"{name} {count}" for name, count in trials.counts.most_common()))
        wrote(self.out)


@dataclass(frozen=True, kw_only=True)
class TrainQuality(Command):
    """Train a gripper's quality network, from scratch, or go on with a training.

    Attributes:
        gripper: By name: jaws-56, jaws-85 or suction.
        labels: Folders that `mechsearch grasp label --gripper` wrote, one for each round.
        out: Folder for checkpoint and network; one that was cut off is continued.
        config: How to train.
    """

    keeps = TrainGrasps.keeps

    gripper: str
    labels: tuple[Path, ...]
    out: Path
    config: Annotated[GraspTrainConfig, FLAT] = field(default_factory=GraspTrainConfig)

    def run(self) -> None:
        """Train, and say how good the best epoch is."""
        trials = load_rounds(self.gripper, self.labels)
        with bars() as progress:
            history = train_quality_network(self.gripper, trials, self.config, self.out, progress)
        _say_best(history)
        wrote(self.out / NETWORK_FILE)


@dataclass(frozen=True, kw_only=True)
class TestQuality(JudgingCommand):
    """Judge a gripper's quality networks on grasps that they have not learnt from.

    Attributes:
        networks: Quality networks (.safetensors) beside the shipped one.
        gripper: By name: jaws-56, jaws-85 or suction.
        labels: Folders that `mechsearch grasp label --gripper` wrote, such as one of held-out
            heaps.
    """

    networks: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NETWORK ...]")
    ] = ()
    gripper: str
    labels: tuple[Path, ...]

    def run(self) -> None:
        """Print a table of scores, and by how much the first network is above each other one."""
        trials = load_rounds(self.gripper, self.labels)
        named: dict[str, Path | None] = {}
        if quality_file(self.gripper).exists() or not self.networks:
            named["shipped"] = None
        named |= {path.parent.name if path.stem == "network" else path.stem: path
                  for path in self.networks}  # fmt: skip
        found = compare_quality_networks(self.gripper, trials, named)
        _say_comparison(found, f"Executions of {len(trials)} grasps")
        self.write(asdict(found), {k: np.array(v.curve) for k, v in found.networks.items()})


def _say_best(history: Sequence[Mapping[str, float]]) -> None:
    """Say how good the best epoch of a training is."""
    best = max(range(len(history)), key=lambda i: history[i]["average_precision"])
    row = history[best]
    say(
        f"best epoch {best + 1} of {len(history)}: average precision "
        f"{row['average_precision']:.3f} (base rate {row['base_rate']:.3f}), AUC "
        f"{row['auc']:.3f}, Brier score {row['brier']:.3f} on validation heaps"
    )


def _say_comparison(found: NetworkComparison, grasps: str) -> None:
    """Print the scores of networks, and by how much the first is above each other one."""
    first, *_ = found.networks
    rate = f"base rate {found.networks[first].base_rate:.3f}"
    columns = ("network", "AP", "AUC", "Brier", "calibration error")
    numbers = attrgetter("average_precision", "auc", "brier", "calibration_error")
    rows = [(k, *map("{:.3f}".format, numbers(v))) for k, v in found.networks.items()]
    say_table(f"{grasps} in {found.heaps} heaps, {rate}", columns, rows)
    for name, gain in found.gain_over.items():
        say(
            f"AP of {'the shipped network' if first == 'shipped' else first} above that of {name}: "
            f"{gain.mean:+.3f} (95 % interval over heaps {gain.low:+.3f} to {gain.high:+.3f})"
        )
