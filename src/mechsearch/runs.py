"""Files that are whole or absent, locks on them, and the layout of a run directory."""

import errno
import json
import os
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from filelock import BaseFileLock, FileLock, Timeout

from mechsearch.types import Array, MechSearchError

RECORD = 1
"""Format of the records that `write_record` writes."""

CHECK_MARK = '"check"'
"""What tells a line of JSON with a checksum from one that an earlier version wrote."""

_ADVICE = {
    "free some space": (errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
    "choose a place that you may write to": (errno.EACCES, errno.EPERM, errno.EROFS),
    "choose a place where nothing of that name is in the way": (
        *(errno.ENOTDIR, errno.EISDIR, errno.EEXIST),
    ),
}
_REMEDIES = {number: advice for advice, numbers in _ADVICE.items() for number in numbers}
REFUSALS = frozenset(_REMEDIES)
"""Error numbers with which the system refuses to write."""


class NotWrittenError(MechSearchError):
    """A file could not be written: the disk is full, or the place is not to be written to."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Say what could not be written, and what to do, if the system refuses it inside.

    Raises:
        NotWrittenError: If it does.
    """
    try:
        yield
    except OSError as error:
        raise not_written(error, path) from error


def not_written(error: OSError, path: Path) -> NotWrittenError:
    """Return what to say where the system refused to write a file."""
    advice = _REMEDIES.get(error.errno or 0, "see to it")
    return NotWrittenError(
        f"cannot write {path}: {error.strerror or error}; {advice}, and give the same command "
        "again; files already written are whole"
    )


def check_place(path: Path) -> None:
    """Refuse a file that cannot be written, before hours of work for it.

    Raises:
        NotWrittenError: If its folder is not to be written to.
    """
    folder = path.parent
    while not folder.exists():
        folder = folder.parent
    with naming(path):
        with tempfile.TemporaryFile(dir=folder):
            pass
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a file beside `path`, then rename it: no reader sees half of it.

    Raises:
        NotWrittenError: If the disk is full, or the place is not to be written to.
    """
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.stem}.", suffix=".partial" + path.suffix
        )
        os.close(handle)
        partial = Path(name)
        try:
            write(partial)
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            partial.chmod(0o644)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text, whole or not at all."""

    def write(partial: Path) -> None:
        partial.write_text(text, encoding="utf-8")

    write_whole(path, write)


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


def read_arrays(path: Path, purpose: str) -> dict[str, Array]:
    """Read the arrays of an `.npz`, their checksums first; nothing in the file is ever run.

    Raises:
        MechSearchError: If the file is missing or damaged; `purpose` names what it should hold.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
        if damaged:
            raise zipfile.BadZipFile(f"{damaged} does not match its checksum")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise MechSearchError(f"no {purpose} at {path}") from None
    except ARRAY_DAMAGE as error:
        raise MechSearchError(f"{path} is damaged or no {purpose}: {error}") from None


ARRAY_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, OSError, EOFError, RuntimeError),
    *(ValueError, KeyError, TypeError, IndexError, SyntaxError, tokenize.TokenError),
)
"""What a flipped bit may raise in the reader of archives and arrays."""


def _check(record: Mapping[str, Any]) -> str:
    return f"{crc32(json.dumps(record, sort_keys=True).encode()):08x}"


@contextmanager
def locked(path: Path, wait: bool = True) -> Iterator[bool]:
    """Keep other processes from what is at `path` while inside.

    The lock is the operating system's: it ends with the process that holds it, however that ends.
    The file beside `path` that carries it stays.

    Args:
        path: What is locked; it need not exist.
        wait: Whether to wait for another holder.

    Yields:
        Whether the lock is held; False only without waiting.
    """
    lock = FileLock(path.with_name(f".{path.name}.lock"))
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        held = _acquired(lock, wait)
    try:
        yield held
    finally:
        lock.release()


def _acquired(lock: BaseFileLock, wait: bool) -> bool:
    try:
        lock.acquire(timeout=-1 if wait else 0)
    except Timeout:
        return False
    return True


@contextmanager
def alone(path: Path, what: str) -> Iterator[None]:
    """Be the only process at `path` while inside; see `locked`.

    Args:
        path: What is worked at.
        what: Name of the place, for whoever comes second.

    Raises:
        MechSearchError: If another process is at it.
    """
    with locked(path, wait=False) as free:
        if not free:
            raise MechSearchError(
                f"another process is at work in {what}; wait for its end, or stop it"
            )
        yield


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


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of a file of JSON lines; a last line that a kill has torn is left out.

    Earlier versions wrote no checksums; a file has them in all of its lines or in none.

    Raises:
        MechSearchError: If another line is damaged.
    """
    if not path.exists():
        return
    checked: bool | None = None
    with path.open("rb") as file:
        for number, raw in enumerate(file, start=1):
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
