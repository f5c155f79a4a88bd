"""`mechsearch export policy`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, bars, wrote
from mechsearch.training.export import export_policy


@dataclass(frozen=True)
class ExportPolicy(Command):
    """Write a policy for a robot's computer, which needs no PyTorch: its network, and what it is.

    Attributes:
        policy: A shipped one that uncovers, a run directory, or one policy's file.
        out: Folder of policy.onnx and policy.json.
        candidates: Pushes to judge at each decision, whose time grows with them; by default as many
            as in training.
    """

    policy: Annotated[str, tyro.conf.Positional]
    out: Path
    candidates: int | None = None

    def run(self) -> None:
        """Write both files."""
        with bars() as progress:
            progress(what := f"network of {self.policy}", 0, 1)
            export_policy(self.policy, self.out, self.candidates)
            progress(what, 1, 1)
        wrote(self.out)
