"""`mechsearch export episodes`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mechsearch.cli.command import OfObjects, Spread, bars, say, wrote
from mechsearch.evaluation.frames import frames_of
from mechsearch.evaluation.lerobot import write_lerobot
from mechsearch.evaluation.minari import write_minari
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, load_some
from mechsearch.files import check_absent, check_place, write_folder

_OPENED_BY = {
    "lerobot": 'LeRobotDataset("{name}", root="{out}")',
    "minari": 'minari.MinariDataset("{out}/data")',
}


@dataclass(frozen=True)
class ExportEpisodes(OfObjects, Spread):
    """Write episodes with all that was seen in them as a data set for other libraries.

    Each action stands with the images before it (colour, depth, target), reward, task in words and
    camera. Neither library need be installed.

    Attributes:
        source: File that `mechsearch evaluate` wrote (.npz), or a policy, as it takes them, whose
            episodes are made now.
        out: Folder to write.
        format: Of LeRobot (its v3.0), or of Minari.
        heaps: Of a policy: heap set (.parquet); the embedded heaps by default.
        split: Of a policy: "held-out", "train" or "all" heaps.
        limit: Number of episodes, spread evenly; 0 takes all.
        seed: Of a policy's own randomness.
        gripper: Of a policy that retrieves, such as jaws-85, or several joined by a plus sign.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="EPISODES|POLICY")]
    out: Path
    format: Literal["lerobot", "minari"]
    heaps: Path | None = None
    split: str = "held-out"
    limit: int = 0
    seed: int = 0
    gripper: str = ""

    def run(self) -> None:
        """Write the data set, and say how it is opened."""
        out = self.out.resolve()
        check_absent(out)
        check_place(out.with_name(f".{out.name}.partial"))
        left_out: list[str] = []
        with self.spread() as (workers, mapper), bars() as progress:
            if Path(self.source).suffix == ".npz":
                evaluation = load_some(Path(self.source), self.limit)
            else:
                plan = EvaluationPlan(
                    self.source, self.heaps, "", self.objects, self.split, self.limit, self.seed,
                    grippers=tuple(self.gripper.split("+")) if self.gripper else (),
                )  # fmt: skip
                evaluation = evaluate_plan(plan, workers, progress, mapper)
            header = evaluation.header
            frames = frames_of(
                evaluation, self.objects, workers, progress, mapper, left_out.append
            )  # fmt: skip
            if self.format == "minari":
                write_folder(out, lambda f: write_minari(f, header, frames, out.name))
            else:
                write_folder(out, lambda f: write_lerobot(f, header, frames))
        for line in left_out:
            say(line)
        call = _OPENED_BY[self.format].format(name=out.name, out=self.out)
        say(f"{len(evaluation.episodes) - len(left_out)} episodes; opened by {call}")
        wrote(self.out)
