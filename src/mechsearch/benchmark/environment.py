"""What acting in the benchmark means: the environment of a task on the heaps of a split."""

from collections.abc import Sequence
from pathlib import Path

from mechsearch.benchmark.protocol import BENCHMARK_SPLITS, BENCHMARK_TASKS, HEAPS_FOLDER, entry
from mechsearch.env import RetrievalTask, TaskConfig
from mechsearch.evaluation.rollout import AnyEnv, make_environment
from mechsearch.heaps.dataset import HeapSet, object_set, open_heaps
from mechsearch.types import ACTOR_KEYS, RETRIEVAL_KEYS, MechSearchError


def fixed_task(
    name: str, split: str, camera: str, image_size: int = 64, grippers: Sequence[str] = ()
) -> TaskConfig:
    """Return the task of a name on a split: fixed, but for what the policy chooses.

    Args:
        name: Of `BENCHMARK_TASKS`.
        split: Of `BENCHMARK_SPLITS`.
        camera: View from which occlusion is measured, that of the heaps.
        image_size: Side of the policy's images [px].
        grippers: Names of those that retrieve; empty takes the usual one.

    Raises:
        MechSearchError: If there is no such task or split, or a choice is no good.
    """
    heaps = entry(BENCHMARK_SPLITS, "split", split)
    if not entry(BENCHMARK_TASKS, "task", name).retrieves:
        return TaskConfig(camera, image_size, sensor=heaps.sensor, segmenter=heaps.segmenter)
    grippers = tuple(grippers) or RetrievalTask.grippers
    return RetrievalTask(camera, image_size, sensor=heaps.sensor, grippers=grippers)


def open_split(name: str, folder: Path, objects: str = "") -> tuple[Path, HeapSet]:
    """Return the file of a split's heaps, and the set that they are of.

    Args:
        name: Of `BENCHMARK_SPLITS`.
        folder: Where the heap sets are.
        objects: Object set; empty takes the one that the heaps name.

    Raises:
        MechSearchError: If one is missing, or the heaps are others.
    """
    split = entry(BENCHMARK_SPLITS, "split", name)
    file = folder / split.file
    heap_set, _ = open_heaps(file, objects)
    if heap_set.hash != split.heap_set:
        raise MechSearchError(
            f"{file} has the hash {heap_set.hash[:12]}; the split {name} is the heap set "
            f"{split.heap_set[:12]}"
        )
    return file, heap_set


def make_benchmark_env(
    task: str,
    split: str,
    heaps: str | Path = HEAPS_FOLDER,
    objects: str = "",
    keys: Sequence[str] = (),
    privileged: bool = False,
    image_size: int = 64,
    grippers: Sequence[str] = (),
    render_mode: str | None = None,
) -> AnyEnv:
    """Return the environment of a task on the heaps of a split.

    Args:
        task: Of `BENCHMARK_TASKS`.
        split: Of `BENCHMARK_SPLITS`.
        heaps: Folder of the heap sets.
        objects: Object set; empty takes the one that the heaps name.
        keys: Observation keys; empty takes the usual ones.
        privileged: Whether to add the keys that critic and teachers read.
        image_size: Side of the images [px].
        grippers: Names of those that retrieve; empty takes the usual one.
        render_mode: "rgb_array" or None.

    Raises:
        MechSearchError: If a name is unknown, or heaps or objects are others.
    """
    _, heap_set = open_split(split, Path(heaps), objects)
    models = object_set(objects or heap_set.objects)
    chosen = [
        heap_set.heaps[i]
        for i in heap_set.choose(BENCHMARK_SPLITS[split].part, BENCHMARK_SPLITS[split].limit)
    ]
    fixed = fixed_task(task, split, heap_set.camera, image_size, grippers)
    usual = RETRIEVAL_KEYS if isinstance(fixed, RetrievalTask) else ACTOR_KEYS
    return make_environment(chosen, models, fixed, keys or usual, privileged, render_mode)
