"""Replay that stores every frame once: a transition is a row, its next observation the next row."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mechsearch.types import Array, MechSearchError, Observation


@dataclass(frozen=True)
class Batch:
    """Transitions drawn from the replay.

    Attributes:
        obs: Observations by key, (B, *shape), as stored.
        action: Executed actions (B, 3) in [-1, 1].
        reward: What the actions earned (B,).
        discount: What multiplies the value of `next_obs` (B,): 0 after a termination.
        next_obs: Observations afterwards.
        taught: Whether a teacher acted, in an episode that went well (B,).
    """

    obs: dict[str, Array]
    action: NDArray[np.float32]
    reward: NDArray[np.float32]
    discount: NDArray[np.float32]
    next_obs: dict[str, Array]
    taught: NDArray[np.bool_]


class Replay:
    """A ring of rows in time order. An episode of n actions takes n + 1 rows.

    A row holds an observation and, unless it is the last of its episode, the transition that
    begins there. A transition can be drawn as soon as its next row is written.
    """

    def __init__(
        self,
        shapes: Mapping[str, tuple[int, ...]],
        dtypes: Mapping[str, DTypeLike],
        capacity: int,
        worst: float = 0.0,
    ) -> None:
        """Reserve the rows.

        Args:
            shapes: Of each observation key.
            dtypes: Likewise.
            capacity: Number of rows.
            worst: Share of all that was done, that of the episodes of lowest return, from which
                nothing is `taught`.

        Raises:
            MechSearchError: If they do not fit into the machine's memory.
        """
        if capacity < 2:
            raise MechSearchError(f"a replay of {capacity} rows; expected at least 2")
        row = sum(int(np.prod(shapes[key])) * np.dtype(dtypes[key]).itemsize for key in shapes)
        require_memory(row * capacity, f"a replay of {capacity} rows")
        self.capacity = capacity
        self.obs = {k: np.zeros((capacity, *shapes[k]), dtypes[k]) for k in shapes}
        self.action = np.zeros((capacity, 3), np.float32)
        self.reward = np.zeros(capacity, np.float32)
        self.discount = np.zeros(capacity, np.float32)
        self.guided = np.zeros(capacity, bool)
        self.outcome = np.full(capacity, np.nan, np.float32)
        self.complete = np.zeros(capacity, bool)
        self.worst = worst
        self._cursor, self._pending, self._begun = 0, -1, 0
        self._good = -np.inf

    def __len__(self) -> int:
        """Number of transitions that can be drawn."""
        return int(self.complete.sum())

    def add(
        self,
        obs: Observation,
        action: NDArray[np.float32],
        reward: float,
        discount: float,
        guided: bool = False,
    ) -> None:
        """Store a transition; the next call of `add` or `end` stores where it led.

        Args:
            obs: Where it began.
            action: What was executed (3,), in [-1, 1].
            reward: What it earned.
            discount: 0 if the episode terminated, else the discount factor.
            guided: Whether a teacher acted who may be imitated.
        """
        if self._pending < 0:
            self._begun = self._cursor
        row = self._write(obs)
        self.action[row], self.reward[row], self.discount[row] = action, reward, discount
        self.guided[row] = guided
        self._pending = row

    def end(self, obs: Observation, whole: bool = True) -> None:
        """Store the last observation of an episode, terminated or truncated.

        Args:
            obs: The observation.
            whole: Whether the episode was not cut off by a failure, so that its return counts.
        """
        if self._pending >= 0 and whole:
            length = (self._cursor - self._begun) % self.capacity
            rows = (self._begun + np.arange(length)) % self.capacity
            self.outcome[rows] = self.reward[rows].sum()
        self._write(obs)
        self._pending = -1
        self._judge()

    def _judge(self) -> None:
        """Find the return from which on an episode has gone well."""
        known = self.outcome[self.complete & ~np.isnan(self.outcome)]
        if len(known):
            self._good = float(np.quantile(known, self.worst))

    def _write(self, obs: Observation) -> int:
        row = self._cursor
        if self._pending >= 0:
            self.complete[self._pending] = True
        self.complete[row], self.outcome[row] = False, np.nan
        for key, store in self.obs.items():
            store[row] = obs[key]
        self._cursor = (row + 1) % self.capacity
        return row

    def sample(self, size: int, rng: np.random.Generator) -> Batch:
        """Draw transitions uniformly, with replacement.

        Args:
            size: Number of transitions B.
            rng: Source of randomness.

        Raises:
            MechSearchError: If there is nothing to draw from.
        """
        rows = np.flatnonzero(self.complete)
        if not len(rows):
            raise MechSearchError("the replay holds no complete transition yet")
        start = rng.choice(rows, size)
        after = (start + 1) % self.capacity
        return Batch(
            {key: store[start] for key, store in self.obs.items()},
            self.action[start],
            self.reward[start],
            self.discount[start],
            {key: store[after] for key, store in self.obs.items()},
            self.guided[start] & (self.outcome[start] >= self._good),
        )

    def state(self) -> dict[str, Array]:
        """Return all that is stored, for a checkpoint; arrays are views."""
        used = self.capacity if self.complete[self._cursor :].any() else self._cursor
        stored = {f"obs.{key}": store[:used] for key, store in self.obs.items()}
        for name in _NAMES:
            stored[name] = getattr(self, name)[:used]
        return {**stored, "place": np.array([self._cursor, self._pending, self._begun])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take back what `state` returned.

        Raises:
            MechSearchError: If it was stored with other observations or more rows.
        """
        expected = {f"obs.{key}" for key in self.obs} | set(_NAMES) | {"place"}
        if set(state) != expected:
            raise MechSearchError(
                f"the stored replay has {', '.join(sorted(state))}; "
                f"expected {', '.join(sorted(expected))}"
            )
        targets = {f"obs.{key}": store for key, store in self.obs.items()}
        targets |= {name: getattr(self, name) for name in _NAMES}
        for name, target in targets.items():
            stored = state[name]
            if stored.shape[1:] != target.shape[1:] or len(stored) > self.capacity:
                raise MechSearchError(
                    f"the stored replay's {name} is {stored.shape}; expected at most {target.shape}"
                )
            target[: len(stored)] = stored
        self._cursor, self._pending, self._begun = (int(value) for value in state["place"])
        self._judge()


_NAMES = ("action", "reward", "discount", "guided", "outcome", "complete")


def require_memory(size: int, purpose: str) -> None:
    """Refuse what cannot fit.

    Args:
        size: Needed [bytes].
        purpose: What for.

    Raises:
        MechSearchError: If the machine has less free memory.
    """
    free = _available_memory()
    if size > free:
        raise MechSearchError(
            f"{purpose} needs {size / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB are free; "
            "expected fewer rows or smaller images"
        )


def _available_memory() -> int:
    """Return what can be had without swapping [bytes]; caches that can be dropped count."""
    table = Path("/proc/meminfo")
    if table.exists():
        for line in table.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
