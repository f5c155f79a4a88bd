"""Prepared objects kept in the user's cache folder, by the content of what they are made from."""

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.files import cache_folder, read_arrays, write_whole
from mechsearch.objects.meshes import convex, prepare
from mechsearch.objects.meshes.prepare import Prepared, Source
from mechsearch.objects.meshes.reading import (
    READING,
    missing_files,
    read_pieces,
    source_files,
)
from mechsearch.objects.model import FLAGGED_ERROR, FRICTION, TEXEL_ROWS, ObjectModel
from mechsearch.processes import PROCESSORS, Failure, Progress, map_in_order, silent
from mechsearch.types import Array, MechSearchError, check_extra

_TEXTS = ("name", "category", "content_hash")
_SCALARS = ("mass", "friction", "hull_error")
_ARRAYS = ("vertices", "faces", "texels", "inertia")


def prepare_all(
    sources: Sequence[Source], workers: int | None = None, progress: Progress = silent
) -> list[Prepared | MechSearchError]:
    """Return every object prepared, from the cache where it holds it.

    What cannot be read or prepared is named in a warning, as are materials and textures that are
    not there.

    Args:
        sources: What to prepare.
        workers: Most processes; as many as there are processors by default.
        progress: Told after each object that no cache held.

    Returns:
        For each source the object, or why it is left out.

    Raises:
        MechSearchError: If the cache cannot be written.
    """
    found = {source: _kept(source) for source in sources}
    todo = [source for source, done in found.items() if done is None]
    if todo:
        check_extra(f"preparing {todo[0].mesh}", "meshes")
    # A worker, which loads a set again, has no workers of its own, and nobody to tell.
    first = parent_process() is None
    crew = min(workers or PROCESSORS, len(todo)) if first else 1
    # All are read before minutes are spent on one.
    for source, error in zip(todo, map_in_order(_damage, todo, crew, None, _lost), strict=True):
        found[source] = error
    if first:
        _warn_of_missing(found)
    todo = [source for source in todo if found[source] is None]
    outcomes = map_in_order(_outcome, todo, crew, None, _lost)
    for done, (source, outcome) in enumerate(zip(todo, outcomes, strict=True), start=1):
        if outcome:
            what = "keeps one hull" if isinstance(outcome, str) else "is left out"
            warnings.warn(f"{source.name} {what}: {outcome}", stacklevel=3)
        found[source] = outcome if isinstance(outcome, MechSearchError) else _kept(source)
        progress(f"preparing, {source.name}", done, len(todo))
    lost = [source.name for source, done in found.items() if done is None]
    if lost:
        raise MechSearchError(f"cannot keep {', '.join(lost)} in the cache at {cache_folder()}")
    _warn_of_coarse([found[source] for source in todo])
    return [prepared for prepared in found.values() if prepared is not None]


def _kept(source: Source) -> Prepared | MechSearchError | None:
    """Return the prepared object if the cache has it, or why its files cannot be read."""
    try:
        return cached(cache_path(source))
    except MechSearchError as error:
        return error


def _damage(source: Source) -> MechSearchError | None:
    """Return why a mesh cannot be read, or None."""
    try:
        read_pieces(source.mesh)
    except MechSearchError as error:
        return error
    return None


def _warn_of_missing(found: Mapping[Source, Prepared | MechSearchError | None]) -> None:
    for source, done in found.items():
        if isinstance(done, MechSearchError):
            warnings.warn(f"{source.name} is left out: {done}", stacklevel=4)
            continue
        for name in missing_files(source.mesh):
            warnings.warn(
                f"{source.name} is without {name!r}, which {source.mesh} names: there is no such "
                "file beside it",
                stacklevel=4,
            )


def _warn_of_coarse(fresh: Sequence[Prepared | MechSearchError | None]) -> None:
    coarse = [
        f"{done.model.name} {1000 * done.model.hull_error:.0f} mm"
        for done in fresh
        if isinstance(done, Prepared) and not done.excluded and done.model.flagged
    ]
    if coarse:
        named = f"more than {1000 * FLAGGED_ERROR:.0f} mm from the mesh: {', '.join(coarse)}"
        warnings.warn(f"convex parts {named}", stacklevel=4)


def _outcome(source: Source) -> str | MechSearchError:
    """Prepare an object; return the remark of its preparation, or why there is none."""
    try:
        return prepare_into(source, cache_path(source))
    except MechSearchError as error:
        return error


def _lost(source: Source, failure: Failure) -> MechSearchError:
    """Return why an object is not prepared that workers died of."""
    if failure.error is not None:
        raise failure.error
    return MechSearchError(f"cannot prepare {source.name}: {failure.reason}")


