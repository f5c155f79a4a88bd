"""The paper's heap generator (section IV-A): drop, settle, choose an occluded target, or discard.

Every attempt is a pure function of (seed, count, number of the attempt), and accepted attempts are
taken in their order, so a heap set does not depend on the number of workers.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.camera import preset
from mechsearch.files import (
    alone,
    append_line,
    line_of,
    read_lines,
    read_record,
    write_record,
    write_text,
)
from mechsearch.geometry import random_quaternion, rotation_from_quaternion
from mechsearch.heaps.dataset import (
    CONDITIONS,
    HEAPS_FORMAT,
    Heap,
    HeapSet,
    check_condition,
    heap_from_json,
    heap_to_json,
    object_set,
    objects_of,
    save_heaps,
)
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.processes import Failure, Mapper, Progress, map_in_order, silent
from mechsearch.render.visibility import body_of, occlusion
from mechsearch.sim import (
    AWAKE,
    ENGINE_VERSION,
    REST_LIMIT,
    PhysicsConfig,
    Wall,
    Workspace,
    World,
    drift,
    settle,
)
from mechsearch.types import Floats, MechSearchError

DROPS = ("wall", "open")
HELD_OUT = ("half", "all")

ATTEMPT_LIMIT = 300.0
"""Time after which an attempt or a check hangs [s]; either takes a fraction of a second."""

_DROPPING = PhysicsConfig(time_step=0.0075, contact_time=0.015, sleep_speed=0.0)
"""Coarser than an episode's physics, in which the rest of every accepted heap is measured."""


