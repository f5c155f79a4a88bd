"""A store of demonstrations: one file for each episode, and a manifest that says of what."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.runs import read_arrays, read_record, write_record, write_whole
from mechsearch.types import Array, MechSearchError, Observation

FORMAT = 1
MANIFEST_FILE = "manifest.json"


@dataclass(frozen=True)
class Demonstration:
    """What an expert did in one episode of n actions.

    Attributes:
        obs: What an actor would have seen, by key (n, *shape).
        action: What the expert did (n, 3), in [-1, 1].
        simulated_actions: Actions tried in the simulator to find these, executed ones included.
        executed_actions: Actions that the expert executed.
        episode_return: Sum of the rewards of the episode.
    """

    obs: Mapping[str, Array]
    action: NDArray[np.float32]
    simulated_actions: int
    executed_actions: int
    episode_return: float

    def __post_init__(self) -> None:
        count = len(self.action)
        wrong = [key for key, value in self.obs.items() if len(value) != count]
        if wrong or np.shape(self.action) != (count, 3):
            what = f"{wrong[0]!r} of {len(self.obs[wrong[0]])}" if wrong else "actions"
            raise MechSearchError(
                f"a demonstration of {count} actions {np.shape(self.action)} has {what}; "
                "expected actions (n, 3) and n observations"
            )
        if not np.isfinite(self.action).all() or np.abs(self.action).max(initial=0) > 1:
            raise MechSearchError("a demonstrated action is not in [-1, 1]")

    @classmethod
    def of(
        cls,
        samples: Sequence[tuple[Observation, Array]],
        keys: Sequence[str],
        simulated_actions: int,
        executed_actions: int,
        episode_return: float,
    ) -> "Demonstration":
        """Return a demonstration from pairs of observation and action.

        Raises:
            MechSearchError: If there is no pair.
        """
        if not samples:
            raise MechSearchError("a demonstration needs at least one action")
        obs = {key: np.stack([seen[key] for seen, _ in samples]) for key in keys}
        action = np.stack([action for _, action in samples]).astype(np.float32)
        return cls(obs, action, simulated_actions, executed_actions, episode_return)


_FACTS = ("simulated_actions", "executed_actions", "episode_return")
assert {field.name for field in fields(Demonstration)} == {"obs", "action", *_FACTS}


class DemonstrationStore:
    """A folder of demonstrations, each under the name of its heap."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, facts: Mapping[str, Any]) -> None:
        """Create the store, or check that it is of the same facts (heap set, expert, camera).

        Raises:
            MechSearchError: If it is of others.
        """
        manifest = {"format": FORMAT, **facts}
        file = self.path / MANIFEST_FILE
        if not file.exists():
            write_record(file, "manifest of demonstrations", manifest)
            return
        found = self.facts()
        differing = [
            name for name in {**found, **manifest} if found.get(name) != manifest.get(name)
        ]
        if differing:
            name = differing[0]
            raise MechSearchError(
                f"the demonstrations at {self.path} are of {name} {found.get(name)!r}; "
                f"expected {manifest.get(name)!r}"
            )

    def facts(self) -> dict[str, Any]:
        """Return the manifest.

        Raises:
            MechSearchError: If there is none.
        """
        file = self.path / MANIFEST_FILE
        found = read_record(file, "manifest of demonstrations", ("format",))
        if found["format"] != FORMAT:
            raise MechSearchError(
                f"{file} is of demonstrations of format {found['format']}; this version reads "
                f"{FORMAT}"
            )
        return found

    def names(self) -> list[str]:
        """Return the names of all stored demonstrations, in order."""
        return sorted(file.stem for file in self.path.glob("[!.]*.npz"))

    def write(self, name: str, demonstration: Demonstration) -> None:
        """Store one demonstration, whole or not at all."""
        arrays: dict[str, Array] = {f"obs.{key}": v for key, v in demonstration.obs.items()}
        arrays |= {fact: np.array(getattr(demonstration, fact)) for fact in _FACTS}
        arrays["action"] = demonstration.action

        def write(partial: Path) -> None:
            with partial.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)

        write_whole(self.path / f"{name}.npz", write)

    def read(self, name: str) -> Demonstration:
        """Read one demonstration.

        Raises:
            MechSearchError: If it is missing or damaged.
        """
        path = self.path / f"{name}.npz"
        arrays = read_arrays(path, "demonstration")
        try:
            return Demonstration(
                {k.removeprefix("obs."): v for k, v in arrays.items() if k.startswith("obs.")},
                arrays["action"],
                *(arrays[fact].item() for fact in _FACTS),
            )
        except (ValueError, KeyError, TypeError, MechSearchError) as error:
            raise MechSearchError(f"the demonstration at {path} is damaged: {error}") from None

    def read_all(self, limit: int = 0) -> list[Demonstration]:
        """Read `limit` demonstrations, spread evenly over the store, or all.

        Raises:
            MechSearchError: If the store has no manifest, or fewer of them.
        """
        self.facts()
        names = self.names()
        if not names or limit > len(names):
            raise MechSearchError(
                f"{self.path} holds {len(names)} demonstrations; expected at least {max(limit, 1)}"
            )
        return [self.read(names[i]) for i in evenly_spread(len(names), limit or len(names))]


def evenly_spread(count: int, chosen: int) -> list[int]:
    """Return `chosen` of the indices below `count`, evenly spread.

    Heaps are kept by object count, so an even spread has all counts alike.
    """
    return [i * count // chosen for i in range(chosen)]
