"""`mechsearch view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import OfObjects, say
from mechsearch.evaluation.rollout import EvaluationPlan
from mechsearch.pictures.live import LiveSession, server


@dataclass(frozen=True)
class ViewLive(OfObjects):
    """Watch a policy on heaps in a browser, take over and push by hand, and keep the episode.

    The page is served on this machine alone until Ctrl-C. From another one, reach it by
    `ssh -L 8765:127.0.0.1:8765 MACHINE`, or let everybody in the network use it by --host 0.0.0.0.

    Attributes:
        policy: Who acts at first, as for `mechsearch evaluate`; others can be chosen on the page.
        heaps: Heap set (.parquet); by default the embedded heaps of household objects.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps to choose among, spread evenly; 0 takes all.
        seed: Of the policy's own randomness.
        gripper: Of policies that retrieve, such as jaws-85, or several joined by a plus sign.
        host: Name or address to listen at.
        port: To listen at; 0 takes a free one.
        out: Folder for the episodes that are kept.
    """

    policy: Annotated[str, tyro.conf.Positional] = "teacher-spiral"
    heaps: Path | None = None
    split: str = "held-out"
    limit: int = 24
    seed: int = 0
    gripper: str = ""
    host: str = "127.0.0.1"
    port: int = 8765
    out: Path = Path("episodes")

    def run(self) -> None:
        """Serve the page until it is interrupted."""
        plan = EvaluationPlan(
            self.policy, self.heaps, "", self.objects, self.split, self.limit, self.seed,
            grippers=tuple(self.gripper.split("+")) if self.gripper else (),
        )  # fmt: skip
        with server(LiveSession(plan, self.out), self.host, self.port) as listening:
            say(f"open http://{self.host}:{listening.server_port}/ in a browser; Ctrl-C ends it")
            listening.serve_forever()

    def interrupted(self, words: object) -> str:
        """Return what an interruption leaves."""
        return f"episodes that were saved are in {self.out}; the same command opens the page again"