def cache_key(source: Source) -> str:
    """Return the SHA-256 of all that decides how an object comes out of preparation.

    That is its name, category and mass, the bytes of its mesh, material and texture files, and
    the settings of preparation.

    Raises:
        MechSearchError: If the mesh file is missing, or a file cannot be read.
    """
    if not source.mesh.is_file():
        raise MechSearchError(f"no mesh at {source.mesh}")
    settings = (
        *(prepare.VERSION, prepare.MOST_FACES, TEXEL_ROWS, prepare.COLOUR_SAMPLES, FRICTION),
        *convex.settings(),
        *(prepare.LONGEST, prepare.SECOND_LONGEST, prepare.LARGEST_BOX, prepare.SMALLEST),
        *(prepare.LIGHTEST, prepare.DENSITY, prepare.GROSS_ERROR, prepare.DEFORMABLE),
    )
    record = [source.name, source.category, source.mass, source.mesh.suffix.lower(), settings]
    sha = hashlib.sha256(json.dumps(record).encode())
    try:
        for file in source_files(source.mesh):
            with file.open("rb") as stream:
                sha.update(hashlib.file_digest(stream, "sha256").digest())
    except OSError as error:
        raise MechSearchError(f"cannot read {error.filename}: {error.strerror}") from None
    return sha.hexdigest()


def cache_path(source: Source) -> Path:
    """Return where the prepared object is kept."""
    # A name may be as long as a file's alone.
    name = f"{source.name[:40]}-{cache_key(source)[:32]}-{READING}.npz"
    return cache_folder() / "objects" / name


def cached(path: Path) -> Prepared | None:
    """Return the prepared object kept at `path`, or None; a damaged file is named and removed."""
    if not path.exists():
        return None
    try:
        return Prepared(*model_from_npz(path))
    except MechSearchError as error:
        warnings.warn(f"{error}; it is prepared again", stacklevel=2)
        path.unlink(missing_ok=True)
        return None


def prepare_into(source: Source, path: Path) -> str:
    """Prepare an object, keep it at `path` and return what went wrong without harm, if anything.

    Raises:
        MechSearchError: If the object cannot be prepared.
    """
    done = prepare.prepare(source)
    # The sources identify the object: prepared arrays may differ in their last bits elsewhere.
    # One hull kept for want of time is another object than the parts that a faster machine finds.
    identity = cache_key(source)
    if done.remark:
        identity = hashlib.sha256(f"{identity} {done.remark}".encode()).hexdigest()
    model_to_npz(path, replace(done.model, content_hash=identity), remark=done.excluded)
    return done.remark


def model_to_npz(path: Path, model: ObjectModel, remark: str = "") -> None:
    """Write a model, whole or not at all.

    Args:
        path: File to write, ending in .npz.
        model: What to keep.
        remark: Free text kept beside it, such as why the object cannot lie in a heap.
    """
    text = {name: getattr(model, name) for name in _TEXTS} | {"remark": remark}
    arrays: dict[str, Array] = {
        "text": np.frombuffer(json.dumps(text, sort_keys=True).encode(), np.uint8),
        "points": np.concatenate(model.parts),
        "part_sizes": np.array([len(part) for part in model.parts], np.int64),
        "scalars": np.array([getattr(model, name) for name in _SCALARS], np.float64),
        **{name: getattr(model, name) for name in _ARRAYS},
    }
    arrays["checksum"] = np.frombuffer(_checksum(arrays).encode(), np.uint8)
    write_whole(path, lambda partial: np.savez_compressed(partial, allow_pickle=False, **arrays))


def model_from_npz(path: Path) -> tuple[ObjectModel, str]:
    """Read a model and its remark.

    Raises:
        MechSearchError: If the file is missing, damaged or not such a file.
    """
    try:
        arrays = read_arrays(path, "object model")
        sound = bytes(arrays.pop("checksum")).decode() == _checksum(arrays)
        text = json.loads(bytes(arrays["text"]))
        remark = text.pop("remark")
        fields: dict[str, Any] = {name: arrays[name] for name in _ARRAYS} | text
        fields |= zip(_SCALARS, map(float, arrays["scalars"]), strict=True)
        parts = tuple(np.split(arrays["points"], np.cumsum(arrays["part_sizes"])[:-1]))
        model = ObjectModel(**fields, parts=parts)
    except (ValueError, KeyError, TypeError) as error:
        raise MechSearchError(f"the object model at {path} is damaged: {error}") from None
    if not sound:
        raise MechSearchError(f"the object model at {path} is damaged: its checksum differs")
    return model, remark


def _checksum(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of arrays, their shapes and types, the same on every machine."""
    sha = hashlib.sha256()
    for _, array in sorted(arrays.items()):
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        sha.update(f"{little.dtype.str}{little.shape}".encode())
        sha.update(little.tobytes())
    return sha.hexdigest()
