"""`mechsearch assets` and `mechsearch objects`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from mechsearch.cli.command import PICTURES, Command, bars, save, say, say_table
from mechsearch.objects.catalog import load_object_set, ycb_folder
from mechsearch.objects.model import ObjectModel
from mechsearch.objects.ycb.download import OFFICIAL, pull_ycb
from mechsearch.pictures.sheet import object_sheet


@dataclass(frozen=True)
class Pull(Command):
    """Download the YCB objects; an interrupted download goes on where it stopped.

    Attributes:
        which: Object set.
        folder: Where to keep them; the user's cache folder by default.
        names: Objects to pull, such as 025_mug; all by default.
        site: Address to pull from.
    """

    keeps = "what is downloaded is"

    which: Annotated[Literal["ycb"], tyro.conf.Positional]
    folder: Path | None = None
    names: tuple[str, ...] = ()
    site: str = OFFICIAL

    def run(self) -> None:
        """Download, and say what came."""
        folder = self.folder or ycb_folder()
        with bars() as progress:
            pulled = pull_ycb(folder, self.site, self.names or None, progress)
        say(
            f"{len(pulled.fetched)} objects downloaded, {len(pulled.present)} were there already, "
            f"{len(pulled.without_scan)} have no scan; they are in {folder}"
        )


@dataclass(frozen=True)
class List(Command):
    """List the objects of a set, and those that cannot lie in a heap with the reason.

    Attributes:
        objects: "household", "ycb", or a folder of meshes with masses.
    """

    objects: str = "household"

    def run(self) -> None:
        """Print the table."""
        found = load_object_set(self.objects)
        columns = ("object", "category", "size [cm]", "mass [g]", "parts", "hull error [mm]")
        caption = f"{found.name}: {len(found.models)} objects"
        say_table(caption, columns, map(_row, found.models.values()))
        flagged = [name for name, model in found.models.items() if model.flagged]
        if flagged:
            say(f"! more than 5 mm between mesh and convex parts: {', '.join(flagged)}\n")
        if found.excluded:
            say_table("left out", ("object", "reason"), found.excluded.items())


@dataclass(frozen=True)
class Sheet(Command):
    """Draw every object of a set on one picture.

    Attributes:
        objects: "household", "ycb", or a folder of meshes with masses.
        out: Picture to write (.png, .jpg or .webp).
        columns: Objects in a row.
        size: Side of each tile [px].
    """

    writes = (("out", PICTURES),)

    objects: str = "household"
    out: Path = Path("objects.png")
    columns: int = 8
    size: int = 144

    def run(self) -> None:
        """Draw and write the picture."""
        models = load_object_set(self.objects).models
        save(self.out, object_sheet(models, self.columns, self.size).save)


def _row(model: ObjectModel) -> tuple[str, ...]:
    size = " x ".join(f"{side * 100:.1f}" for side in np.ptp(model.vertices, axis=0))
    error = f"{model.hull_error * 1000:.1f}{' !' if model.flagged else ''}"
    parts, mass = str(len(model.parts)), f"{model.mass * 1000:.0f}"
    return model.name, model.category, size, mass, parts, error
