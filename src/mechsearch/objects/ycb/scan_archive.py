"""Unpack the archive of one YCB scan: checked first, then there whole or not at all."""

import gzip
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from mechsearch.types import MechSearchError

FOLDER = "google_16k"
LARGEST = 1 << 30
"""Most bytes of one unpacked scan."""


class ArchiveError(MechSearchError):
    """The archive is cut, altered or not what it should be."""


def unpack_scan(archive: Path, name: str, destination: Path) -> None:
    """Unpack `NAME/google_16k` of an archive to `destination/NAME/google_16k`.

    It is unpacked beside that place and renamed, so no reader sees half a scan.

    Args:
        archive: A .tgz file.
        name: Of the object.
        destination: Folder of all objects.

    Raises:
        ArchiveError: If the archive is damaged, holds links or paths that leave its folder, or
            lacks the scan.
        MechSearchError: If an incomplete scan is in the way.
    """
    target = destination / name / FOLDER
    with tempfile.TemporaryDirectory(dir=archive.parent, prefix=f"{name}.") as beside:
        try:
            _read_through(archive)
            with tarfile.open(archive, "r:gz") as tar:
                for member in _checked(tar, archive, name):
                    tar.extract(member, beside, filter="data")
        except (tarfile.TarError, zlib.error, EOFError, gzip.BadGzipFile) as error:
            raise ArchiveError(f"the archive {archive.name} is damaged: {error}") from None
        scan = Path(beside, name, FOLDER)
        if not (scan / "textured.obj").is_file():
            raise ArchiveError(f"the archive {archive.name} has no {name}/{FOLDER}/textured.obj")
        if target.exists():
            raise MechSearchError(f"{target} is incomplete; remove it and pull again")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(scan, target)


def _read_through(archive: Path) -> None:
    """Read a gzip stream to its end, where its length and CRC are compared."""
    with gzip.open(archive) as stream:
        while stream.read(1 << 20):
            pass


def _checked(tar: tarfile.TarFile, archive: Path, name: str) -> Iterator[tarfile.TarInfo]:
    """Yield the members to unpack, after a look at every one before it."""
    size = 0
    for member in tar:
        path = PurePosixPath(member.name)
        if path.is_absolute() or ".." in path.parts or "\\" in member.name:
            raise ArchiveError(f"{archive.name} holds the path {member.name!r}, which leaves it")
        if not (member.isfile() or member.isdir()):
            raise ArchiveError(f"{archive.name} holds {member.name!r}, which is no plain file")
        size += member.size
        if size > LARGEST:
            raise ArchiveError(f"{archive.name} unpacks to more than {LARGEST >> 20} MiB")
        if path.parts[:2] == (name, FOLDER):
            yield member
