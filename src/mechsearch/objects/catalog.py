"""Object sets by name, or from any folder of meshes with masses."""

import csv
import math
from pathlib import Path
from typing import NamedTuple

from mechsearch.files import cache_folder
from mechsearch.objects.household.object_set import household
from mechsearch.objects.meshes.cache import prepare_all
from mechsearch.objects.meshes.prepare import SUFFIXES, Source
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
    if not folder.exists():
        raise MechSearchError(
            f"no object set {str(spec)!r}; choose household, ycb, or a folder of meshes with masses"
        )
    return load_folder(folder, workers=workers)


def ycb_folder() -> Path:
    """Return where downloaded YCB objects are kept."""
    return cache_folder() / "ycb"


def load_folder(
    folder: Path, name: str | None = None, workers: int | None = None, need_masses: bool = True
) -> ObjectSet:
    """Return the set of all objects in a folder, prepared or from the cache.

    Two layouts are known: the official YCB download, and mesh files side by side. Masses come
    from a `masses.csv` in the folder or, for YCB objects, from the published table.

    Args:
        folder: Where the meshes are.
        name: Of the set; the folder's own by default.
        workers: Processes that prepare objects; as many as there are processors by default.
        need_masses: Whether an object without a mass is an error; else it is left out.

    Raises:
        MechSearchError: If the folder is missing, has no objects, lacks masses, has a mesh that
            cannot be read, or no object in it can lie in a heap.
    """
    meshes = find_meshes(folder)
    table = folder / "masses.csv"
    masses = {**ycb_masses(), **(read_masses(table) if table.exists() else {})}
    missing = [item for item in meshes if item not in masses]
    if missing and need_masses:
        raise MechSearchError(
            f"no mass for {', '.join(missing)} of {folder}; expected a row object,mass_kg for each "
            f"in {table}"
        )
    excluded = dict.fromkeys(missing, "no published mass")
    sources = [
        Source(item, masses[item].category, mesh, masses[item].mass)
        for item, mesh in meshes.items()
        if item in masses
    ]
    with bars() as progress:
        prepared = prepare_all(sources, workers, progress)
    models = {}
    for source, done in zip(sources, prepared, strict=True):
        if done.excluded:
            excluded[source.name] = done.excluded
        else:
            models[source.name] = done.model
    if not models:
        reasons = "; ".join(f"{item}: {why}" for item, why in list(excluded.items())[:5])
        raise MechSearchError(f"no object of {folder} can lie in a heap ({reasons})")
    return ObjectSet(name or folder.resolve().name, models, dict(sorted(excluded.items())))


def find_meshes(folder: Path) -> dict[str, Path]:
    """Return the mesh file of each object in a folder, sorted by object name.

    Raises:
        MechSearchError: If the folder is missing, is no folder, or holds no or two of an object.
    """
    if not folder.is_dir():
        state = "is not a folder" if folder.exists() else "does not exist"
        raise MechSearchError(f"the object folder {folder} {state}; {_LAYOUTS}")
    scans = {path.parent.parent.name: path for path in folder.glob(f"*/{SCAN.as_posix()}")}
    if scans:
        return dict(sorted(scans.items()))
    meshes = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    if not meshes:
        raise MechSearchError(f"the object folder {folder} holds no objects; {_LAYOUTS}")
    found: dict[str, Path] = {}
    for path in sorted(meshes):
        other = found.setdefault(path.stem, path)
        if other != path:
            raise MechSearchError(
                f"{other.name} and {path.name} in {folder} name the same object {path.stem!r}; "
                "expected one mesh for each"
            )
    return dict(sorted(found.items()))


class MassRow(NamedTuple):
    """One row of a table of masses: [kg], and free text."""

    mass: float
    category: str


def ycb_masses() -> dict[str, MassRow]:
    """Return the published masses of YCB objects (Calli et al., 2015), by object name."""
    return read_masses(Path(__file__).with_name("ycb") / "masses.csv")


def read_masses(path: Path) -> dict[str, MassRow]:
    """Return the rows of a table with columns object, mass_kg and, optionally, category.

    Raises:
        MechSearchError: If the table cannot be read, lacks a column or has a mass that is not a
            positive number.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise MechSearchError(f"cannot read the masses at {path}: {error}") from None
    rows = csv.DictReader(text.splitlines(), skipinitialspace=True)
    if not {"object", "mass_kg"} <= set(rows.fieldnames or ()):
        raise MechSearchError(
            f"{path} has the columns {', '.join(rows.fieldnames or ['(none)'])}; expected "
            "object,mass_kg and, if wanted, category"
        )
    masses: dict[str, MassRow] = {}
    for row in rows:
        name = (row["object"] or "").strip()
        mass = _positive(row["mass_kg"], f"the mass of {name!r} in {path}")
        masses[name] = MassRow(mass, (row.get("category") or "object").strip())
    return masses


def _positive(text: str | None, what: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not (math.isfinite(value) and value > 0):
        raise MechSearchError(f"{what} is {text!r}; expected a positive number of kilograms")
    return value
