"""`mechsearch export grasps`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, bars, wrote
from mechsearch.training.export import export_grasps


@dataclass(frozen=True)
class ExportGrasps(Command):
    """Write a gripper's grasp network for a robot's computer, which needs no PyTorch.

    Attributes:
        gripper: jaws-56, jaws-85 or suction, or a network's file (.safetensors) of
            `mechsearch grasp train --gripper`.
        out: Folder of grasps.onnx and grasps.json.
    """

    gripper: Annotated[str, tyro.conf.Positional]
    out: Path

    def run(self) -> None:
        """Write both files."""
        with bars() as progress:
            progress(what := f"grasps of {self.gripper}", 0, 1)
            export_grasps(self.gripper, self.out)
            progress(what, 1, 1)
        wrote(self.out)
