"""Files that are whole or absent, and locks on them."""

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from mechsearch.types import MechSearchError

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


def check_place(path: Path, formats: Sequence[str] = ()) -> None:
    """Refuse a file that cannot be written, before hours of work for it.

    Args:
        path: The file.
        formats: Suffixes of which it must have one, be it in capitals; none takes any file.

    Raises:
        MechSearchError: If its suffix is another.
        NotWrittenError: If its folder is not to be written to.
    """
    if formats and path.suffix.lower() not in formats:
        found = f"has the unknown format {path.suffix!r}" if path.suffix else "names no format"
        raise MechSearchError(f"{path} {found}; choose one of {', '.join(formats)}")
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

    The file beside it ends in the same suffix, in small letters, by which writers know formats.

    Raises:
        NotWrittenError: If the disk is full, or the place is not to be written to.
    """
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.stem}.", suffix=".partial" + path.suffix.lower()
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
    write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))


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
        with suppress(Timeout):
            lock.acquire(timeout=-1 if wait else 0)
    try:
        yield lock.is_locked
    finally:
        lock.release()


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


def write_folder(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a folder beside `path`, then rename it: no reader sees half of it.

    What a killed process has left beside it is cleared away first.

    Raises:
        MechSearchError: If there is something at `path`, or another process is at it.
        NotWrittenError: As `write_whole`.
    """
    partial = path.with_name(f".{path.name}.partial")
    with alone(path, f"the folder {path}"):
        check_absent(path)
        with naming(path):
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            try:
                write(partial)
                for file in filter(Path.is_file, partial.rglob("*")):
                    with file.open("rb") as written:
                        os.fsync(written.fileno())
                partial.rename(path)
            finally:
                shutil.rmtree(partial, ignore_errors=True)


def check_absent(path: Path) -> None:
    """Refuse a folder that is there already, before hours of work for it.

    Raises:
        MechSearchError: If there is something in it, or a file of its name.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise MechSearchError(f"{path} is there already; name a new folder, or remove it first")
