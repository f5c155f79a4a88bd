"""`mechsearch grasp calibrate`; it needs PyTorch."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, models_of, say, wrote
from mechsearch.evaluation import episodes
from mechsearch.files import write_json, write_text
from mechsearch.findings.tables import Table, to_text
from mechsearch.grasp.learning.calibrate import Calibration, TrialTask, calibrate, try_all
from mechsearch.grasp.network import SHIPPED, load_network
from mechsearch.report.figures import draw_reliability, to_svg
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Calibrate(Command):
    """Hold a network's scores against lift success, on heaps before and after pushing.

    On the first and last state of every recorded episode the best grasps on the target, and as many
    drawn at random, are executed with perturbations. The chance of success is fitted to the quality
    on every second heap and tested on the others.

    Attributes:
        episodes: Files that `mechsearch evaluate` wrote (.npz).
        network: Grasp network (.safetensors), or the released FC-GQCNN-4.0-PJ weights (.npz), to
            take instead of the shipped one.
        out: File (.json) to write.
        plot: Reliability diagram (.svg) to write.
        limit: Number of episodes of each file, spread evenly; 0 takes all.
        grasps: Best grasps to try on each state, and as many at random.
        repeats: Perturbed executions of each grasp.
        objects: Object set; the one that the files name by default.
        workers: Processes; the result does not depend on their number.
    """

    episodes: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="EPISODES [EPISODES ...]")
    ]
    network: Path | None = None
    out: Path | None = None
    plot: Path | None = None
    limit: int = 0
    grasps: int = 10
    repeats: int = 5
    objects: str = ""
    workers: int = WORKERS

    def run(self) -> None:
        """Try, fit, test and print."""
        if not self.episodes or self.grasps < 1 or self.repeats < 1:
            raise MechSearchError(
                f"{len(self.episodes)} files, {self.grasps} grasps and {self.repeats} repeats; "
                "expected at least one of each"
            )
        load_network(self.network)
        tasks = [task for path in self.episodes for task in self._tasks(path)]
        trials = []
        with bars() as progress:
            for i, trial in enumerate(try_all(tasks, self.workers)):
                trials.append(trial)
                progress("states tried", i + 1, len(tasks))
        found = calibrate(trials)
        say(_described(found, len(trials)))
        if self.out:
            write_json(
                self.out,
                {**asdict(found), "curve": found.curve.tolist(), "rated": found.rated.tolist()},
            )
            wrote(self.out)
        if self.plot:
            curves = {"quality as rated": found.rated, "chance as fitted": found.curve}
            write_text(self.plot, to_svg(draw_reliability(curves)))
            wrote(self.plot)

    def _tasks(self, path: Path) -> list[TrialTask]:
        evaluation = episodes.load_some(path, self.limit)
        models_of(evaluation, self.objects)
        spec = self.objects or str(evaluation.header["object_set"])
        network = self.network or SHIPPED
        return [
            TrialTask(
                network, spec, record.objects, record.target, poses, record.heap_seed,
                self.grasps, self.repeats,
            )
            for record in evaluation.episodes
            for poses in (record.poses[0], record.poses[-1])
        ]  # fmt: skip


def _described(found: Calibration, states: int) -> str:
    rows = tuple((f"{q:.2f}", f"{share:.2f}", f"{n:.0f}") for q, share, n in found.curve)
    curve = to_text(Table("On the test half", ("fitted chance", "succeed", "executions"), rows))
    return (
        f"{curve}\nfitted chance of success: logistic, {found.slope:.2f} logit(quality) "
        f"{found.offset:+.2f}; one half from a quality of {found.threshold:.2f}\n"
        f"Brier score on {found.executions} executions of the test half: {found.brier:.3f} as "
        f"rated, {found.brier_fitted:.3f} as fitted\n"
        f"Spearman correlation with lift success: quality {found.rank_correlation:.2f}, "
        f"graspability over {states} states {found.score_correlation:.2f}"
    )
