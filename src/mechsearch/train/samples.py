"""Samples of observation and action, gathered from demonstrations, in memory."""

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mechsearch.agent.replay import require_memory
from mechsearch.train.demonstrations import Demonstration
from mechsearch.types import Array, MechSearchError


class Samples:
    """Observations and the actions an expert took there; grows by whole demonstrations."""

    def __init__(self, demonstrations: Sequence[Demonstration], keys: Sequence[str]) -> None:
        """Gather demonstrations.

        Raises:
            MechSearchError: If there are none, a key is missing, or they do not fit into memory.
        """
        if not demonstrations:
            raise MechSearchError("there is no demonstration to learn from")
        first = demonstrations[0].obs
        missing = [key for key in keys if key not in first]
        if missing:
            raise MechSearchError(
                f"the demonstrations lack {', '.join(missing)}; they have {', '.join(first)}"
            )
        size = sum(d.obs[key].nbytes for d in demonstrations for key in keys)
        require_memory(size, f"{sum(len(d.action) for d in demonstrations)} samples")
        self.obs = {key: np.concatenate([d.obs[key] for d in demonstrations]) for key in keys}
        self.action: NDArray[np.float32] = np.concatenate([d.action for d in demonstrations])
        self._added: list[Demonstration] = []

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.action) + sum(len(d.action) for d in self._added)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every observation."""
        return {key: value.shape[1:] for key, value in self.obs.items()}

    def add(self, demonstrations: Iterable[Demonstration]) -> None:
        """Append demonstrations."""
        self._added += demonstrations

    def draw(self, size: int, rng: np.random.Generator) -> tuple[dict[str, Tensor], Tensor]:
        """Return a batch of observations and actions, drawn uniformly with replacement."""
        return self.take(rng.integers(len(self), size=size))

    def take(self, rows: Array) -> tuple[dict[str, Tensor], Tensor]:
        """Return the samples of some rows, as a batch of tensors."""
        self._consolidate()
        obs = {key: torch.from_numpy(value[rows]) for key, value in self.obs.items()}
        return obs, torch.from_numpy(self.action[rows])

    def _consolidate(self) -> None:
        if self._added:
            parts, self._added = self._added, []
            for key in self.obs:
                self.obs[key] = np.concatenate([self.obs[key], *(d.obs[key] for d in parts)])
            self.action = np.concatenate([self.action, *(d.action for d in parts)])
