"""JSON that this package reads back: checked records, lines, and frozen dataclasses."""

import io
import json
import lzma
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args, get_origin, get_type_hints
from zlib import crc32

from mechsearch.files.whole import naming, write_text
from mechsearch.types import MechSearchError, shown

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Record = TypeVar("Record", bound=DataclassInstance)
else:
    Record = TypeVar("Record")

RECORD = 1
"""Format of the records that `write_record` writes."""

CHECK_MARK = '"check"'
"""What tells a line of JSON with a checksum from one that an earlier version wrote."""

PACKED_SUFFIX = ".xz"
"""What `xz` adds to the name of a file that it packs."""


def write_json(path: Path, value: Any) -> None:
    """Write JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True) + "\n")


def read_json(path: Path, purpose: str) -> Any:
    """Read JSON.

    Raises:
        MechSearchError: If the file is missing or not JSON; `purpose` names what it should hold.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise MechSearchError(f"no {purpose} at {path}") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MechSearchError(f"the {purpose} at {path} is damaged: {error}") from None


def write_record(path: Path, purpose: str, record: Mapping[str, Any]) -> None:
    """Write what only this package reads back: JSON with a checksum, whole or not at all.

    Args:
        path: The file.
        purpose: What it is, in the words that `read_record` is given.
        record: What to keep.
    """
    numbered = {**record, "kind": purpose, "record": RECORD}
    write_json(path, {**numbered, "check": _check(numbered)})


def read_record(path: Path, purpose: str, needed: Sequence[str] = ()) -> dict[str, Any]:
    """Read what `write_record` wrote, or what earlier versions did without a checksum.

    Args:
        path: The file.
        purpose: What it should hold, for errors.
        needed: Names without which it is something else.

    Raises:
        MechSearchError: If the file is missing, damaged, changed, foreign, or of a later version.
    """
    content = read_json(path, purpose)
    if not isinstance(content, dict):
        raise MechSearchError(f"{path} is not the {purpose}: it holds a {type(content).__name__}")
    found: dict[str, Any] = content
    # Each of the two tells that the other must be there, so that neither can get lost.
    if "record" in found or "check" in found:
        found = _opened(found, path, purpose)
    missing = [name for name in needed if name not in found]
    if missing:
        raise MechSearchError(f"{path} is not the {purpose}: it lacks {', '.join(missing)}")
    return found


def _opened(found: dict[str, Any], path: Path, purpose: str) -> dict[str, Any]:
    """Return a record without what seals it."""
    check = found.pop("check", None)
    if check != _check(found):
        raise MechSearchError(
            f"the {purpose} at {path} is damaged, or was changed by hand: its checksum differs"
        )
    number, kind = found.pop("record"), found.pop("kind", purpose)
    if kind != purpose:
        raise MechSearchError(f"{path} is not the {purpose}, but a {kind}")
    if number != RECORD:
        raise MechSearchError(
            f"the {purpose} at {path} has format {number}; this version reads {RECORD}"
        )
    return found


def _check(record: Mapping[str, Any]) -> str:
    return f"{crc32(json.dumps(record, sort_keys=True).encode()):08x}"


def append_line(path: Path, record: dict[str, Any]) -> None:
    """Append one record to a file of JSON lines, with a checksum.

    Raises:
        NotWrittenError: If the disk is full, or the place is not to be written to.
    """
    with naming(path), path.open("a", encoding="utf-8") as file:
        file.write(line_of(record))


def line_of(record: Mapping[str, Any]) -> str:
    """Return a record as a line with its checksum."""
    return json.dumps({**record, "check": _check(record)}) + "\n"


def record_of(line: str) -> dict[str, Any]:
    """Return the record of a line.

    Raises:
        ValueError: If the line is no JSON object, or its checksum differs.
    """
    record = json.loads(line)
    if not isinstance(record, dict):
        raise ValueError(f"{line[:40]!r} is no record")
    if "check" in record and record.pop("check") != _check(record):
        raise ValueError("its checksum differs")
    return record


