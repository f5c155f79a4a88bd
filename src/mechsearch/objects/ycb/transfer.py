"""Fetch one file over HTTP: resume where it was cut, retry, verify length and checksum."""

import hashlib
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from mechsearch.types import MechSearchError

CHUNK = 1 << 16


class NotServed(Exception):  # noqa: N818 (an answer, not an error)
    """The server has no such file (HTTP 403, 404 or 410)."""


class TransferError(MechSearchError):
    """The file could not be had whole after all tries."""


class _Cut(Exception):  # noqa: N818
    """The transfer stopped early and may be tried again."""


@dataclass(frozen=True)
class Patience:
    """How long to try.

    Attributes:
        tries: Tries in a row that bring no new byte before giving up.
        wait: Pause before the second of them [s]; doubled for each further one.
        timeout: Longest silence of the server [s].
    """

    tries: int = 5
    wait: float = 1.0
    timeout: float = 30.0


def fetch(
    url: str, partial: Path, patience: Patience, advance: Callable[[int], None] = lambda have: None
) -> None:
    """Fetch `url` into `partial`, going on from what an earlier call left there.

    The bytes are those the server announced: their number, and their MD5 where the ETag is one.

    Args:
        url: What to fetch.
        partial: Where it grows; its validator is kept beside it, ending in .etag.
        patience: Tries and waits.
        advance: Called with the bytes had.

    Raises:
        NotServed: If the server has no such file.
        TransferError: If all tries failed.
    """
    fruitless = 0
    while True:
        before = _size(partial)
        try:
            _attempt(url, partial, patience.timeout, advance)
            return
        except _Cut as cut:
            fruitless = 0 if _size(partial) > before else fruitless + 1
            if fruitless >= patience.tries:
                raise TransferError(f"cannot fetch {url}: {cut} ({patience.tries} tries)") from None
            time.sleep(patience.wait * 2 ** max(fruitless - 1, 0))


def _attempt(url: str, partial: Path, timeout: float, advance: Callable[[int], None]) -> None:
    with _open(url, partial, timeout) as response:
        start = _start(response, partial)
        length = response.headers.get("Content-Length", "")
        total = start + int(length) if length.isdigit() else None
        etag = response.headers.get("ETag", "")
        _note(partial).write_text(_validator(response), encoding="utf-8")
        with partial.open("r+b" if start else "wb") as file:
            file.truncate(start)
            file.seek(start)
            for chunk in _chunks(response):
                file.write(chunk)
                advance(file.tell())
    _verify(partial, total, etag)


def _open(url: str, partial: Path, timeout: float) -> HTTPResponse:
    request = Request(url, headers={"User-Agent": "mechsearch"})
    have, validator = _size(partial), _noted(partial)
    if have and validator:
        request.add_header("Range", f"bytes={have}-")
        request.add_header("If-Range", validator)
    try:
        response: HTTPResponse = urlopen(request, timeout=timeout)
        return response
    except HTTPError as error:
        error.close()
        if error.code == 416:
            discard(partial)
        elif error.code in (403, 404, 410):
            raise NotServed(url) from None
        elif error.code < 500 and error.code not in (408, 429):
            raise TransferError(f"cannot fetch {url}: HTTP {error.code} {error.reason}") from None
        raise _Cut(f"HTTP {error.code} {error.reason}") from None
    except (OSError, HTTPException) as error:
        raise _Cut(str(getattr(error, "reason", error)) or type(error).__name__) from None


def _start(response: HTTPResponse, partial: Path) -> int:
    """Return the offset of the first byte of the answer: 0 unless it continues our file."""
    if response.status != 206:
        return 0
    begin = re.match(r"bytes (\d+)-", response.headers.get("Content-Range", ""))
    have = _size(partial)
    if not begin or int(begin[1]) != have or _validator(response) != _noted(partial):
        discard(partial)
        raise _Cut("the server continued another file")
    return have


def _chunks(response: HTTPResponse) -> Iterator[bytes]:
    while True:
        try:
            chunk = response.read1(CHUNK)
        except (OSError, HTTPException) as error:
            raise _Cut(str(error) or type(error).__name__) from None
        if not chunk:
            return
        yield chunk


def _verify(partial: Path, total: int | None, etag: str) -> None:
    have = _size(partial)
    if total is not None and have < total:
        raise _Cut(f"cut after {have} of {total} bytes")
    expected = etag.strip('"')
    if re.fullmatch(r"[0-9a-f]{32}", expected):
        with partial.open("rb") as file:
            found = hashlib.file_digest(file, "md5").hexdigest()
        if found != expected:
            discard(partial)
            raise _Cut(f"the bytes differ from their checksum (MD5 {found}, not {expected})")


def _validator(response: HTTPResponse) -> str:
    """Return what tells this version of the file from others, or an empty string."""
    etag = response.headers.get("ETag", "")
    return etag if etag.startswith('"') else ""


def _note(partial: Path) -> Path:
    return partial.with_name(partial.name + ".etag")


def _noted(partial: Path) -> str:
    note = _note(partial)
    return note.read_text(encoding="utf-8") if note.exists() else ""


def _size(partial: Path) -> int:
    return partial.stat().st_size if partial.exists() else 0


def discard(partial: Path) -> None:
    """Remove a partial file and its validator."""
    partial.unlink(missing_ok=True)
    _note(partial).unlink(missing_ok=True)
