"""Recorded episodes: what happened, action by action, and the file that keeps them."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.files import ARRAY_DAMAGE, read_arrays, write_whole
from mechsearch.heaps.heap import evenly_spread
from mechsearch.types import Array, Floats, MechSearchError

EPISODE_FORMAT = 1
UNCOVERED = "uncovered"
_STATES = ("ee_positions", "occlusions", "poses")
_STEPS = ("actions", "clutter_moved", "target_moved")


@dataclass(frozen=True)
class GraspRecord:
    """What a gripper could do with the target before and after an episode.

    Attributes:
        before: Graspability at the beginning, in [0, 1].
        after: At the end, at rest and the robot out of the way; 0 if the target is lost.
        alone: At the beginning, all clutter removed.
        lift_before: What the best grasp came to at the beginning: "success" or a failure's name;
            empty where there was no grasp to try.
        lift_after: Likewise at the end.
    """

    before: float
    after: float
    alone: float
    lift_before: str
    lift_after: str


@dataclass(frozen=True)
class EpisodeRecord:
    """One episode of T actions among N objects.

    Attributes:
        heap_seed: Seed of the heap, which names it in its set.
        count: Objects in each heap: N for "single", N / 2 for "dual".
        condition: Such as "single" or "dual".
        policy: Who acted.
        objects: Names of the N objects.
        target: Index of the target among them.
        actions: Commands (T, 3) in [-1, 1], workspace axes.
        ee_positions: End effector (T + 1, 3) [m], the start first.
        occlusions: Share of the target's projection that is hidden (T + 1,), in [0, 1].
        poses: Object poses (T + 1, N, 7): position [m], unit quaternion (w, x, y, z).
        reward_terms: Each named reward term (T,).
        clutter_moved: Mean displacement of the other objects in each action (T,) [m].
        target_moved: Displacement of the target in each action (T,) [m].
        end: "uncovered", "action limit", "lost" or "failure: reason".
        action_limit: Number of actions after which the episode would have been cut.
        grasp: What a gripper could do with the target; None where it was not measured.
    """

    heap_seed: int
    count: int
    condition: str
    policy: str
    objects: tuple[str, ...]
    target: int
    actions: NDArray[np.float32]
    ee_positions: Floats
    occlusions: Floats
    poses: Floats
    reward_terms: Mapping[str, Floats]
    clutter_moved: Floats
    target_moved: Floats
    end: str
    action_limit: int
    grasp: GraspRecord | None = None

    def __post_init__(self) -> None:
        t, n = len(self.actions), len(self.objects)
        expected = {
            "actions": (t, 3),
            "ee_positions": (t + 1, 3),
            "occlusions": (t + 1,),
            "poses": (t + 1, n, 7),
            "clutter_moved": (t,),
            "target_moved": (t,),
        }
        shapes = {name: np.shape(getattr(self, name)) for name in expected}
        shapes |= {name: np.shape(term) for name, term in self.reward_terms.items()}
        expected |= dict.fromkeys(self.reward_terms, (t,))
        for name, shape in shapes.items():
            if shape != expected[name]:
                raise MechSearchError(
                    f"{name} of the episode on heap {self.heap_seed} is {shape}; "
                    f"expected {expected[name]} for {t} actions and {n} objects"
                )
        if not 0 <= self.target < n:
            raise MechSearchError(f"target {self.target} is not one of {n} objects")

    @property
    def uncovered(self) -> bool:
        """Whether the target ended completely visible."""
        return self.end == UNCOVERED

    @property
    def rewards(self) -> Floats:
        """The reward of each action (T,), the sum of its terms."""
        total = np.zeros(len(self.actions))
        for term in self.reward_terms.values():
            total = total + term
        return total


@dataclass(frozen=True)
class Evaluation:
    """One policy on a set of heaps.

    Attributes:
        header: How the episodes came about: JSON values under text keys.
        episodes: In the order of the heaps.
    """

    header: Mapping[str, Any]
    episodes: tuple[EpisodeRecord, ...]


def save_episodes(path: Path, evaluation: Evaluation) -> None:
    """Write an evaluation as one `.npz`, whole or not at all.

    The same episodes give the same bytes.

    Raises:
        MechSearchError: If there is no episode, or their reward terms differ.
    """
    episodes = evaluation.episodes
    if not episodes:
        raise MechSearchError("there is no episode to save; expected at least one")
    terms = tuple(episodes[0].reward_terms)
    if any(tuple(episode.reward_terms) != terms for episode in episodes):
        raise MechSearchError("the episodes have different reward terms; expected the same in all")
    text = {
        "format": EPISODE_FORMAT,
        "header": dict(evaluation.header),
        "terms": terms,
        "episodes": [_description(episode) for episode in episodes],
    }
    arrays: dict[str, Array] = {"text": np.array(json.dumps(text, sort_keys=True))}
    for name in _STATES + _STEPS:
        arrays[name] = _joined(getattr(episode, name) for episode in episodes)
    for term in terms:
        arrays[f"term_{term}"] = _joined(episode.reward_terms[term] for episode in episodes)

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_whole(path, write)


def load_some(path: Path, limit: int) -> Evaluation:
    """Read an evaluation, and keep so many of its episodes, evenly spread; all for 0.

    Raises:
        MechSearchError: As `load_episodes`, or if there are not so many.
    """
    evaluation = load_episodes(path)
    count = len(evaluation.episodes)
    if not 0 <= limit <= count:
        raise MechSearchError(f"limit is {limit}; {path} has {count} episodes")
    chosen = tuple(evaluation.episodes[i] for i in evenly_spread(count, limit or count))
    return Evaluation(evaluation.header, chosen)


def load_episodes(path: Path) -> Evaluation:
    """Read what `save_episodes` wrote; nothing in the file is ever run.

    Raises:
        MechSearchError: If the file is missing, damaged, or not an evaluation.
    """
    if path.is_dir():
        raise MechSearchError(f"{path} is a folder; expected an evaluation (.npz)")
    arrays = read_arrays(path, "evaluation")
    try:
        text = json.loads(str(arrays["text"]))
        if text["format"] != EPISODE_FORMAT:
            raise MechSearchError(
                f"{path} has episode format {text['format']}; this version reads {EPISODE_FORMAT}"
            )
        return Evaluation(text["header"], tuple(_split(arrays, text)))
    except ARRAY_DAMAGE as error:
        raise MechSearchError(f"{path} is damaged or no evaluation: {error}") from None


def _description(episode: EpisodeRecord) -> dict[str, Any]:
    names = ("heap_seed", "count", "condition", "policy", "target", "end", "action_limit")
    values = {name: getattr(episode, name) for name in names}
    if episode.grasp is not None:
        values["grasp"] = asdict(episode.grasp)
    return values | {"objects": list(episode.objects), "length": len(episode.actions)}


def _joined(parts: Iterable[Array]) -> Array:
    rows = list(parts)
    width = rows[0].shape[-1:] if rows[0].ndim > 1 else ()
    return np.concatenate([row.reshape(-1, *width) for row in rows])


def _split(arrays: Mapping[str, Array], text: Mapping[str, Any]) -> Iterable[EpisodeRecord]:
    """Yield the episodes that `_joined` laid end to end."""
    descriptions: Sequence[dict[str, Any]] = text["episodes"]
    lengths = np.array([episode["length"] for episode in descriptions])
    sizes = {name: lengths + 1 for name in _STATES}
    sizes["poses"] = (lengths + 1) * [len(episode["objects"]) for episode in descriptions]
    pieces = {
        name: np.split(rows, np.cumsum(sizes.get(name, lengths))[:-1])
        for name, rows in arrays.items()
        if name != "text"
    }
    for i, description in enumerate(descriptions):
        length, objects = description["length"], tuple(description["objects"])
        yield EpisodeRecord(
            heap_seed=description["heap_seed"],
            count=description["count"],
            condition=description["condition"],
            policy=description["policy"],
            objects=objects,
            target=description["target"],
            actions=pieces["actions"][i],
            ee_positions=pieces["ee_positions"][i],
            occlusions=pieces["occlusions"][i],
            poses=pieces["poses"][i].reshape(length + 1, len(objects), 7),
            reward_terms={term: pieces[f"term_{term}"][i] for term in text["terms"]},
            clutter_moved=pieces["clutter_moved"][i],
            target_moved=pieces["target_moved"][i],
            end=description["end"],
            action_limit=description["action_limit"],
            grasp=GraspRecord(**description["grasp"]) if "grasp" in description else None,
        )
