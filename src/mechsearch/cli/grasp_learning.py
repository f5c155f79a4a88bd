"""`mechsearch grasp label`, `train` and `test`; all need PyTorch."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.grasp.fit import NETWORK, FitConfig, fit, predict
from mechsearch.grasp.grasp_set import OUTCOMES, load_grasps
from mechsearch.grasp.label import LabelConfig, label
from mechsearch.grasp.metrics import Verdict, judge, reliability
from mechsearch.grasp.network import load_network
from mechsearch.heaps.dataset import load
from mechsearch.report.tables import Table, to_text
from mechsearch.types import MechSearchError


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
        heap_set = load(self.heaps)
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
        networks: Grasp networks (.safetensors, or the released weights .npz).
        labels: Folder that `mechsearch grasp label` wrote, such as one of held-out heaps.
        curve: Print the reliability curve of each network too.
    """

    networks: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NETWORK [NETWORK ...]")
    ]
    labels: Path
    curve: bool = False

    def run(self) -> None:
        """Print a table of scores."""
        if not self.networks:
            raise MechSearchError("no network named; expected at least one")
        grasps = load_grasps(self.labels)
        qualities = {path: predict(load_network(path), grasps) for path in self.networks}
        rows = tuple(_row(path, judge(q, grasps.success)) for path, q in qualities.items())
        columns = ("network", "AP", "AUC", "Brier", "calibration error")
        caption = f"{len(grasps)} grasps, base rate {grasps.success.mean():.3f}"
        say(to_text(Table(caption, columns, rows)))
        for path, quality in qualities.items() if self.curve else ():
            bins = reliability(quality, grasps.success)
            rows = tuple((f"{q:.2f}", f"{share:.2f}", f"{n:.0f}") for q, share, n in bins)
            say(to_text(Table(str(path), ("mean quality", "succeed", "grasps"), rows)))


def _row(path: Path, verdict: Verdict) -> tuple[str, ...]:
    numbers = (verdict.average_precision, verdict.auc, verdict.brier, verdict.calibration_error)
    return (str(path), *(f"{number:.3f}" for number in numbers))
