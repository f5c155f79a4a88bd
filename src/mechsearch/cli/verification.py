"""`mechsearch verify`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import WORKERS, Command, bars, models_of, say
from mechsearch.evaluation.rollout import load_some, replay_all
from mechsearch.files import crossed, fingerprint
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Verify(Command):
    """Play recorded episodes again, and prove that poses, occlusions and rewards are the same bits.

    Attributes:
        episodes: Files that `mechsearch evaluate` wrote (.npz).
        heaps: Heap set (.parquet) that they ran on.
        objects: Object set; the one that the files name by default.
        limit: Number of episodes of each file, spread evenly; 0 takes all.
        workers: Processes.
    """

    episodes: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="EPISODES [EPISODES ...]")
    ]
    heaps: Path
    objects: str = ""
    limit: int = 0
    workers: int = WORKERS

    def run(self) -> None:
        """Verify; exit with 1 if an episode differs."""
        if not self.episodes:
            raise MechSearchError("no file of episodes named; expected at least one")
        passed = [self._verify(path) for path in self.episodes]
        if not all(passed):
            raise SystemExit(1)

    def _verify(self, path: Path) -> bool:
        evaluation = load_some(path, self.limit)
        models_of(evaluation, self.objects)
        with bars() as progress:
            found = list(replay_all(evaluation, self.heaps, self.objects, self.workers, progress))
        for replay in found:
            if not replay.passed:
                say(f"{path}: heap {replay.heap_seed}: {'; '.join(replay.differences)}")
        number, same = len(found), sum(replay.passed for replay in found)
        say(f"{path}: {same} of {number} episodes are as recorded, bit by bit")
        others = crossed(evaluation.header.get("fingerprint", {}), fingerprint())
        if others:
            say(f"here it is {', '.join(others)}: bits may differ by rounding")
        return same == number