def read_content(path: Path) -> bytes | None:
    """Return what is in a file, or in what `xz` made of it where that is all that is left.

    Returns:
        None if there is neither `path` nor `path` with `.xz` behind.

    Raises:
        MechSearchError: If the packed file is damaged.
    """
    if path.exists():
        return path.read_bytes()
    packed = path.with_name(path.name + PACKED_SUFFIX)
    try:
        return lzma.decompress(packed.read_bytes()) if packed.exists() else None
    except lzma.LZMAError as error:
        raise MechSearchError(f"{packed} is damaged: {error}") from None


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of a file of JSON lines; a last line that a kill has torn is left out.

    Earlier versions wrote no checksums; a file has them in all of its lines or in none. It may be
    packed, see `read_content`; without a file there are no records.

    Raises:
        MechSearchError: If another line is damaged.
    """
    checked: bool | None = None
    for number, raw in enumerate(io.BytesIO(read_content(path) or b""), start=1):
        if not raw.endswith(b"\n"):
            return
        try:
            line = raw.decode("utf-8")
            record = record_of(line)
            if checked not in (None, CHECK_MARK in line):
                raise ValueError("its checksum is missing, or too many")
        except ValueError as error:
            raise MechSearchError(f"line {number} of {path} is damaged: {error}") from None
        checked = CHECK_MARK in line
        yield record


def differing_fields(one: object, other: object, prefix: str = "") -> list[tuple[str, Any, Any]]:
    """Return name, value and other value of each field in which two dataclasses differ.

    Of nested ones of the same kind the fields are compared, under names such as "reward.movement".
    """
    found: list[tuple[str, Any, Any]] = []
    for field in fields(cast("DataclassInstance", one)):
        name, before, now = (
            prefix + field.name,
            getattr(one, field.name),
            getattr(other, field.name),
        )
        if is_dataclass(before) and type(before) is type(now):
            found += differing_fields(before, now, f"{name}.")
        elif before != now:
            found.append((name, before, now))
    return found


def record_from_json(
    kind: type[Record], data: Mapping[str, Any], retired: Mapping[str, Any] | None = None
) -> Record:
    """Return a dataclass, nested ones included, from what `dataclasses.asdict` and JSON made.

    Args:
        kind: The dataclass.
        data: Values by field; fields left out keep their defaults.
        retired: Fields of earlier versions, anywhere in it, that may be left out again because they
            have the value that is now the only one.

    Raises:
        MechSearchError: If a field is unknown, its value of another kind, or a retired one's value
            another.
    """
    if not isinstance(data, Mapping):
        raise MechSearchError(f"a {kind.__name__} is {data!r}; expected values by field")
    hints = get_type_hints(kind)
    known = [field.name for field in fields(kind) if field.init]
    kept = dict(data)
    for name in [name for name in data if name not in known and name in (retired or {})]:
        value, only = kept.pop(name), (retired or {})[name]
        if value != only:
            raise MechSearchError(
                f"{name} is {value!r}, and this version knows {only!r} alone; go on with the "
                "version that wrote it"
            )
    unknown = [name for name in kept if name not in known]
    if unknown:
        raise MechSearchError(
            f"{kind.__name__} has no {', '.join(unknown)}; it has {', '.join(known)}"
        )
    return kind(**{name: _value(hints[name], name, kept[name], retired) for name in kept})


def _value(kind: Any, name: str, value: Any, retired: Mapping[str, Any] | None) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        return record_from_json(kind, value, retired)
    if get_origin(kind) is tuple and isinstance(value, list):
        inner = get_args(kind)[0]
        return tuple(_value(inner, name, entry, retired) for entry in value)
    _check_kind(kind, name, value)
    return value


def check_kinds(record: Any, prefix: str = "") -> None:
    """Check that each field of a dataclass, and of those in it, has a value of its kind.

    Raises:
        MechSearchError: Naming the field, its value, and what was expected.
    """
    for name, kind in _kinds(cast("Any", type(record))).items():
        value = getattr(record, name)
        _check_kind(kind, prefix + name, value)
        if is_dataclass(kind):
            check_kinds(value, f"{prefix}{name}.")


@lru_cache(maxsize=64)
def _kinds(record: Any) -> dict[str, Any]:
    hints = get_type_hints(record)
    return {field.name: hints[field.name] for field in fields(record)}


def _check_kind(kind: Any, name: str, value: Any) -> None:
    expected: Any = {int: Integral, float: Real, tuple: (tuple, list)}.get(
        get_origin(kind) or kind, get_origin(kind) or kind
    )
    # True is no number.
    if isinstance(value, bool) != (kind is bool) or not isinstance(value, expected):
        text = kind.__name__ if isinstance(kind, type) else str(kind)
        raise MechSearchError(f"{name} is {shown(value)}; expected {text}")
    if get_origin(kind) is tuple:
        for entry in value:
            _check_kind(get_args(kind)[0], name, entry)
