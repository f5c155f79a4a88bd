"""Object sets by name, or from any folder of meshes with masses."""

import csv
import math
import os
import unicodedata
import warnings
from collections.abc import Mapping
from dataclasses import replace
from multiprocessing import parent_process
from pathlib import Path
from typing import NamedTuple

from mechsearch.files import cache_folder
from mechsearch.objects.household.object_set import household
from mechsearch.objects.meshes.cache import prepare_all
from mechsearch.objects.meshes.prepare import Source
from mechsearch.objects.meshes.reading import SUFFIXES
from mechsearch.objects.model import ObjectSet
from mechsearch.objects.ycb.download import SCAN
from mechsearch.processes import bars
from mechsearch.types import MechSearchError

_LAYOUTS = (
    "expected YCB objects (NNN_name/google_16k/textured.obj) or mesh files (*.obj, *.stl, *.glb), "
    "with a masses.csv (object,mass_kg)"
)


def load_object_set(spec: str | Path, workers: int | None = None) -> ObjectSet:
    """Return an object set.

    Args:
        spec: "household" (built in), "ycb" (downloaded before), or a folder of meshes.
        workers: Processes that prepare objects not in the cache; one for each processor by
            default.

    Raises:
        MechSearchError: If there is no such set or it cannot be prepared.
    """
    if spec == "household":
        return household()
    if spec == "ycb":
        folder = ycb_folder()
        if not any(folder.glob(f"*/{SCAN.as_posix()}")):
            raise MechSearchError(
                f"no YCB objects at {folder}; run `mechsearch assets pull ycb`, or pass the folder "
                f"of a copy in the official layout (NNN_name/{SCAN.as_posix()})"
            )
        return load_folder(folder, name="ycb", workers=workers, need_masses=False)
    folder = Path(spec).expanduser()
    if not os.path.exists(folder):  # Of names too long for the system, Path's own question raises.
        raise MechSearchError(
            f"no object set {str(spec)!r}; choose household, ycb, or a folder of meshes with masses"
        )
    return load_folder(folder, workers=workers)


def ycb_folder() -> Path:
    """Return where downloaded YCB objects are kept."""
    return cache_folder() / "ycb"


def load_folder(
    folder: str | Path,
    name: str | None = None,
    workers: int | None = None,
    need_masses: bool = True,
) -> ObjectSet:
    """Return the set of all objects in a folder, prepared or from the cache.

    Two layouts are known: the official YCB download, and mesh files side by side. Masses come
    from a `masses.csv` in the folder or, for YCB objects, from the published table. A mesh that
    cannot be read or prepared is left out, with a warning.

    Args:
        folder: Where the meshes are.
        name: Of the set; the folder's own by default.
        workers: Processes that prepare objects; as many as there are processors by default.
        need_masses: Whether an object without a mass is an error; else it is left out.

    Raises:
        MechSearchError: If the folder is missing, has no objects, lacks masses, or no object in it
            can lie in a heap.
    """
    folder = Path(folder)
    meshes = find_meshes(folder)
    table = folder / "masses.csv"
    published, own = ycb_masses(), read_masses(table) if table.exists() else {}
    masses = published | _of_meshes(own, meshes, table)
    missing = [item for item in meshes if item not in masses]
    if missing and need_masses:
        raise MechSearchError(
            f"no mass for {', '.join(missing)} of {folder}; expected a row object,mass_kg for each "
            f"in {table}"
        )
    excluded = dict.fromkeys(missing, "no published mass")
    sources = [
        Source(item, masses[item].category or "object", mesh, masses[item].mass)
        for item, mesh in meshes.items()
        if item in masses
    ]
    with bars() as progress:
        prepared = prepare_all(sources, workers, progress)
    models = {}
    for source, done in zip(sources, prepared, strict=True):
        if isinstance(done, MechSearchError) or done.excluded:
            excluded[source.name] = (
                str(done) if isinstance(done, MechSearchError) else done.excluded
            )
            continue
        # What an object is made from, and so its hash, is what its table says; this is a label.
        known = published.get(source.name, masses[source.name]).category
        category = masses[source.name].category or known or "object"
        models[source.name] = replace(done.model, category=category)
    if not models:
        reasons = "; ".join(f"{item}: {why}" for item, why in list(excluded.items())[:5])
        raise MechSearchError(f"no object of {folder} can lie in a heap ({reasons})")
    return ObjectSet(name or folder.resolve().name, models, dict(sorted(excluded.items())))


