"""Files that are whole or absent, locks on them, and the layout of a run directory."""

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from mechsearch.types import MechSearchError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a file beside `path`, then rename it: no reader sees half of it."""
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
    text = json.dumps(value, indent=2, sort_keys=True) + "\n"
    write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def read_json(path: Path, purpose: str) -> Any:
    """Read JSON.

    Raises:
        MechSearchError: If the file is missing or not JSON; `purpose` names what it should hold.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise MechSearchError(f"no {purpose} at {path}") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MechSearchError(f"the {purpose} at {path} is damaged: {error}") from None


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
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path.with_name(f".{path.name}.lock"))
    try:
        lock.acquire(timeout=-1 if wait else 0)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def append_line(path: Path, record: dict[str, Any]) -> None:
    """Append one record to a file of JSON lines."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record) + "\n")


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of a file of JSON lines; a torn last line is left out."""
    if not path.exists():
        return
    with path.open(encoding="utf-8") as file:
        for line in file:
            if line.endswith("\n"):
                yield json.loads(line)
