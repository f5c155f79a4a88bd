"""Masses of objects: tables of comma-separated values."""

import csv
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Entry:
    """One row of a table of masses.

    Attributes:
        mass: [kg].
        category: Free text.
    """

    mass: float
    category: str


def read_masses(path: Path) -> dict[str, Entry]:
    """Return the rows of a table with columns object, mass_kg and, optionally, category.

    Raises:
        MechSearchError: If the table cannot be read, lacks a column or has a mass that is not a
            positive number.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise MechSearchError(f"cannot read the masses at {path}: {error}") from None
    return _parse(text, str(path))


def ycb_masses() -> dict[str, Entry]:
    """Return the published masses of YCB objects (Calli et al., 2015), by object name."""
    table = files("mechsearch.objects").joinpath("ycb_masses.csv")
    return _parse(table.read_text(encoding="utf-8"), "ycb_masses.csv")


def _parse(text: str, origin: str) -> dict[str, Entry]:
    rows = csv.DictReader(text.splitlines(), skipinitialspace=True)
    if not {"object", "mass_kg"} <= set(rows.fieldnames or ()):
        raise MechSearchError(
            f"{origin} has the columns {', '.join(rows.fieldnames or ['(none)'])}; expected "
            "object,mass_kg and, if wanted, category"
        )
    entries: dict[str, Entry] = {}
    for row in rows:
        name = (row["object"] or "").strip()
        entries[name] = Entry(
            _positive(row["mass_kg"], f"the mass of {name!r} in {origin}"),
            (row.get("category") or "object").strip(),
        )
    return entries


def _positive(text: str | None, what: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not (np.isfinite(value) and value > 0):
        raise MechSearchError(f"{what} is {text!r}; expected a positive number of kilograms")
    return value