@dataclass(frozen=True)
class GenerateConfig:
    """What to generate.

    Attributes:
        condition: "single" or "dual".
        heaps: How many heaps in all, equally many of each object count.
        objects: Object set: "household", "ycb" or a folder.
        seed: Of all randomness.
        drop: "wall" confines the objects while they fall; "open" lets them scatter.
        camera: View that occlusion is measured from.
        least: Least occlusion of a target.
        most: Greatest occlusion of a target.
        height: From which an object's lowest point drops [m]; higher only over a higher heap.
        counts: Objects in each heap; empty means the paper's.
        only: Names of the objects to choose from; empty means all.
        without: Names of objects to leave out.
        held_out: Which heaps are kept for evaluation: "half" of each object count, or "all".
        retries: How many more chances to come to rest, in an episode's physics, a heap has, what
            fell off the table dropped onto it again; 0 discards a heap at the first look.
    """

    condition: str = "single"
    heaps: int = 60
    objects: str = "household"
    seed: int = 0
    drop: str = "wall"
    camera: str = "overhead"
    least: float = 0.1
    most: float = 0.9
    height: float = 0.3
    counts: tuple[int, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    held_out: str = "half"
    retries: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", str(self.objects))
        check_condition(self.condition)
        preset(self.camera)
        if self.drop not in DROPS:
            raise MechSearchError(f"unknown drop {self.drop!r}; choose one of {', '.join(DROPS)}")
        if self.held_out not in HELD_OUT:
            raise MechSearchError(
                f"held_out is {self.held_out!r}; choose one of {', '.join(HELD_OUT)}"
            )
        if self.retries < 0:
            raise MechSearchError(f"retries is {self.retries}; expected at least 0")
        if len(set(self.counts)) < len(self.counts):
            raise MechSearchError(f"counts are {self.counts}; expected each number once")
        least = 2 if self.condition == "single" else 1
        if min(self.object_counts) < least:
            raise MechSearchError(
                f"counts are {self.counts}; expected each at least {least}: a heap has something "
                "that hides something"
            )
        quotas = len(self.object_counts)
        if self.heaps < 1 or self.heaps % quotas:
            raise MechSearchError(
                f"{self.heaps} heaps cannot be shared equally by the object counts "
                f"{self.object_counts}; expected a positive multiple of {quotas}"
            )
        if not 0.0 <= self.least < self.most <= 1.0:
            raise MechSearchError(
                f"occlusion bounds {self.least} and {self.most}: expected 0 <= least < most <= 1"
            )

    @property
    def object_counts(self) -> tuple[int, ...]:
        """Objects in each heap, one entry for each equally large part of the set."""
        return self.counts or CONDITIONS[self.condition]

    @property
    def chosen(self) -> ObjectSet:
        """The objects that may lie in a heap.

        Raises:
            MechSearchError: If there is no such set or object.
        """
        return object_set(self.objects).choose(self.only, self.without)

    def record(self) -> dict[str, Any]:
        """Return the values that name the set; later fields only where they are not the usual."""
        later = ("only", "without", "held_out", "retries")
        usual = {entry.name: entry.default for entry in fields(self) if entry.name in later}
        values = {k: v for k, v in asdict(self).items() if k not in usual or v != usual[k]}
        return values | {"counts": self.object_counts}


@dataclass(frozen=True)
class Drop:
    """One attempt, and what came of it.

    Attributes:
        count: Objects in each heap.
        number: Which attempt at this count.
        heap: None until it is done, and if it is discarded.
        lost: Why two workers did not finish it, if so.
    """

    count: int
    number: int
    heap: Heap | None = None
    lost: str | None = None

    def row(self) -> dict[str, Any]:
        """Return the journal's record."""
        heap = None if self.heap is None else heap_to_json(self.heap)
        row = {"count": self.count, "number": self.number, "heap": heap}
        return row | ({"lost": self.lost} if self.lost else {})


@dataclass
class Quota:
    """Heaps of one object count.

    Attributes:
        count: Objects in each heap.
        size: How many heaps are needed.
        heaps: Those accepted, in the order of their attempts.
        tried: Attempts so far.
        lost: Why workers did not finish an attempt, by its number.
    """

    count: int
    size: int
    heaps: list[Heap] = field(default_factory=list)
    tried: int = 0
    lost: dict[str, str] = field(default_factory=dict)

    @property
    def full(self) -> bool:
        """Whether no more are needed."""
        return len(self.heaps) == self.size

    def resume(self, row: Mapping[str, Any]) -> None:
        """Take the next attempt from a journal; any other is passed over."""
        if row["number"] == self.tried and not self.full:
            heap = None if row["heap"] is None else heap_from_json(row["heap"])
            self.add(Drop(self.count, self.tried, heap, row.get("lost")))

    def add(self, drop: Drop) -> None:
        """Take the next attempt.

        Raises:
            MechSearchError: If hardly any are accepted.
        """
        self.tried += 1
        if drop.lost is not None:
            self.lost[str(drop.number)] = drop.lost
        if drop.heap is not None:
            self.heaps.append(drop.heap)
        elif self.tried >= 200 and len(self.heaps) < self.tried / 200:
            raise MechSearchError(
                f"only {len(self.heaps)} of {self.tried} drops of {self.count} objects were "
                "accepted; these objects hardly ever hide each other under these conditions"
                + (f"; {len(self.lost)} drops were lost: {drop.lost}" if drop.lost else "")
            )


def drops_until_full(quotas: Iterable[Quota]) -> Iterator[Drop]:
    """Yield attempts until the quotas are full, one object count after another."""
    for quota in quotas:
        number = quota.tried
        while not quota.full:
            yield Drop(quota.count, number)
            number += 1


def generate(
    config: GenerateConfig,
    path: str | Path,
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> HeapSet:
    """Generate a heap set and write it to `path` (Parquet); continue if it was cut off.

    An attempt that two workers died of, or hung in, is discarded; the manifest has its number.

    Args:
        config: What to generate.
        path: Heap set to write.
        workers: Number of processes.
        progress: Told after each accepted heap.
        mapper: How the attempts are spread.

    Raises:
        MechSearchError: If `path` holds another set, the objects are too few or hardly ever hide
            each other, or another process generates this set.
    """
    path, objects = Path(path), config.chosen
    needed = max(config.object_counts) * (2 if config.condition == "dual" else 1)
    if len(objects.models) < needed:
        raise MechSearchError(
            f"object set {objects.name!r} has {len(objects.models)} objects that can lie in a "
            f"heap; these heaps need {needed} distinct ones"
        )
    with alone(path, f"the heap set {path}"):
        journal = _open_journal(config, objects, path)
        quota = config.heaps // len(config.object_counts)
        quotas = {count: Quota(count, quota) for count in config.object_counts}
        for row in sorted(read_lines(journal), key=lambda row: int(row["number"])):
            quotas[row["count"]].resume(row)
        for one in quotas.values():
            progress(f"{config.condition} heaps of {one.count}", len(one.heaps), quota)
        drops = drops_until_full(quotas.values())
        for drop in mapper(partial(_attempted, config), drops, workers, ATTEMPT_LIMIT, _lost):
            one = quotas[drop.count]
            if one.full:
                continue
            append_line(journal, drop.row())
            try:
                one.add(drop)
            except MechSearchError:
                # For good: nobody goes on with these drops, and another set may be wanted here.
                _discard(journal)
                raise
            if drop.heap is not None:
                progress(f"{config.condition} heaps of {one.count}", len(one.heaps), quota)
            if all(one.full for one in quotas.values()):
                break
        heap_set = save_heaps(path, *_collected(config, objects, list(quotas.values())))
        _discard(journal)
        return heap_set


def _discard(journal: Path) -> None:
    journal.unlink()
    journal.with_suffix(".json").unlink()


def _collected(
    config: GenerateConfig, objects: ObjectSet, quotas: Sequence[Quota]
) -> tuple[list[Heap], dict[str, Any]]:
    """Return all heaps and their manifest."""
    # Every second heap is held out, so that each object count is halved.
    heaps = [
        replace(heap, held_out=config.held_out == "all" or i % 2 == 1)
        for quota in quotas
        for i, heap in enumerate(quota.heaps)
    ]
    manifest = {
        "format": HEAPS_FORMAT,
        "config": {**config.record(), "objects": objects.name},
        "engine": ENGINE_VERSION,
        "object_hashes": objects.hashes,
        "attempts": {str(quota.count): quota.tried for quota in quotas},
        "acceptance_rate": len(heaps) / max(sum(quota.tried for quota in quotas), 1),
    }
    lost = {str(quota.count): quota.lost for quota in quotas if quota.lost}
    return heaps, manifest | ({"lost_attempts": lost} if lost else {})


def attempt(config: GenerateConfig, objects: ObjectSet, count: int, number: int) -> Heap | None:
    """Drop one heap; return None if it is discarded.

    Args:
        config: What to generate.
        objects: The object set.
        count: Objects in each heap.
        number: Which attempt at this count.
    """
    seeds = np.random.SeedSequence([config.seed, count, number])
    rng = np.random.default_rng(seeds)
    walls = _walls(config.condition, count, rng)
    chosen = rng.choice(len(objects.models), count * len(walls), replace=False)
    names = tuple(list(objects.models)[i] for i in chosen)
    models = [objects.models[name] for name in names]
    world = World(models, walls=walls if config.drop == "wall" else (), config=_DROPPING)
    poses = _drop(world, models, walls, config, rng)
    if poses is None:
        return None
    workspace = Workspace()
    bodies = [body_of(model) for model in models]
    camera = preset(config.camera)
    for target in rng.permutation(len(names)):
        inside = np.abs(poses[target, :2]).max() < workspace.half
        hidden = occlusion(bodies, camera, poses, int(target))
        if inside and config.least <= hidden <= config.most:
            if drift(models, poses) > REST_LIMIT:
                return None
            identity = int(seeds.generate_state(1, np.uint64)[0] >> 1)
            return Heap(names, poses, int(target), hidden, identity, count, config.condition, False)
    return None


def _walls(condition: str, count: int, rng: np.random.Generator) -> tuple[Wall, ...]:
    """Return where the heaps drop: one near the centre, or one on each side of it."""
    radius = 0.1 * float(np.cbrt(count / 5))
    if condition == "single":
        x, y = rng.uniform(-0.05, 0.05, 2)
        return (Wall(float(x), float(y), radius),)
    x, y = rng.uniform(-0.02, 0.02, 2)
    angle, half = rng.uniform(0, 2 * np.pi), radius + rng.uniform(0.02, 0.04)
    dx, dy = half * np.cos(angle), half * np.sin(angle)
    return (Wall(float(x + dx), float(y + dy), radius), Wall(float(x - dx), float(y - dy), radius))


def _orientation(
    model: ObjectModel, reach: float, rng: np.random.Generator
) -> tuple[Floats, float, Floats]:
    """Return an orientation (4,), its lowest point [m], and an offset (2,) that fits the wall."""
    points = np.concatenate(model.parts)
    best: tuple[float, Floats, float, Floats] | None = None
    for _ in range(30):
        quaternion, offset = random_quaternion(rng), rng.uniform(-0.04, 0.04, 2)
        turned = points @ rotation_from_quaternion(quaternion).T
        width = float(np.linalg.norm(turned[:, :2] + offset, axis=1).max())
        if best is None or width < best[0]:
            best = width, quaternion, float(turned[:, 2].min()), offset
        if width < reach:
            break
    assert best is not None
    return best[1:]


def _let_fall(
    world: World,
    index: int,
    model: ObjectModel,
    wall: Wall,
    highest: float,
    config: GenerateConfig,
    rng: np.random.Generator,
) -> None:
    """Put one object, turned at random, in the air over what is `highest` inside a wall [m]."""
    reach = wall.radius if config.drop == "wall" else np.inf
    quaternion, low, offset = _orientation(model, reach, rng)
    height = max(config.height, highest + 0.1) - low
    x, y = wall.x + offset[0], wall.y + offset[1]
    world.place(index, np.array([x, y, height, *quaternion]))


def _drop(
    world: World,
    models: Sequence[ObjectModel],
    walls: Sequence[Wall],
    config: GenerateConfig,
    rng: np.random.Generator,
) -> Floats | None:
    """Drop all objects one after another; return their poses at rest, or None."""
    waiting = [[0.0, 0.0, 100.0 + 3.0 * i, 1.0, 0.0, 0.0, 0.0] for i in range(world.count)]
    world.reset(np.array(waiting))
    # An object has fallen far enough to drop the next one above it.
    pause = round(0.16 / len(walls) / world.config.time_step)
    for i, model in enumerate(models):
        highest = world.poses[i % len(walls) : i : len(walls), 2].max(initial=0.0)
        _let_fall(world, i, model, walls[i % len(walls)], highest, config, rng)
        world.step(pause)
    world.step(round(0.25 / world.config.time_step))
    world.remove_walls()
    settled = settle(world)
    if world.failure() is not None:
        return None
    if config.retries:
        return _retried(models, world.poses, walls, config, rng)
    return world.poses if settled else None


def _retried(
    models: Sequence[ObjectModel],
    poses: Floats,
    walls: Sequence[Wall],
    config: GenerateConfig,
    rng: np.random.Generator,
) -> Floats | None:
    """Return the poses at rest of a heap that has more chances than one, or None."""
    world = World(models, config=AWAKE)
    world.reset(poses)
    for _ in range(config.retries):
        for i in np.flatnonzero(world.workspace.off_table(world.poses)).tolist():
            highest = float(world.poses[:, 2].max())
            _let_fall(world, i, models[i], walls[i % len(walls)], highest, config, rng)
            world.step(round(0.16 / world.config.time_step))
        if settle(world):
            return world.poses if world.failure() is None else None
    return None


def _attempted(config: GenerateConfig, drop: Drop) -> Drop:
    objects = config.chosen
    return replace(drop, heap=attempt(config, objects, drop.count, drop.number))


def _lost(drop: Drop, failure: Failure) -> Drop:
    """Discard an attempt that workers died of; what the attempt raises is an error of ours."""
    if failure.error is not None:
        raise failure.error
    return replace(drop, lost=failure.reason)


def _open_journal(config: GenerateConfig, objects: ObjectSet, path: Path) -> Path:
    """Return the file of attempts so far, empty or of the very same set."""
    journal = path.with_name(f".{path.stem}.attempts.jsonl")
    identity = {
        "config": config.record(),
        "engine": ENGINE_VERSION,
        "object_hashes": objects.hashes,
    }
    header = journal.with_suffix(".json")
    if path.exists():
        raise MechSearchError(f"{path} exists already; name another file or remove it")
    rows = list(read_lines(journal))
    if header.exists() and read_record(header, "journal of a heap set") != json.loads(
        json.dumps(identity)
    ):
        if any(row["heap"] for row in rows):
            raise MechSearchError(
                f"{header.name} beside {path} belongs to another heap set that was cut off; finish "
                "that one with its own settings, or remove the file and its .jsonl"
            )
        rows = []
    write_record(header, "journal of a heap set", identity)
    write_text(journal, "".join(map(line_of, rows)))
    return journal


@dataclass(frozen=True)
class Check:
    """What verifying one heap found.

    Attributes:
        seed: The heap.
        drift: How far its most restless object moves in one simulated second [m].
        occlusion_error: Recorded minus measured occlusion of the target.
    """

    seed: int
    drift: float
    occlusion_error: float

    @property
    def passed(self) -> bool:
        """Whether the heap is at rest and its target is occluded as recorded."""
        return self.drift <= REST_LIMIT and abs(self.occlusion_error) < 1e-9


def _checked(objects: str, camera: str, heap: Heap) -> Check:
    models = [object_set(objects).models[name] for name in heap.objects]
    bodies = [body_of(model) for model in models]
    measured = occlusion(bodies, preset(camera), heap.poses, heap.target)
    return Check(heap.seed, drift(models, heap.poses), heap.occlusion - measured)


def _unverified(heap: Heap, failure: Failure) -> Check:
    """Return the check of a heap that workers died of or hung in."""
    if failure.error is not None:
        raise failure.error
    return Check(heap.seed, float("inf"), float("nan"))


def verify(
    heap_set: HeapSet, objects: str = "", workers: int = 1, progress: Progress = silent
) -> Iterator[Check]:
    """Restore every heap, and measure its rest and its target's occlusion.

    Args:
        heap_set: What to verify.
        objects: Object set; empty takes the one that the heaps were made with.
        workers: Number of processes.
        progress: Told after each heap.

    Raises:
        MechSearchError: If the set was made with other objects.
    """
    objects_of(heap_set, objects)
    check = partial(_checked, objects or heap_set.objects, heap_set.camera)
    checks = map_in_order(check, heap_set.heaps, workers, ATTEMPT_LIMIT, _unverified)
    for i, result in enumerate(checks):
        progress("verified", i + 1, len(heap_set.heaps))
        yield result