def find_meshes(folder: str | Path) -> dict[str, Path]:
    """Return the mesh file of each object in a folder, sorted by object name; hidden ones are not.

    Raises:
        MechSearchError: If the folder is missing, is no folder, or holds no or two of an object.
    """
    folder = Path(folder)
    if not folder.is_dir():
        state = "is not a folder" if folder.exists() else "does not exist"
        raise MechSearchError(f"the object folder {folder} {state}; {_LAYOUTS}")
    scans = [(path.parent.parent, path) for path in folder.glob(f"*/{SCAN.as_posix()}")]
    loose = [
        (path.with_suffix(""), path)
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES and path.is_file()
    ]
    found: dict[str, Path] = {}
    for place, path in sorted(scans or loose):
        if place.name.startswith("."):
            continue
        name = _composed(place.name)
        other = found.setdefault(name, path)
        if other != path:
            raise MechSearchError(
                f"{other.relative_to(folder)} and {path.relative_to(folder)} in {folder} name the "
                f"same object {name!r}; expected one mesh for each"
            )
    if not found:
        raise MechSearchError(f"the object folder {folder} holds no objects; {_LAYOUTS}")
    return dict(sorted(found.items()))


class MassRow(NamedTuple):
    """One row of a table of masses: [kg], free text if there is any, and its line."""

    mass: float
    category: str
    line: int


def ycb_masses() -> dict[str, MassRow]:
    """Return the published masses of YCB objects (Calli et al., 2015), by object name."""
    return read_masses(Path(__file__).with_name("ycb") / "masses.csv")


def read_masses(path: str | Path) -> dict[str, MassRow]:
    """Return the rows of a table with columns object, mass_kg and, optionally, category, by object.

    Cells are apart by commas, semicolons or tabs; only the first excludes decimal commas.

    Raises:
        MechSearchError: If the table cannot be read or lacks a column; or for all bad rows
            together: with cells too many, no object, one that had a row before, or a mass that is
            not a positive number.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        comma = max(",;\t", key=next(filter(str.strip, lines), "").count)
        reader = csv.reader(lines, delimiter=comma, skipinitialspace=True)
        read = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MechSearchError(f"cannot read the masses at {path}: {error}") from None
    cells = [(number, row) for number, row in read if any(row)]
    header = [cell.lower() for cell in cells[0][1]] if cells else []
    if not {"object", "mass_kg"} <= set(header):
        raise MechSearchError(
            f"{path} has the columns {', '.join(header or ['(none)'])}; expected "
            "object,mass_kg and, if wanted, category"
        )
    masses: dict[str, MassRow] = {}
    faults = []
    for number, row in cells[1:]:
        values = dict(zip(header, row, strict=False))
        name, mass = _composed(values.get("object", "")), values.get("mass_kg", "")
        category = values.get("category", "")
        try:
            halves = comma == "," and mass.isdecimal() and category.isdecimal()
            if any(row[len(header) :]) or halves:
                hint = "; is it for a decimal comma? write 1.35 for 1,35" if comma == "," else ""
                raise ValueError(
                    f"{len(row)} cells, {', '.join(row)}; expected {len(header)}{hint}"
                )
            if not name:
                raise ValueError("no object")
            if name in masses:
                raise ValueError(f"{name!r} again, after line {masses[name].line}")
            kilograms = _positive(mass if comma == "," else mass.replace(",", "."), name)
            masses[name] = MassRow(kilograms, category, number)
        except ValueError as error:
            faults.append(f"line {number}: {error}")
    if faults:
        raise MechSearchError(f"{path} has bad rows: {'; '.join(faults)}")
    return masses


def _of_meshes(
    rows: Mapping[str, MassRow], meshes: Mapping[str, Path], table: Path
) -> dict[str, MassRow]:
    """Return rows by the names of the meshes, and warn of those that no mesh has."""
    found = {name: rows[name] for name in meshes if name in rows}
    free = {name.casefold(): name for name in rows if name not in found}
    for name in meshes:
        if name not in found and name.casefold() in free:
            found[name] = rows[free.pop(name.casefold())]
    if free and parent_process() is None:  # Workers load the set again.
        named = ", ".join(f"{name} (line {rows[name].line})" for name in free.values())
        warnings.warn(f"{table} has rows without a mesh: {named}", stacklevel=3)
    return found


def _composed(name: str) -> str:
    """Return a name with each accented letter as one character; some systems keep two."""
    return unicodedata.normalize("NFC", name)


def _positive(text: str, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not (math.isfinite(value) and value > 0):
        raise ValueError(
            f"the mass of {name!r} is {text!r}; expected a positive number of kilograms"
        )
    return value
