"""Proof of recorded episodes: each is played again from its heap, and must be the same bits."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.evaluation.rollout import EPISODE_LIMIT, run_episode
from mechsearch.files import record_from_json
from mechsearch.heaps.dataset import check_objects, load_heaps
from mechsearch.objects.catalog import load_object_set
from mechsearch.processes import (
    Failure,
    Mapper,
    Progress,
    map_in_order,
    silent,
)
from mechsearch.types import Array, MechSearchError, Observation

_COMPARED = ("actions", "ee_positions", "poses", "occlusions", "clutter_moved", "target_moved")


@dataclass(frozen=True)
class Replay:
    """What playing one recorded episode again has shown.

    Attributes:
        heap_seed: Of its heap.
        differences: What came out otherwise, such as "occlusions from action 3 on"; empty if every
            bit is as recorded.
    """

    heap_seed: int
    differences: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every bit is as recorded."""
        return not self.differences


def replay_all(
    evaluation: Evaluation,
    heaps: Path,
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Iterator[Replay]:
    """Yield what playing each episode again shows, in their order.

    Physics, occlusion and reward are computed anew from heap, starting point and actions; the
    policy is not asked again. The bits are the same under the engine's version in the header.

    Args:
        evaluation: The recorded episodes.
        heaps: File of the heap set that they ran on.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If the heap set is another, or the objects are.
    """
    heap_set = load_heaps(heaps)
    if heap_set.hash != evaluation.header["heap_set"]:
        raise MechSearchError(
            f"{heaps} has the hash {heap_set.hash[:12]}; these episodes ran on the heap set "
            f"{str(evaluation.header['heap_set'])[:12]}"
        )
    spec = objects or str(evaluation.header["object_set"])
    check_objects(heap_set, load_object_set(spec))
    config = record_from_json(HeapEnvConfig, evaluation.header["env"])
    # No image is looked at: what is recorded does not depend on what the policy saw.
    task = replace(config, keys=("ee_position",))
    play = _Play(heaps, spec, task)
    name = f"{evaluation.header['name']} played again"
    results = mapper(play, evaluation.episodes, workers, EPISODE_LIMIT, _failed)
    for i, found in enumerate(results):
        progress(name, i + 1, len(evaluation.episodes))
        yield found


def compare(recorded: EpisodeRecord, played: EpisodeRecord) -> tuple[str, ...]:
    """Return in what two records of an episode differ, bit by bit."""
    differences = []
    pairs = {name: (getattr(recorded, name), getattr(played, name)) for name in _COMPARED}
    for term in dict.fromkeys((*recorded.reward_terms, *played.reward_terms)):
        nothing = np.empty(0)
        pairs[f"reward term {term}"] = (
            recorded.reward_terms.get(term, nothing),
            played.reward_terms.get(term, nothing),
        )
    for name, (before, now) in pairs.items():
        if before.shape != now.shape:
            differences.append(f"{name} of {len(now)} entries instead of {len(before)}")
        elif before.tobytes() != now.tobytes():
            differences.append(f"{name} from {_first(before, now)} on")
    if recorded.end != played.end:
        differences.append(f"the end, {played.end!r} instead of {recorded.end!r}")
    return tuple(differences)


def _first(before: Array, now: Array) -> int:
    """Return the first row that differs."""
    rows = (len(before), -1)
    return int(np.argmax((before.reshape(rows) != now.reshape(rows)).any(axis=1)))


def _failed(record: EpisodeRecord, failure: Failure) -> Replay:
    return Replay(record.heap_seed, (failure.reason,))


@dataclass(frozen=True)
class _Play:
    """Plays a recorded episode again, in whichever process."""

    heaps: Path
    objects: str
    config: HeapEnvConfig

    def __call__(self, record: EpisodeRecord) -> Replay:
        env = _prepared(self)
        found = [
            i
            for i, heap in enumerate(env.heaps)
            if (heap.seed, heap.condition) == (record.heap_seed, record.condition)
        ]
        if not found:
            return Replay(record.heap_seed, ("its heap is not in the set",))
        try:
            played = run_episode(_Recorded(record.actions), env, found[0], name=record.policy)
        except MechSearchError as error:
            return Replay(record.heap_seed, (str(error),))
        return Replay(record.heap_seed, compare(record, played))


class _Recorded:
    """A policy that repeats recorded actions."""

    keys: tuple[str, ...] = ("ee_position",)

    def __init__(self, actions: Sequence[Array] | Array) -> None:
        self._actions = iter(actions)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin; there is nothing to draw."""

    def act(self, obs: Observation) -> Array:
        """Return the next recorded action."""
        action = next(self._actions, None)
        if action is None:
            raise MechSearchError("it goes on after the last recorded action")
        return np.asarray(action)


@lru_cache(maxsize=1)
def _prepared(play: _Play) -> HeapEnv:
    """Return the environment, once for each process."""
    return HeapEnv(load_heaps(play.heaps).heaps, load_object_set(play.objects), play.config)
