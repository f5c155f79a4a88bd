"""Functions that make any environment, or many, from names and files."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gymnasium.vector import AutoresetMode

from mechsearch import heaps as heap_sets
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.vector.vector_env import VectorHeapEnv
from mechsearch.heaps.dataset import HeapSet, load_heaps, open_heaps
from mechsearch.heaps.heap import check_condition
from mechsearch.types import MechSearchError


def embedded_file(condition: str) -> Path:
    """Return the file of the small heap set of household objects that the package holds."""
    return Path(str(heap_sets.__file__)).with_name(
        f"household_{check_condition(condition)}.parquet"
    )


def embedded_heaps(condition: str) -> HeapSet:
    """Return the small heap set of household objects that the package holds."""
    return load_heaps(embedded_file(condition))


def make_env(
    condition: str = "single",
    heaps: str | Path | None = None,
    objects: str = "household",
    split: str = "train",
    config: HeapEnvConfig | None = None,
    render_mode: str | None = None,
    **settings: Any,
) -> HeapEnv:
    """Return an environment.

    Args:
        condition: "single" or "dual"; chooses among the embedded heaps.
        heaps: Heap set file; None takes the embedded heaps of household objects.
        objects: Object set that the heaps were made with.
        split: "held-out", "train" or "all" of the heaps.
        config: The task.
        render_mode: "rgb_array" or None.
        settings: Fields of the configuration to replace, such as `privileged=True`.

    Raises:
        MechSearchError: If a name or setting is unknown, or heaps and objects do not fit.
    """
    file = embedded_file(condition) if heaps is None else Path(heaps)
    heap_set, object_set = open_heaps(file, objects)
    chosen = [heap_set.heaps[i] for i in heap_set.choose(split)]
    base = config or HeapEnvConfig(camera=heap_set.camera)
    unknown = [key for key in settings if key not in base.__dataclass_fields__]
    if unknown:
        raise MechSearchError(
            f"unknown setting {unknown[0]!r}; choose among {', '.join(base.__dataclass_fields__)}"
        )
    return HeapEnv(chosen, object_set, replace(base, **settings), render_mode)


def make_vector_env(
    num_envs: int = 1,
    workers: int | None = None,
    time_limit: float = 60.0,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    **task: Any,
) -> VectorHeapEnv:
    """Return many environments in worker processes.

    Args:
        num_envs: Environments.
        workers: Processes; as many as there are processors, or environments, by default.
        time_limit: Time after which an action or a reset hangs [s].
        autoreset_mode: SAME_STEP or DISABLED; see `VectorHeapEnv`.
        task: What `make_env` takes.

    Raises:
        MechSearchError: If a name, number or setting is wrong, or heaps and objects do not fit.
    """
    return VectorHeapEnv(partial(make_env, **task), num_envs, workers, time_limit, autoreset_mode)
