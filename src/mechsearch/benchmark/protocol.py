"""The benchmark's tasks and splits, each one entry in a table, and what they are fixed by."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from mechsearch.types import MechSearchError

HEAPS_FOLDER = "results/heaps"
"""Where the repository has the heap sets, as seen from its root."""

UNSEEN = (
    *("004_sugar_box", "005_tomato_soup_can", "012_strawberry", "017_orange", "031_spoon"),
    *("040_large_marker", "052_extra_large_clamp", "054_softball", "061_foam_brick"),
    *("065-b_cups", "065-g_cups", "072-c_toy_airplane", "073-b_lego_duplo"),
)
"""Objects that lie in no training heap: of each category of the published table, its usable members
sorted by name, the second and every fourth after it. A category of one stays known."""


@dataclass(frozen=True)
class BenchmarkTask:
    """What is to be done; its environment is the default one of its goal, and fixed.

    Attributes:
        version: Goes up when an episode would earn another reward or end otherwise.
        retrieves: Whether the target has to get into the hand, not just into view.
        ranked_by: The score by which the table is sorted.
    """

    version: int
    retrieves: bool
    ranked_by: str


@dataclass(frozen=True)
class Split:
    """The heaps of a task, fixed by their hash, and how well they are seen.

    Attributes:
        file: Heap set, in the folder of heap sets.
        heap_set: Hash of that set.
        part: "held-out", "train" or "all" of its heaps.
        limit: How many of them, spread evenly; 0 takes all.
        what: The heaps in words.
        unseen: Objects that must not have lain in a heap of the training.
        sensor: As of the task.
        segmenter: As of the task; who retrieves has the sensor's masks all the same.
    """

    file: str
    heap_set: str
    part: str
    limit: int
    what: str
    unseen: tuple[str, ...] = ()
    sensor: str = "perfect"
    segmenter: str = "true"


BENCHMARK_TASKS = {
    "uncover": BenchmarkTask(1, False, "reward"),
    "retrieve": BenchmarkTask(1, True, "retrieved_within_1"),
}

BENCHMARK_SPLITS = {
    "single": Split(
        "ycb_single.parquet",
        "48628cf7bf1101356e3aad1e5d2b9b5feb385e357817180685e8c018dab9b146",
        "held-out",
        300,
        "single heaps of 5, 10 and 15 objects",
    ),
    "dual": Split(
        "ycb_dual.parquet",
        "badef933ad02de73c70e87ddde5d1e4251ae73b518577e35b016ed56c2d275fe",
        "held-out",
        300,
        "two heaps of 5 to 10 objects each",
    ),
    "unseen": Split(
        "ycb_unseen.parquet",
        "0e3b90e1f819e5e7983f1399537de9f35dfd9c0ef69a886b2c07775fe870d8b7",
        "all",
        0,
        "single heaps of 5 and 10 of the 13 objects that no training heap holds",
        UNSEEN,
    ),
    "hidden": Split(
        "ycb_hidden.parquet",
        "abc0df680716688893c28e1edab96190a0f649c5aeb751c37c666a625235d4a1",
        "all",
        0,
        "single heaps of 10 and 15 objects, and two heaps of 10, target at least 97 % hidden",
    ),
    "large": Split(
        "ycb_large.parquet",
        "86f54bce701297af5fbfba6d8051328cbf11ee10a5d81442bf5d2d26f2a1b54a",
        "all",
        0,
        "single heaps of 20, 30 and 40 objects",
    ),
}

BENCHMARK_SPLITS["stereo"] = replace(
    BENCHMARK_SPLITS["single"],
    what="heaps of the split single, as a stereo camera and the shipped segmenter see them",
    sensor="stereo",
    segmenter="shipped",
)

Entry = TypeVar("Entry")


def entry(table: Mapping[str, Entry], kind: str, name: str) -> Entry:
    """Return what a name stands for in `BENCHMARK_TASKS` or `BENCHMARK_SPLITS`.

    Raises:
        MechSearchError: If it stands for nothing.
    """
    if name not in table:
        raise MechSearchError(f"unknown {kind} {name!r}; choose one of {', '.join(table)}")
    return table[name]


def environment_ids() -> dict[str, dict[str, str]]:
    """Return the arguments of `make_benchmark_env` by Gymnasium id."""
    return {
        f"mechsearch/Benchmark{task.title()}{split.title()}-v{BENCHMARK_TASKS[task].version}": {
            "task": task,
            "split": split,
        }
        for task in BENCHMARK_TASKS
        for split in BENCHMARK_SPLITS
    }
