"""`mechsearch export segmenter`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, bars, wrote
from mechsearch.objects.catalog import load_object_set
from mechsearch.segmentation.photographs import load_references
from mechsearch.segmentation.reference import References, render_references
from mechsearch.training.export import export_segmenter
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class ExportSegmenter(Command):
    """Write a segmenter of one object for a robot's computer, which needs neither PyTorch nor mesh.

    Attributes:
        segmenter: shipped, or a network's file (.safetensors).
        out: Folder of segmenter.onnx and segmenter.json.
        reference: Views of the object (.npz), of `mechsearch segment reference`.
        object: Name of the object, seen by its mesh; in place of `reference`.
        objects: Object set that it is of.
    """

    segmenter: Annotated[str, tyro.conf.Positional]
    out: Path
    reference: Path | None = None
    object: str = ""
    objects: str = "household"

    def run(self) -> None:
        """Write both files."""
        references = self._references()
        target = self.object or str(self.reference)
        with bars() as progress:
            progress(what := f"masks of {target}", 0, 1)
            export_segmenter(self.segmenter, references, target, self.out)
            progress(what, 1, 1)
        wrote(self.out)

    def _references(self) -> References:
        if (self.reference is None) == (not self.object):
            given = "both" if self.object else "neither"
            raise MechSearchError(
                f"{given} of --reference and --object; expected one, which says what to look for"
            )
        if self.reference is not None:
            return load_references(self.reference)
        chosen = load_object_set(self.objects).choose(only=(self.object,))
        return render_references(chosen.models[self.object])
