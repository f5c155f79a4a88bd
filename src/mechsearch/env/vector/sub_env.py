"""One environment of many, as the process that asks sees it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from mechsearch.env.vector.hosting import Acted, Begin, Begun
from mechsearch.processes import Failure
from mechsearch.types import Array, MechSearchError

STRIKES = 2
"""A heap on which so many workers failed is quarantined."""

MOST_FAILED_STARTS = 10
"""Failures in a row to begin an episode, on several heaps, after which no more are tried."""


class Quarantine:
    """Counts the failures on each heap.

    Attributes:
        names: Seed of each quarantined heap, and why its last worker failed.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        """Take the heaps' seeds."""
        self._seeds = seeds
        self._strikes: Counter[int] = Counter()
        self.names: dict[int, str] = {}

    def __contains__(self, heap: int) -> bool:
        """Whether a heap, by its index, is quarantined."""
        return self._strikes[heap] >= STRIKES

    def strike(self, heap: int, reason: str) -> int | None:
        """Count a failure; return the heap's seed if it is quarantined now."""
        self._strikes[heap] += 1
        if heap not in self:
            return None
        self.names[self._seeds[heap]] = reason
        return self._seeds[heap]

    def draw(self, rng: np.random.Generator, heap: int | None = None) -> int:
        """Return the index of the heap that was asked for, or of one drawn as `HeapEnv.reset` does.

        Raises:
            MechSearchError: If it is quarantined, or all are.
        """
        count = len(self._seeds)
        if heap is not None:
            if heap in self:
                name = self._seeds[heap]
                reason = f"{self.names[name]}, {STRIKES} times"
                raise MechSearchError(f"heap {heap} (seed {name}) is quarantined: {reason}")
            return heap
        if len(self.names) == count:
            name, reason = list(self.names.items())[-1]
            raise MechSearchError(f"all {count} heaps are quarantined; the last, {name}: {reason}")
        while (drawn := int(rng.integers(count))) in self:
            pass
        return drawn


class SubEnv:
    """Makes an environment's requests, and takes the replies.

    All its randomness is here, so that its episodes depend neither on its worker nor on others.

    Attributes:
        kept: Its last trusted observation.
        rng: Its generator; None before the first reset.
        over: Whether it must be reset before the next action.
        result: What the last action or reset led to.
    """

    def __init__(
        self,
        env: int,
        shared: Mapping[str, Array],
        kept: Mapping[str, Array],
        quarantine: Quarantine,
        same_step: bool,
        no_reward: Mapping[str, float],
    ) -> None:
        """Begin without an episode.

        Args:
            env: Which environment.
            shared: Where the workers write all environments' observations (num_envs, ...).
            kept: Where they are kept.
            quarantine: Of the heaps, shared by all environments.
            same_step: Whether an episode that is over is followed by the next in the same step.
            no_reward: The reward's terms where a worker failed.
        """
        self.kept = {key: rows[env] for key, rows in kept.items()}
        self._shared = {key: rows[env] for key, rows in shared.items()}
        self.rng: np.random.Generator | None = None
        self.over = True
        self.result = Acted(0.0, False, False, {})
        self._env, self._quarantine = env, quarantine
        self._same_step, self._no_reward = same_step, no_reward
        self._heap = 0
        self._beginning: Begin | None = None
        self._failed_starts = 0

    def reset(self, seed: int | None, options: Mapping[str, Any]) -> Begin:
        """Return the request that begins an episode.

        Raises:
            MechSearchError: If the options choose a heap that does not exist or is quarantined.
        """
        if seed is not None or self.rng is None:
            self.rng, _ = seeding.np_random(seed)
        self.result, self.over = Acted(0.0, False, False, {}), True
        return self._begin(options)

    def take(self, value: Begun | Acted | Failure) -> Begin | None:
        """Take a reply; return what must be asked before the turn's outcome is complete.

        Raises:
            MechSearchError: If no episode can begin.
        """
        if self._beginning is not None:
            return self._take_begun(self._beginning, value)
        if isinstance(value, Failure):
            value = self._failed(value)
        else:
            self._keep()
        assert isinstance(value, Acted)
        self.result = value
        self.over = value.terminated or value.truncated
        return self._begin_next() if self.over and self._same_step else None

    def _begin(self, options: Mapping[str, Any], failed_starts: int = 0) -> Begin:
        assert self.rng is not None
        self._failed_starts = failed_starts
        heap = self._quarantine.draw(self.rng, options.get("heap"))
        self._beginning = Begin(self._env, heap, self.rng, options)
        return self._beginning

    def _begin_next(self) -> Begin:
        """Begin the next episode in the same step; what the last one ended with stays in `info`."""
        info = self.result.info
        final: dict[str, Any] = {key: row.copy() for key, row in self.kept.items()}
        failed = {k: info[k] for k in ("failure", "quarantined") if info.get(k) is not None}
        shown = {"final_obs": final, "final_info": info, **failed}
        self.result = self.result._replace(info=shown)
        return self._begin({})

    def _take_begun(self, begin: Begin, value: Begun | Acted | Failure) -> Begin | None:
        if isinstance(value, Failure):
            return self._begin_again(begin, value)
        assert isinstance(value, Begun)
        self._keep()
        self._beginning, self.over = None, False
        self.rng, self._heap = value.rng, begin.heap
        self.result.info.update(value.info)
        return None

    def _begin_again(self, begin: Begin, failure: Failure) -> Begin:
        """Return the same request, or one for another heap if the first is quarantined now."""
        self._failed_starts += 1
        name = self._quarantine.strike(begin.heap, failure.reason)
        if name is None:
            return begin
        self._beginning = None
        self.result.info["quarantined"] = name
        if self._failed_starts >= MOST_FAILED_STARTS:
            raise MechSearchError(
                f"no episode begins, tried {self._failed_starts} times; the last time on heap "
                f"{name}: {failure.reason}"
            )
        return self._begin(begin.options, self._failed_starts)

    def _failed(self, failure: Failure) -> Acted:
        """Return the end of an episode whose worker failed: truncated, without reward."""
        info = {
            "reward_terms": dict(self._no_reward),
            "occlusion": self.result.info["occlusion"],
            "end": f"failure: {failure.reason}",
            "failure": failure.reason,
            "clutter_moved": 0.0,
            "target_moved": 0.0,
        }
        name = self._quarantine.strike(self._heap, failure.reason)
        return Acted(0.0, False, True, info | ({"quarantined": name} if name is not None else {}))

    def _keep(self) -> None:
        for key, row in self.kept.items():
            np.copyto(row, self._shared[key])
