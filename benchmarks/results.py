"""Figures on disk: `results.json`, and the table in the documentation."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mechsearch.files import write_whole

_BEGIN = "<!-- written by `make bench`: begin -->"
_END = "<!-- written by `make bench`: end -->"


@dataclass(frozen=True)
class Figure:
    """What one measurement found.

    Attributes:
        name: Of the figure.
        value: Ours.
        unit: Of both values.
        peer: What it is compared with, if anything.
        peer_value: The peer's.
        better: "less" or "more": the ratio says how many times better ours is; "neither": there is
            no ratio.
        note: What else to know about how it was measured.
    """

    name: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None
    better: str = "less"
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times better ours is than the peer's."""
        if not self.peer_value or not self.value or self.better == "neither":
            return None
        return (
            self.peer_value / self.value if self.better == "less" else self.value / self.peer_value
        )


@dataclass(frozen=True)
class Row:
    """One entry of `results.json`.

    Attributes:
        name: Of the figure.
        value: Ours.
        unit: Of both values.
        peer: What it is compared with, if anything.
        peer_value: The peer's.
        ratio: How many times better ours is.
        machine: Where it was measured.
        command: What measured it.
    """

    name: str
    value: float
    unit: str
    peer: str | None
    peer_value: float | None
    ratio: float | None
    machine: str
    command: str


def row_of(figure: Figure, machine: str, command: str) -> Row:
    """Return the entry of a figure."""
    return Row(
        figure.name,
        _rounded(figure.value),
        figure.unit,
        figure.peer,
        None if figure.peer_value is None else _rounded(figure.peer_value),
        None if figure.ratio is None else _rounded(figure.ratio),
        machine,
        f"{command} ({figure.note})" if figure.note else command,
    )


def read(path: Path) -> list[Row]:
    """Return all entries of a file, none if there is no file."""
    if not path.is_file():
        return []
    return [Row(**entry) for entry in json.loads(path.read_text())]


def merge(path: Path, rows: Iterable[Row], order: Sequence[str]) -> list[Row]:
    """Replace the entries of the same names, keep the others, write and return all.

    Args:
        path: Of the file.
        rows: New entries.
        order: Beginnings of names, in the order of the file.
    """
    entries = {row.name: row for row in read(path)} | {row.name: row for row in rows}
    merged = sorted(entries.values(), key=lambda row: _place(row.name, order))
    text = json.dumps([asdict(row) for row in merged], indent=1) + "\n"
    write_whole(path, lambda partial: partial.write_text(text))
    return merged


def to_markdown(rows: Sequence[Row]) -> str:
    """Return a table for readers, and below it where it was measured."""
    lines = ["| name | value | peer | its value | ratio |", "|---|---|---|---|---|"]
    for row in rows:
        peer_value = "" if row.peer_value is None else f"{row.peer_value:.3g} {row.unit}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        value = f"{row.value:.3g} {row.unit}"
        if "extrapolated" in row.command:
            value += ", extrapolated"
        lines.append(f"| `{row.name}` | {value} | {row.peer or ''} | {peer_value} | {ratio} |")
    machines = list(dict.fromkeys(row.machine for row in rows))
    return "\n".join([*lines, "", *(f"Measured on: {machine}." for machine in machines)])


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Put the table between the marks of a page; the rest of the page stays as it is."""
    page = path.read_text()
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise SystemExit(f"{path.name} lacks the marks between which the table belongs")
    text = f"{before}{_BEGIN}\n\n{to_markdown(rows)}\n\n{_END}{after}"
    write_whole(path, lambda partial: partial.write_text(text))


def _place(name: str, order: Sequence[str]) -> tuple[int, tuple[str, ...]]:
    fitting = [i for i, start in enumerate(order) if name.startswith(start)]
    return (fitting[0] if fitting else len(order)), tuple(
        part.zfill(6) if part.isdigit() else part for part in name.split("-")
    )


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
