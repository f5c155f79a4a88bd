"""Prepared objects kept in the user's cache folder, by the content of what they are made from."""

import hashlib
import json
import os
import warnings
from dataclasses import replace
from pathlib import Path

from platformdirs import user_cache_dir

from mechsearch.objects.meshes import convex, hull, limits, prepare
from mechsearch.objects.meshes.archive import model_from_npz, model_to_npz
from mechsearch.objects.meshes.mesh_file import source_files
from mechsearch.objects.meshes.prepare import Prepared, Source
from mechsearch.types import MechSearchError


def cache_folder() -> Path:
    """Return the user's cache folder, or the one that MECHSEARCH_CACHE names."""
    named = os.environ.get("MECHSEARCH_CACHE")
    return Path(named) if named else Path(user_cache_dir("mechsearch"))


def cache_key(source: Source) -> str:
    """Return the SHA-256 of all that decides how an object comes out of preparation.

    That is its name, category and mass, the bytes of its mesh, material and texture files, and
    the settings of preparation.

    Raises:
        MechSearchError: If the mesh file is missing.
    """
    if not source.mesh.is_file():
        raise MechSearchError(f"no mesh at {source.mesh}")
    settings = [
        prepare.VERSION,
        prepare.MOST_FACES,
        prepare.TEXEL_ROWS,
        prepare.COLOUR_SAMPLES,
        prepare.FRICTION,
        hull.HULL_VERTICES,
        convex.SINGLE_HULL_ERROR,
        convex.SINGLE_HULL_USUAL_ERROR,
        convex.MOST_PARTS,
        convex.THRESHOLD,
        limits.LONGEST,
        limits.SECOND_LONGEST,
        limits.LARGEST_BOX,
        limits.SHORTEST,
        limits.LIGHTEST,
        limits.DENSITY,
        limits.GROSS_ERROR,
        limits.DEFORMABLE,
    ]
    record = [source.name, source.category, source.mass, source.mesh.suffix.lower(), settings]
    sha = hashlib.sha256(json.dumps(record).encode())
    for file in source_files(source.mesh):
        with file.open("rb") as stream:
            sha.update(hashlib.file_digest(stream, "sha256").digest())
    return sha.hexdigest()


def cache_path(source: Source) -> Path:
    """Return where the prepared object is kept."""
    return cache_folder() / "objects" / f"{source.name}-{cache_key(source)[:32]}.npz"


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
