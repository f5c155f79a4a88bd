"""Pull the YCB objects (Calli et al., 2015) from their official site.

Every archive is checked first; then its scan is there whole or not at all.
"""

import gzip
import json
import re
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from mechsearch.objects.ycb.transfer import NotServed, Patience, TransferError, discard, fetch
from mechsearch.processes import Progress, silent
from mechsearch.types import MechSearchError

FOLDER = "google_16k"
SCAN = Path(FOLDER, "textured.obj")
"""Where the official download keeps the mesh of an object."""

OFFICIAL = "https://ycb-benchmarks.s3.amazonaws.com/data"
PARTIAL = ".partial"
"""Folder, beside the objects, of what is not yet whole."""

ARCHIVE_TRIES = 3

LARGEST = 1 << 30
"""Most bytes of one unpacked scan."""


class ArchiveError(MechSearchError):
    """The archive is cut, altered or not what it should be."""


@dataclass(frozen=True)
class Pulled:
    """What a pull did.

    Attributes:
        fetched: Objects that were downloaded.
        present: Objects that were there already.
        without_scan: Objects for which the site has no google_16k scan.
    """

    fetched: tuple[str, ...]
    present: tuple[str, ...]
    without_scan: tuple[str, ...]


def pull_ycb(
    destination: str | Path,
    base_url: str = OFFICIAL,
    names: Sequence[str] | None = None,
    progress: Progress = silent,
    patience: Patience | None = None,
) -> Pulled:
    """Download YCB scans into `destination/NNN_name/google_16k`; a second call goes on.

    Args:
        destination: Folder of all objects.
        base_url: Site that serves `objects.json` and `google/NNN_name_google_16k.tgz`.
        names: Objects to pull; all that the site lists by default.
        progress: Told of every object, and of its bytes as they come.
        patience: Tries and waits.

    Raises:
        MechSearchError: If the site cannot be reached or serves damaged files (says how to go on
            by hand), a name is not one of the site's, or the folder cannot be written.
    """
    destination, site = Path(destination), base_url.rstrip("/")
    if not site.startswith(("https://", "http://")):
        raise MechSearchError(f"the site {base_url!r} is no web address; expected https://...")
    done: dict[str, list[str]] = {"fetched": [], "present": [], "without_scan": []}
    try:
        (destination / PARTIAL).mkdir(parents=True, exist_ok=True)
        pull = _Pull(site, destination, patience or Patience())
        wanted = pull.wanted(names)
        for index, name in enumerate(wanted):
            advance = partial(_tell, progress, name, index, len(wanted))
            done[pull.one(name, advance)].append(name)
            progress("downloading", index + 1, len(wanted))
    except OSError as error:
        raise MechSearchError(f"cannot write to {destination}: {error}") from None
    return Pulled(*(tuple(done[kind]) for kind in ("fetched", "present", "without_scan")))


def _tell(progress: Progress, name: str, index: int, total: int, have: int) -> None:
    progress(f"downloading, {name} {have >> 20} MiB", index, total)


@dataclass(frozen=True)
class _Pull:
    """One call of `pull_ycb`."""

    site: str
    destination: Path
    patience: Patience

    def wanted(self, names: Sequence[str] | None) -> list[str]:
        """Return the objects to pull; names that the site does not list are refused."""
        if names is not None and all(self.has(name) for name in names):
            return list(names)
        listed = self.listing()
        unknown = [name for name in names or () if name not in listed]
        if unknown:
            raise MechSearchError(
                f"no YCB object {', '.join(map(repr, unknown))}; choose from {', '.join(listed)}"
            )
        return listed if names is None else list(names)

    def listing(self) -> list[str]:
        """Return the names of all objects on the site."""
        url, listed = f"{self.site}/objects.json", self.destination / PARTIAL / "objects.json"
        discard(listed)
        try:
            fetch(url, listed, self.patience)
            names = json.loads(listed.read_text(encoding="utf-8"))["objects"]
            return [name for name in map(str, names) if re.fullmatch(r"\w[\w-]*", name)]
        except (NotServed, TransferError, ValueError, KeyError, TypeError) as error:
            raise MechSearchError(
                f"cannot read the list of YCB objects at {url} ({error}). {self.by_hand()}"
            ) from None
        finally:
            discard(listed)

    def has(self, name: str) -> bool:
        """Tell whether the scan of an object is there."""
        return (self.destination / name / SCAN).is_file()

    def one(self, name: str, advance: Callable[[int], None]) -> str:
        """Pull one object; return "fetched", "present" or "without_scan"."""
        if self.has(name):
            return "present"
        url = f"{self.site}/google/{name}_{FOLDER}.tgz"
        try:
            self.fetch_and_unpack(url, name, advance)
        except NotServed:
            return "without_scan"
        except (TransferError, ArchiveError) as error:
            raise MechSearchError(f"{error}. {self.by_hand(url)}") from None
        return "fetched"

    def fetch_and_unpack(self, url: str, name: str, advance: Callable[[int], None]) -> None:
        """Fetch an archive and unpack it; one that is damaged is fetched again."""
        archive = self.destination / PARTIAL / f"{name}.tgz"
        for left in reversed(range(ARCHIVE_TRIES)):
            fetch(url, archive, self.patience, advance)
            try:
                unpack_scan(archive, name, self.destination)
                return
            except ArchiveError:
                if not left:
                    raise
            finally:
                discard(archive)

    def by_hand(self, url: str = "") -> str:
        """Return what to do where the site cannot be reached."""
        what = url or f"{self.site}/google/NNN_name_{FOLDER}.tgz for each object you want"
        return (
            "Pull again later to go on from here, or by hand, on any machine with a network: "
            f"download {what}, and unpack it in {self.destination}, so that "
            f"{self.destination / 'NNN_name' / SCAN} exists"
        )


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
            with gzip.open(archive) as stream:  # To its end, where length and CRC are compared.
                while stream.read(1 << 20):
                    pass
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
