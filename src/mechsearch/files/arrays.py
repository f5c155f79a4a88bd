"""Named arrays in one file; nothing in it is ever run."""

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from mechsearch.types import Array, MechSearchError


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
