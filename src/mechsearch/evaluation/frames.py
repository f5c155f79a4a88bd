"""What was seen in recorded episodes: their actions carried out again, this time with images."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, overload

import numpy as np

from mechsearch.camera import Camera, preset
from mechsearch.env import HeapEnv, HeapEnvConfig, RetrieveConfig, RetrieveEnv, task_from_json
from mechsearch.evaluation.episodes import IN_HAND, STOPPED, EpisodeRecord, Evaluation
from mechsearch.heaps.dataset import Heap, recorded_objects
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.processes import Failure, Mapper, Progress, map_in_order, silent
from mechsearch.types import ACTOR_KEYS, RETRIEVAL_KEYS, Array, MechSearchError

_SAME = 1e-3
"""Distance up to which an object lies where it was recorded [m]: machines differ by rounding."""

_LIMIT = 600.0
"""Time after which an episode hangs [s]; it takes a second."""

_OTHERWISE = "here its physics takes another course than it was recorded with"


@dataclass(frozen=True)
class Frames:
    """An episode of T actions with all that was seen.

    Attributes:
        record: The episode.
        observations: By key (T + 1, ...): before each action, and after the last one.
    """

    record: EpisodeRecord
    observations: Mapping[str, Array]

    @property
    def task(self) -> str:
        """What is asked for, such as "uncover the foam brick"."""
        record = self.record
        name = re.sub(r"^\d+[-_]", "", record.objects[record.target])
        verb = "uncover" if record.retrieval is None else "retrieve"
        return f"{verb} the {re.sub(r'[-_]+', ' ', name)}"

    @property
    def success(self) -> bool:
        """Whether it was done."""
        return self.record.uncovered or self.record.end == IN_HAND

    @property
    def terminated(self) -> bool:
        """Whether the task was over in the end, rather than the time."""
        return self.success or self.record.end in ("lost", STOPPED)


def shown_task(header: Mapping[str, Any]) -> HeapEnvConfig:
    """Return the task of an evaluation, with the keys that `frames_of` has: images, all of them."""
    retrieves = "grippers" in header["env"]
    keys = (*(RETRIEVAL_KEYS if retrieves else ACTOR_KEYS), "rgb")
    task = task_from_json(RetrieveConfig if retrieves else HeapEnvConfig, header["env"])
    return replace(task, keys=keys, privileged=False)


def recorded_camera(header: Mapping[str, Any]) -> Camera:
    """Return the camera of an evaluation's images."""
    task = shown_task(header)
    return preset(task.camera, task.image_size)


@overload
def recorded_environment(
    config: RetrieveConfig, record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> RetrieveEnv: ...


@overload
def recorded_environment(
    config: HeapEnvConfig, record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> HeapEnv | RetrieveEnv: ...


def recorded_environment(
    config: HeapEnvConfig, record: EpisodeRecord, models: Mapping[str, ObjectModel]
) -> HeapEnv | RetrieveEnv:
    """Return the environment in which an episode took place; `fixed_start` begins it.

    Args:
        config: The task, and what is shown of it.
        record: The episode.
        models: Objects by name.
    """
    heap = Heap(
        record.objects, record.poses[0], record.target, float(record.occlusions[0]),
        record.heap_seed, record.count, record.condition, held_out=True,
    )  # fmt: skip
    objects = ObjectSet("recorded", models, {})
    if isinstance(config, RetrieveConfig):
        return RetrieveEnv([heap], objects, config)
    return HeapEnv([heap], objects, config)


def frames_of(
    evaluation: Evaluation,
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
    lost: Callable[[str], object] = lambda _: None,
) -> Iterator[Frames]:
    """Yield each episode as it was seen, in their order, but for those that cannot be shown.

    Args:
        evaluation: The recorded episodes.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.
        lost: Told which episode cannot be shown, and why.

    Raises:
        MechSearchError: If the objects are not at hand, or are others, or nothing can be shown.
    """
    header, records = evaluation.header, evaluation.episodes
    show = _Show(header, objects)
    _ = show.models
    reason, kept = "", 0
    for i, shown in enumerate(mapper(show, records, workers, _LIMIT, _failed)):
        progress(f"images of {header['name']}", i + 1, len(records))
        if isinstance(shown, Frames):
            kept += 1
            yield shown
        else:
            reason = f"heap {records[i].heap_seed} is left out: {shown}"
            lost(reason)
    if not kept:
        raise MechSearchError(f"no episode of {header['name']} could be shown again: {reason}")


def _failed(record: EpisodeRecord, failure: Failure) -> str:
    return failure.reason


@dataclass(frozen=True)
class _Show:
    """Carries out the actions of episodes again, in whichever process."""

    header: Mapping[str, Any]
    objects: str

    def __getstate__(self) -> dict[str, Any]:
        return {"header": dict(self.header), "objects": self.objects}

    @cached_property
    def models(self) -> Mapping[str, ObjectModel]:
        name, hashes = str(self.header["object_set"]), self.header["object_hashes"]
        what = "these episodes were recorded"
        return recorded_objects(what, name, hashes, self.objects).models

    def __call__(self, record: EpisodeRecord) -> Frames | str:
        env = recorded_environment(shown_task(self.header), record, self.models)
        seen = [env.reset(options={"heap": 0, "fixed_start": True})[0]]
        end = None
        for step, action in enumerate(record.actions):
            try:
                obs, _, _, _, info = env.step(action)
            except MechSearchError as error:
                return f"{_OTHERWISE}: {error}"
            seen.append(obs)
            end, poses = info["end"], env.state.poses
            if not info["failure"] and not is_near(poses, record.poses[step + 1]):
                return _OTHERWISE
        if end != record.end:
            return f"{_OTHERWISE}: it ends with {end!r} instead of {record.end!r}"
        return Frames(record, {key: _stacked(seen, key) for key in seen[0]})


def is_near(poses: Array, recorded: Array) -> bool:
    """Return whether objects (N, 7) lie where they were recorded, but for rounding."""
    return bool(np.abs(poses - recorded)[:, :3].max() <= _SAME)


def _stacked(seen: Sequence[Mapping[str, Array]], key: str) -> Array:
    return np.stack([obs[key] for obs in seen])
