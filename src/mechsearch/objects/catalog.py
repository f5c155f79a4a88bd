"""Object sets by name or folder."""

from pathlib import Path

from mechsearch.files import cache_folder
from mechsearch.objects.folder import load_folder
from mechsearch.objects.household.object_set import household
from mechsearch.objects.model import ObjectSet
from mechsearch.objects.ycb.download import SCAN
from mechsearch.types import MechSearchError


def load_object_set(spec: str | Path, workers: int | None = None) -> ObjectSet:
    """Return an object set.

    Args:
        spec: "household" (built in), "ycb" (downloaded before), or a folder of meshes.
        workers: Processes that prepare objects not in the cache; one for each processor by
            default.

    Raises:
        MechSearchError: If there is no such set or it cannot be prepared.
    """
    if spec == "household":
        return household()
    if spec == "ycb":
        folder = ycb_folder()
        if not any(folder.glob(f"*/{SCAN.as_posix()}")):
            raise MechSearchError(
                f"no YCB objects at {folder}; run `mechsearch assets pull ycb`, or pass the folder "
                f"of a copy in the official layout (NNN_name/{SCAN.as_posix()})"
            )
        return load_folder(folder, name="ycb", workers=workers, need_masses=False)
    folder = Path(spec).expanduser()
    if not folder.exists():
        raise MechSearchError(
            f"no object set {str(spec)!r}; choose household, ycb, or a folder of meshes with masses"
        )
    return load_folder(folder, workers=workers)


def ycb_folder() -> Path:
    """Return where downloaded YCB objects are kept."""
    return cache_folder() / "ycb"
