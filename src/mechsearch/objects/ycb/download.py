"""Pull the YCB objects (Calli et al., 2015) from their official site."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from mechsearch.objects.ycb.scan_archive import FOLDER, ArchiveError, unpack_scan
from mechsearch.objects.ycb.transfer import NotServed, Patience, TransferError, discard, fetch
from mechsearch.types import MechSearchError

OFFICIAL = "https://ycb-benchmarks.s3.amazonaws.com/data"
PARTIAL = ".partial"
"""Folder, beside the objects, of what is not yet whole."""

ARCHIVE_TRIES = 3


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
    destination: Path,
    base_url: str = OFFICIAL,
    names: Sequence[str] | None = None,
    progress: bool = True,
    patience: Patience | None = None,
) -> Pulled:
    """Download YCB scans into `destination/NNN_name/google_16k`; a second call goes on.

    Args:
        destination: Folder of all objects.
        base_url: Site that serves `objects.json` and `google/NNN_name_google_16k.tgz`.
        names: Objects to pull; all that the site lists by default.
        progress: Whether to draw a progress bar.
        patience: Tries and waits.

    Raises:
        MechSearchError: If the site cannot be reached or serves damaged files (says how to go on
            by hand), a name is not one of the site's, or the folder cannot be written.
    """
    site = base_url.rstrip("/")
    if not site.startswith(("https://", "http://")):
        raise MechSearchError(f"the site {base_url!r} is no web address; expected https://...")
    done: dict[str, list[str]] = {"fetched": [], "present": [], "without_scan": []}
    try:
        (destination / PARTIAL).mkdir(parents=True, exist_ok=True)
        with _bar(progress) as bar:
            pull = _Pull(site, destination, patience or Patience(), bar)
            wanted = pull.wanted(names)
            for index, name in enumerate(wanted, start=1):
                done[pull.one(name, f"{name} ({index}/{len(wanted)})")].append(name)
    except OSError as error:
        raise MechSearchError(f"cannot write to {destination}: {error}") from None
    return Pulled(*(tuple(done[kind]) for kind in ("fetched", "present", "without_scan")))


@dataclass(frozen=True)
class _Pull:
    """One call of `pull_ycb`."""

    site: str
    destination: Path
    patience: Patience
    bar: Progress

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
        url, partial = f"{self.site}/objects.json", self.destination / PARTIAL / "objects.json"
        discard(partial)
        try:
            fetch(url, partial, self.patience)
            names = json.loads(partial.read_text(encoding="utf-8"))["objects"]
            return [name for name in map(str, names) if re.fullmatch(r"\w[\w-]*", name)]
        except (NotServed, TransferError, ValueError, KeyError, TypeError) as error:
            raise MechSearchError(
                f"cannot read the list of YCB objects at {url} ({error}). {self.by_hand()}"
            ) from None
        finally:
            discard(partial)

    def has(self, name: str) -> bool:
        """Tell whether the scan of an object is there."""
        return (self.destination / name / FOLDER / "textured.obj").is_file()

    def one(self, name: str, title: str) -> str:
        """Pull one object; return "fetched", "present" or "without_scan"."""
        if self.has(name):
            return "present"
        url = f"{self.site}/google/{name}_{FOLDER}.tgz"
        partial = self.destination / PARTIAL / f"{name}.tgz"
        task = self.bar.add_task(title, total=None)
        try:
            self.fetch_and_unpack(url, partial, name, task)
        except NotServed:
            return "without_scan"
        except (TransferError, ArchiveError) as error:
            raise MechSearchError(f"{error}. {self.by_hand(url)}") from None
        finally:
            self.bar.remove_task(task)
        return "fetched"

    def fetch_and_unpack(self, url: str, partial: Path, name: str, task: TaskID) -> None:
        """Fetch an archive and unpack it; one that is damaged is fetched again."""
        for left in reversed(range(ARCHIVE_TRIES)):
            fetch(
                url,
                partial,
                self.patience,
                lambda have, total: self.bar.update(task, completed=have, total=total),
            )
            try:
                unpack_scan(partial, name, self.destination)
                return
            except ArchiveError:
                if not left:
                    raise
            finally:
                discard(partial)

    def by_hand(self, url: str = "") -> str:
        """Return what to do where the site cannot be reached."""
        what = url or f"{self.site}/google/NNN_name_{FOLDER}.tgz for each object you want"
        return (
            "Pull again later to go on from here, or by hand, on any machine with a network: "
            f"download {what}, and unpack it in {self.destination}, so that "
            f"{self.destination / 'NNN_name' / FOLDER / 'textured.obj'} exists"
        )


def _bar(shown: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not shown,
    )
