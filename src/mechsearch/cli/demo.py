"""`mechsearch demo`: the whole way, once, small."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from mechsearch.cli.command import WORKERS, Command, bars, say, wrote
from mechsearch.cli.evaluation import Evaluate
from mechsearch.cli.heaps import describe
from mechsearch.cli.reporting import Report
from mechsearch.cli.training import Train
from mechsearch.evaluation.policies import policy_names
from mechsearch.files import CONFIG_FILE
from mechsearch.heaps.dataset import load_heaps
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.training.config import run_config


@dataclass(frozen=True)
class Demo(Command):
    """Heaps of household objects, a trained actor, scores beside all baselines, and a report.

    A demo that was cut off goes on where it stopped.

    Attributes:
        out: Folder for everything.
        heaps: How many, half of them held out.
        actions: To train for.
        seed: Of everything.
        workers: Processes.
    """

    out: Path = Path("demo")
    heaps: int = 180
    actions: int = 3000
    seed: int = 0
    workers: int = WORKERS

    def run(self) -> None:
        """Go the whole way."""
        began = time.monotonic()
        heaps, run, scores = self.out / "heaps.parquet", self.out / "run", self.out / "evaluations"
        say("1/4 heaps: drop household objects, keep the heaps that hide a target")
        self._make_heaps(heaps)
        say("2/4 training: an actor on images, guided by three teachers")
        self._train(heaps, run)
        say("3/4 evaluation: everybody on the held-out heaps, from the same starts")
        policies = (str(run), *policy_names())
        Evaluate(policies, heaps, scores, seed=self.seed, workers=self.workers, brief=True).run()
        say("4/4 report: one page, nothing else needed to read it")
        title = "Mechanical search: a first demonstration"
        Report((scores, run), self.out / "report.html", title).run()
        say(f"done in {(time.monotonic() - began) / 60:.1f} minutes")

    def _make_heaps(self, path: Path) -> None:
        if not path.exists():
            config = GenerateConfig(heaps=self.heaps, seed=self.seed)
            with bars() as progress:
                generate(config, path, self.workers, progress)
            wrote(path)
        say(describe(load_heaps(path)))

    def _train(self, heaps: Path, folder: Path) -> None:
        config = run_config("method")
        schedule = replace(
            config.schedule,
            actions=self.actions,
            evaluate_every=500,
            validation_heaps=min(12, self.heaps // 8),
        )
        algorithm = replace(config.algorithm, updates_per_action=0.5)
        resume = (folder / CONFIG_FILE).exists()
        Train(
            heaps, folder, "method", self.seed, schedule, config.task, algorithm, resume=resume
        ).run()
