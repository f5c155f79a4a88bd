"""`mechsearch grasp label`, `train` and `test`; all need PyTorch."""

from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.files import write_json, write_text
from mechsearch.grasp.learning.fit import NETWORK, FitConfig, fit, predict
from mechsearch.grasp.learning.grasp_set import OUTCOMES, load_grasps
from mechsearch.grasp.learning.label import LabelConfig, label
from mechsearch.grasp.learning.metrics import Verdict, judge, paired_gain, reliability
from mechsearch.grasp.network import load_network
from mechsearch.heaps.dataset import load_heaps
from mechsearch.report.reliability import draw_reliability
from mechsearch.report.tables import Table, to_text


@dataclass(frozen=True)
class Label(Command):
    """Try grasps on every visible object of every heap, and record what became of them.

    No network proposes them. A folder that was cut off is continued.

    Attributes:
        heaps: Heap set (.parquet).
        out: Folder for the labelled grasps.
        config: What to label.
        objects: Object set; the one that the heaps name by default.
        workers: Processes; the grasps do not depend on their number.
    """

    heaps: Path
    out: Path
    config: Annotated[LabelConfig, tyro.conf.arg(name="")] = field(default_factory=LabelConfig)
    objects: str = ""
    workers: int = WORKERS

    def run(self) -> None:
        """Label, and say what became of the grasps."""
        heap_set = load_heaps(self.heaps)
        objects = self.objects or str(heap_set.manifest["config"]["objects"])
        with bars() as progress:
            folder = label(heap_set, objects, self.config, self.out, self.workers, progress)
        grasps = load_grasps(folder.path)
        counts = Counter(str(OUTCOMES[number]) for number in grasps.outcome)
        say(f"{len(grasps)} grasps, {grasps.success.mean():.1%} succeed")
        say(", ".join(f"{name} {count}" for name, count in counts.most_common()))
        wrote(self.out)


@dataclass(frozen=True)
class Train(Command):
    """Train a grasp network on labelled grasps, from scratch, or go on with a training.

    Attributes:
        labels: Folder that `mechsearch grasp label` wrote.
        out: Folder for checkpoint and network; one that was cut off is continued.
        config: How to train.
    """

    labels: Path
    out: Path
    config: Annotated[FitConfig, tyro.conf.arg(name="")] = field(default_factory=FitConfig)

    def run(self) -> None:
        """Train, and say how good the best epoch is."""
        grasps = load_grasps(self.labels)
        with bars() as progress:
            history = fit(grasps, self.config, self.out, progress)
        best = max(range(len(history)), key=lambda i: history[i]["average_precision"])
        row = history[best]
        say(
            f"best epoch {best + 1} of {len(history)}: average precision "
            f"{row['average_precision']:.3f} (base rate {row['base_rate']:.3f}), AUC "
            f"{row['auc']:.3f}, Brier score {row['brier']:.3f} on validation heaps"
        )
        wrote(self.out / NETWORK)


@dataclass(frozen=True)
class Test(Command):
    """Judge grasp networks on labelled grasps that they have not learnt from.

    Attributes:
        networks: Grasp networks (.safetensors, or the released weights .npz) beside the shipped
            one.
        labels: Folder that `mechsearch grasp label` wrote, such as one of held-out heaps.
        out: File (.json) to write.
        plot: Reliability diagram (.svg) to write.
    """

    labels: Path
    networks: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NETWORK ...]")
    ] = ()
    out: Path | None = None
    plot: Path | None = None

    def run(self) -> None:
        """Print a table of scores, and by how much the first network is above each other one."""
        grasps = load_grasps(self.labels)
        named = {"shipped": None, **{path.stem: path for path in self.networks}}
        rated = {name: predict(load_network(path), grasps) for name, path in named.items()}
        verdicts = {name: judge(quality, grasps.success) for name, quality in rated.items()}
        gains = {
            name: paired_gain(rated["shipped"], quality, grasps.success, grasps.heap)
            for name, quality in rated.items()
            if name != "shipped"
        }
        heaps = len(np.unique(grasps.heap))
        caption = f"{len(grasps)} grasps in {heaps} heaps, base rate {grasps.success.mean():.3f}"
        columns = ("network", "AP", "AUC", "Brier", "calibration error")
        rows = tuple(_row(name, verdict) for name, verdict in verdicts.items())
        say(to_text(Table(caption, columns, rows)))
        for name, gain in gains.items():
            say(
                f"AP of the shipped network above that of {name}: {gain.mean:+.3f} "
                f"(95 % interval over heaps {gain.low:+.3f} to {gain.high:+.3f})"
            )
        curves = {name: reliability(quality, grasps.success) for name, quality in rated.items()}
        if self.out:
            found = {
                name: {**asdict(verdict), "curve": curves[name].tolist()}
                for name, verdict in verdicts.items()
            }
            above = {name: asdict(gain) for name, gain in gains.items()}
            write_json(self.out, {"heaps": heaps, "networks": found, "gain_over": above})
            wrote(self.out)
        if self.plot:
            write_text(self.plot, draw_reliability(curves))
            wrote(self.plot)


def _row(name: str, verdict: Verdict) -> tuple[str, ...]:
    numbers = (verdict.average_precision, verdict.auc, verdict.brier, verdict.calibration_error)
    return (name, *(f"{number:.3f}" for number in numbers))
