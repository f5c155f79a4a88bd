"""What one training episode and the updates during it came to, as one line of the log."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mechsearch.types import Array, Floats


class EpisodeLog:
    """Collects an episode's rewards, choices, beliefs and update metrics."""

    def __init__(self, heap: int, candidates: Sequence[str], gamma: float) -> None:
        """Begin an episode.

        Args:
            heap: Index of the heap.
            candidates: Names of who may act, the actor first.
            gamma: Discount of one action.
        """
        self._heap = heap
        self._candidates = tuple(candidates)
        self._gamma = gamma
        self._chosen: list[int] = []
        self._q: list[float] = []
        self._saturated: list[float] = []
        self._rewards: list[float] = []
        self._terms: defaultdict[str, float] = defaultdict(float)
        self._updates: list[Mapping[str, float]] = []

    def add(
        self,
        choice: int,
        q: float,
        actor_action: Array,
        reward: float,
        info: Mapping[str, Any],
    ) -> None:
        """Note one action: who chose it, its expected Q, and what the environment answered."""
        self._chosen.append(choice)
        self._q.append(q)
        self._saturated.append(float(np.mean(np.abs(actor_action) > 0.99)))
        self._rewards.append(reward)
        for name, value in info["reward_terms"].items():
            self._terms[name] += value

    def add_update(self, metrics: Mapping[str, float]) -> None:
        """Note what one update reported."""
        self._updates.append(metrics)

    def state(self) -> dict[str, Any]:
        """Return all that was noted, as JSON whose order matters, for `restore`."""
        return {
            "chosen": self._chosen,
            "q": self._q,
            "saturated": self._saturated,
            "rewards": self._rewards,
            "terms": self._terms,
            "updates": self._updates,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take back what `state` returned."""
        for name, noted in state.items():
            setattr(self, f"_{name}", noted)
        self._terms = defaultdict(float, state["terms"])

    def summary(self, terminated: bool, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the episode's line.

        `q` is the mean Q of the chosen actions and `return_followed` the mean discounted return
        that followed; where the episode was truncated, the critic's last Q stands for the rest.
        Shares are of actions, `saturated` of the actor's noise-free components beyond 0.99;
        update metrics are means over the episode, under `update_`.
        """
        followed = self._returns(0.0 if terminated else self._q[-1])
        count = len(self._rewards)
        shares = np.bincount(self._chosen, minlength=len(self._candidates)) / count
        return {
            "heap": self._heap,
            "end": info["end"],
            "occlusion": info["occlusion"],
            "actions": count,
            "return": float(np.sum(self._rewards)),
            **{f"term_{name}": value for name, value in self._terms.items()},
            "q": float(np.mean(self._q)),
            "return_followed": float(np.mean(followed)),
            "q_start": self._q[0],
            "return_start": float(followed[0]),
            "saturated": float(np.mean(self._saturated)),
            **{
                f"chosen_{name}": float(share)
                for name, share in zip(self._candidates, shares, strict=True)
            },
            **self._mean_updates(),
        }

    def _returns(self, tail: float) -> Floats:
        followed = np.empty(len(self._rewards))
        for i in reversed(range(len(followed))):
            tail = followed[i] = self._rewards[i] + self._gamma * tail
        return followed

    def _mean_updates(self) -> dict[str, float]:
        names = self._updates[0] if self._updates else ()
        return {
            f"update_{name}": float(np.mean([metrics[name] for metrics in self._updates]))
            for name in names
        }
