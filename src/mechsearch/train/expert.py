"""The look-ahead expert as a teacher of `plus`, and the store of what it shows."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.look_ahead import LookAhead, LookAheadConfig
from mechsearch.heaps.dataset import HeapSet, check_objects, load, object_set
from mechsearch.parallel import Mapper, Progress, map_in_order, silent
from mechsearch.runs import alone, write_record
from mechsearch.train.demonstrations import Demonstration, DemonstrationStore
from mechsearch.types import Observation
from mechsearch.workers import Failure

FAILED = ".failed.json"

HEAP_LIMIT = 1800.0
"""Time after which planning on one heap hangs [s]; it takes up to a minute."""


class LookAheadExpert:
    """Plans from wherever an environment is, and acts to the episode's end."""

    def __init__(self, env: HeapEnv, config: LookAheadConfig | None = None) -> None:
        """Prepare to plan for an environment.

        Args:
            env: Whose heaps and task are planned for.
            config: How far to look.
        """
        self._look_ahead = LookAhead(env.heaps, env.objects, env.config, config)

    def __call__(self, env: HeapEnv) -> tuple[Demonstration | None, int]:
        """Execute the best push found.

        Returns:
            What was seen and done, or None if no push uncovers the target; and the number of
            actions simulated.
        """
        snapshot = env.snapshot()
        plan = self._look_ahead.plan(snapshot, env.heap.seed)
        obs: Observation = env.restore(snapshot)
        pairs, total = [], 0.0
        for action in plan.actions if plan.end == "uncovered" else ():
            pairs.append((obs, action))
            obs, reward, _, _, _ = env.step(action)
            total += reward
        if not pairs:
            return None, plan.simulated_actions
        shown = Demonstration.of(
            pairs, env.config.keys, plan.simulated_actions, len(plan.actions), total
        )
        return shown, plan.simulated_actions


@dataclass(frozen=True)
class DemonstrateConfig:
    """Which demonstrations to record.

    Attributes:
        heaps: Heap set file; its training half is demonstrated.
        objects: Object set that the heaps were made with.
        first: Index of the first training heap.
        count: Number of training heaps; 0 is all.
        starts: Starting positions tried on each heap.
        seed: Of the starting positions.
        look_ahead: How far to look.
    """

    heaps: Path
    objects: str = "household"
    first: int = 0
    count: int = 0
    starts: int = 1
    seed: int = 0
    look_ahead: LookAheadConfig = field(default_factory=LookAheadConfig)


def demonstrate(
    config: DemonstrateConfig,
    path: Path,
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> DemonstrationStore:
    """Record demonstrations into a folder; heaps that are there already are not tried again.

    A heap that two workers died of, or hung in, counts as failed, and its file says why.

    Args:
        config: Which to record.
        path: Folder to write.
        workers: Number of processes.
        progress: Told after each heap.
        mapper: How the heaps are spread.

    Raises:
        MechSearchError: If heaps and objects do not fit, the folder is of another heap set, or
            another process demonstrates the same share of the heaps.
    """
    # Other shares of the heaps may be demonstrated into the same folder at the same time.
    share = path / f"heaps-{config.first}-{config.count}"
    with alone(share, f"the demonstrations {path}"):
        return _demonstrate_alone(config, path, workers, progress, mapper)


def _demonstrate_alone(
    config: DemonstrateConfig, path: Path, workers: int, progress: Progress, mapper: Mapper
) -> DemonstrationStore:
    heap_set = load(config.heaps)
    check_objects(heap_set, object_set(config.objects))
    store = DemonstrationStore(path)
    store.open(
        {
            "heap_set": heap_set.hash,
            "look_ahead": asdict(config.look_ahead),
            "starts": config.starts,
            "seed": config.seed,
        }
    )
    names = heap_names(config, heap_set)
    todo = missing(config, heap_set, path)
    progress("demonstrated heaps", len(names) - len(todo), len(names))
    work = _Demonstrate(config)
    results = mapper(work, todo, workers, HEAP_LIMIT, _lost)
    for i, (name, result) in enumerate(zip(todo, results, strict=True)):
        if isinstance(result, Failure):
            lost = {"simulated_actions": 0, "failure": result.reason}
        elif result[0] is None:
            lost = {"simulated_actions": result[1]}
        else:
            store.write(name, result[0])
            lost = {}
        if lost:
            write_record(path / f"{name}{FAILED}", "failed demonstration", lost)
        progress("demonstrated heaps", len(names) - len(todo) + i + 1, len(names))
    return store


def heap_names(config: DemonstrateConfig, heap_set: HeapSet) -> list[str]:
    """Return the names under which a set's training heaps are demonstrated, start by start."""
    counts = [heap.count for heap in heap_set.train]
    last = min(config.first + config.count if config.count else len(counts), len(counts))
    heaps = spread_over_counts(counts, config.first, last)
    return [f"{start}-{heap:06d}" for start in range(config.starts) for heap in heaps]


def missing(config: DemonstrateConfig, heap_set: HeapSet, path: Path) -> list[str]:
    """Return the names that neither a demonstration nor a failure in a folder has."""
    done = set(DemonstrationStore(path).names()) | set(failed(path))
    return [name for name in heap_names(config, heap_set) if name not in done]


def _lost(name: str, failure: Failure) -> Failure:
    """Go on without a heap that workers died of; what planning raises is an error of ours."""
    if failure.error is not None:
        raise failure.error
    return failure


def failed(path: Path) -> list[str]:
    """Return the names of heaps for which no push succeeded."""
    return [file.name.removesuffix(FAILED) for file in path.glob(f"*{FAILED}")]


def spread_over_counts(counts: Sequence[int], first: int, last: int) -> list[int]:
    """Return heap indices first ... last of an order in which object counts alternate."""
    rank: dict[int, int] = {}
    order = []
    for index, count in enumerate(counts):
        rank[count] = rank.get(count, -1) + 1
        order.append((rank[count], count, index))
    return [index for _, _, index in sorted(order)][first:last]


@dataclass(frozen=True)
class _Demonstrate:
    """Demonstrates one heap, by the name of its file; for worker processes."""

    config: DemonstrateConfig

    def __call__(self, name: str) -> tuple[Demonstration | None, int] | Failure:
        start, heap = (int(part) for part in name.split("-"))
        env, expert = _workshop(self.config)
        seed = int(np.random.default_rng([self.config.seed, start, heap]).integers(2**31))
        env.reset(seed=seed, options={"heap": heap})
        return expert(env)


@cache
def _workshop(config: DemonstrateConfig) -> tuple[HeapEnv, LookAheadExpert]:
    heap_set = load(config.heaps)
    env = HeapEnv(heap_set.train, object_set(config.objects), HeapEnvConfig(camera=heap_set.camera))
    return env, LookAheadExpert(env, config.look_ahead)
