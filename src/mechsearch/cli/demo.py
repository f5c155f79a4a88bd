"""`mechsearch demo`: the whole way, once, small."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from mechsearch.cli.command import Parallel, bars, say, wrote
from mechsearch.cli.evaluation import Evaluate
from mechsearch.cli.heaps import describe
from mechsearch.cli.reporting import Report
from mechsearch.cli.training import Train
from mechsearch.evaluation.policies import policy_names
from mechsearch.files import CONFIG_FILE
from mechsearch.heaps.dataset import load_heaps
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.training.config import run_config

_RETRIEVING, _GRIPPER = ("retrieve", "grasp-only"), "jaws-85"


@dataclass(frozen=True)
class Demo(Parallel):
    """Heaps of household objects, a trained actor, scores beside all baselines, and a report.

    In the end targets are retrieved from the same heaps: the report shows it with the gripper.

    A demo that was cut off goes on where it stopped.

    Attributes:
        out: Folder for everything.
        heaps: How many, half of them held out.
        actions: To train for.
        seed: Of everything.
    """

    keeps = "what is finished, and checkpoints, are"

    out: Path = Path("demo")
    heaps: int = 180
    actions: int = 3000
    seed: int = 0

    def run(self) -> None:
        """Go the whole way."""
        began = time.monotonic()
        heaps, run, scores = self.out / "heaps.parquet", self.out / "run", self.out / "evaluations"
        say("1/5 heaps: drop household objects, keep the heaps that hide a target")
        if not heaps.exists():
            with bars() as progress:
                config = GenerateConfig(heaps=self.heaps, seed=self.seed)
                generate(config, heaps, self.workers, progress)
            wrote(heaps)
        describe(load_heaps(heaps))
        say("2/5 training: an actor on images, guided by three teachers")
        method = run_config("method")
        validation = min(12, self.heaps // 8)
        schedule = replace(
            method.schedule, actions=self.actions, evaluate_every=500, validation_heaps=validation
        )
        algorithm = replace(method.algorithm, updates_per_action=0.5)
        options = ("method", self.seed, schedule, method.task, algorithm)
        Train(heaps, run, *options, resume=(run / CONFIG_FILE).exists()).run()
        say("3/5 evaluation: everybody on the held-out heaps, from the same starts")
        policies = (str(run), *policy_names())
        Evaluate(policies, heaps, scores, seed=self.seed, workers=self.workers, brief=True).run()
        say("4/5 retrieval: the policy that is shipped, and grasping at once, in the same heaps")
        Evaluate(
            _RETRIEVING, heaps, scores, seed=self.seed, workers=self.workers, brief=True,
            gripper=_GRIPPER,
        ).run()  # fmt: skip
        say("5/5 report: one page, nothing else needed to read it")
        title = "Mechanical search: a first demonstration"
        Report((scores, run), self.out / "report.html", title).run()
        say(f"done in {(time.monotonic() - began) / 60:.1f} minutes")
