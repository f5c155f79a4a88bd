"""`mechsearch grasp lift`, `label`, `train` and `test` with `--gripper`, and `grasp ceiling`.

They use a gripper's planner and quality network; all need PyTorch.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mechsearch.cli.command import (
    FLAT,
    Command,
    OfObjects,
    Parallel,
    bars,
    save,
    say,
    say_table,
    wrote,
)
from mechsearch.cli.grasp_learning import JudgingCommand, say_best, say_comparison
from mechsearch.evaluation.episodes import (
    CEILING_METRICS,
    Estimate,
    mean_interval,
    merge_summary,
    share_interval,
)
from mechsearch.files import check_place, write_json
from mechsearch.findings.bootstrap import estimated
from mechsearch.grasp.learning.quality_training import (
    compare_quality_networks,
    train_quality_network,
)
from mechsearch.grasp.learning.training import NETWORK_FILE, GraspTrainConfig
from mechsearch.grasp.learning.trials import TrialConfig, label_trials, load_rounds, load_trials
from mechsearch.grasp.quality_network import quality_file
from mechsearch.heaps.dataset import Heap, HeapSet, load_heaps, open_heaps
from mechsearch.pictures.canvas import tiled
from mechsearch.pictures.grasps import lift_strip
from mechsearch.retrieval.assessment import LiftResult
from mechsearch.retrieval.lifting import (
    LIFT_STATES,
    CeilingConfig,
    LiftPlan,
    Robot,
    TargetLifts,
    ceiling_rows,
    film_target,
    lift_targets,
    reach_of,
)
from mechsearch.sim.gripper import gripper_named
from mechsearch.sim.lift import Outcome
from mechsearch.types import MechSearchError


@dataclass(frozen=True, kw_only=True)
class GripperTargets(OfObjects, Parallel):
    """Whose grasps a command is about.

    Attributes:
        heaps: Heap set (.parquet).
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        seed: Of all randomness.
    """

    heaps: Path
    split: str = "held-out"
    limit: int = 0
    seed: int = 0

    def opened(self) -> tuple[HeapSet, list[Heap], str]:
        """Return the heap set, the heaps that are meant, and their object set."""
        heap_set, _ = open_heaps(self.heaps, self.objects)
        heaps = [heap_set.heaps[i] for i in heap_set.choose(self.split, self.limit)]
        return heap_set, heaps, self.objects or heap_set.objects


@dataclass(frozen=True, kw_only=True)
class LiftChosen(GripperTargets):
    """Lift each target with the best-rated grasp, and with the first that geometry promises.

    Both are tried in the heap as dropped, after random pushes and with the target alone. Where
    there is no grasp to try, the target is not lifted.

    Attributes:
        gripper: By name: jaws-56, jaws-85 or suction.
        network: Its quality network (.safetensors), to take instead of the shipped one.
        states: Some of dropped, pushed and alone.
        repeats: Executions of each grasp with errors of place, direction and friction, beside the
            exact one.
        out: Picture (.png) to write: of each heap, a strip of frames of the best-rated grasp, in
            the first state.
        table: File (.json) to write: the shares and their differences.
    """

    gripper: str
    network: Path | None = None
    states: tuple[str, ...] = LIFT_STATES
    repeats: int = 0
    out: Path | None = None
    table: Path | None = None

    def run(self) -> None:
        """Plan, lift, print outcomes and draw."""
        networks = (self.network,) if self.network else ()
        robot = Robot((self.gripper,), networks)
        for place in filter(None, (self.out, self.table)):
            check_place(place)
        _, heaps, objects = self.opened()
        plan = LiftPlan(objects, robot, self.states, self.repeats, self.seed)
        with bars() as progress:
            found = lift_targets(heaps, plan, self.workers, progress)
        rows, table = [], []
        for state in self.states:
            own = [lifts for lifts in found if lifts.state == state]
            for executed in ("as planned", "perturbed") if self.repeats else ("as planned",):
                if own:
                    row = _gain(own, executed == "perturbed")
                    table.append({"state": state, "executed": executed, **row})
                    rows.append((state, executed, str(len(own)), *_cells(row)))
        columns = ("state", "executed", "targets", "best-rated", "first drawn", "gain")
        say_table(f"Share of targets that {self.gripper} lifts", columns, rows)
        self._say_outcomes(found)
        if self.table:
            write_json(self.table, {"gripper": self.gripper, "seed": self.seed, "rows": table})
            wrote(self.table)
        if self.out:
            self._draw(self.out, heaps, plan, found)

    def _say_outcomes(self, found: Sequence[TargetLifts]) -> None:
        tried = [str(lifts.chosen.planned) for lifts in found if lifts.chosen]
        counts = {name: tried.count(name) for name in map(str, Outcome) if name in tried}
        counts["no grasp"] = len(found) - len(tried)
        said = ", ".join(f"{name} {count}" for name, count in counts.items())
        none = sum(lifts.drawn is None for lifts in found)
        say(f"best-rated: {said}\nfirst drawn: no grasp {none}")

    def _draw(
        self, path: Path, heaps: Sequence[Heap], plan: LiftPlan, found: Sequence[TargetLifts]
    ) -> None:
        by_seed = {heap.seed: heap for heap in heaps}
        strips = []
        for lifts in found:
            if lifts.state == self.states[0] and lifts.chosen:
                heap = by_seed[lifts.heap]
                film, models, place = film_target(heap, plan, lifts)
                name = heap.objects[heap.target].replace("_", " ")
                caption = f"{name}: {lifts.quality:.2f}, {lifts.chosen.planned}"
                gripper = gripper_named(self.gripper)
                strips.append(lift_strip(film, models, gripper, place, caption))
        if not strips:
            raise MechSearchError("no target can be grasped in these heaps: there is no film")
        save(path, tiled(strips, 1, gap=0).save)


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

    gripper: str
    labels: tuple[Path, ...]
    out: Path
    config: Annotated[GraspTrainConfig, FLAT] = field(default_factory=GraspTrainConfig)

    def run(self) -> None:
        """Train, and say how good the best epoch is."""
        trials = load_rounds(self.gripper, self.labels)
        with bars() as progress:
            history = train_quality_network(self.gripper, trials, self.config, self.out, progress)
        say_best(history)
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
        say_comparison(found, f"Executions of {len(trials)} grasps")
        self.write(asdict(found), {k: np.array(v.curve) for k, v in found.networks.items()})


@dataclass(frozen=True, kw_only=True)
class FindCeiling(GripperTargets):
    """Find the share of targets that any grasp lifts once all clutter is gone.

    Attributes:
        gripper: By name, or several joined by a plus sign, such as jaws-85+suction.
        networks: Their quality networks (.safetensors), one for each gripper, to take instead of
            the shipped ones.
        rated: The best apart that are tried, of each gripper.
        geometric: More that geometry alone promises, of each gripper.
        summary: Table (.csv) in which to enter the shares.
        experiment: First column of that table.
    """

    gripper: str
    networks: tuple[Path, ...] = ()
    rated: int = 30
    geometric: int = 150
    summary: Path | None = None
    experiment: str = "retrieval"

    def run(self) -> None:
        """Try, print, and enter the shares."""
        robot = Robot(tuple(self.gripper.split("+")), self.networks)
        config = CeilingConfig(self.rated, self.geometric, self.seed)
        if self.summary:
            check_place(self.summary)
        heap_set, heaps, objects = self.opened()
        with bars() as progress:
            found = reach_of(heaps, objects, robot, config, self.workers, progress)
        rows = ceiling_rows(self.experiment, heap_set.condition, robot, self.seed, found)
        shares = {row.metric: _share(row.mean, row.ci_low, row.ci_high) for row in rows}
        cells = [(name.replace("_", " "), shares[name]) for name in CEILING_METRICS]
        say_table(f"{len(found)} targets without clutter, {self.gripper}", ("", "share"), cells)
        if self.summary:
            merge_summary(self.summary, rows)
            wrote(self.summary)


def _gain(lifts: Sequence[TargetLifts], perturbed: bool) -> dict[str, Any]:
    """Return the shares of targets that both grasps lift, and the gain, paired over heaps."""

    def lifted(result: LiftResult | None) -> float:
        if result is None:
            return 0.0
        return result.probability if perturbed else float(result.planned is Outcome.SUCCESS)

    chosen, drawn = (
        [lifted(way) for way in ways]
        for ways in zip(*((each.chosen, each.drawn) for each in lifts), strict=True)
    )
    interval = mean_interval if perturbed else share_interval
    pair = [np.array([chosen]), np.array([drawn])]
    return {
        "chosen": asdict(interval(chosen)),
        "drawn": asdict(interval(drawn)),
        "gain": asdict(estimated(pair, lambda means: means[0] - means[1])),
    }


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    found = [Estimate(**row[name]) for name in ("chosen", "drawn", "gain")]
    *shares, gain = (_share(each.mean, each.ci_low, each.ci_high) for each in found)
    return (*shares, gain if found[2].mean < 0 else f"+{gain}")


def _share(mean: float, low: float, high: float) -> str:
    return f"{mean:.3f} ({low:.3f} to {high:.3f})"
