"""How fast a run goes."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Speed:
    """Measures actions and updates between two laps."""

    def __init__(self, step: int, updates: int = 0) -> None:
        """Start the clock at a step of the run."""
        self._step, self._updates = step, updates
        self._began = time.perf_counter()
        self._updating = 0.0

    @contextmanager
    def updating(self) -> Iterator[None]:
        """Count what happens inside as gradient steps."""
        began = time.perf_counter()
        yield
        self._updating += time.perf_counter() - began

    def lap(self, step: int, updates: int) -> dict[str, float]:
        """Return the speeds since the last lap: `updates_per_s` counts update time alone."""
        seconds = time.perf_counter() - self._began
        done = updates - self._updates
        speeds = {
            "seconds": seconds,
            "actions_per_s": (step - self._step) / seconds,
            "updates_per_s": done / self._updating if self._updating else 0.0,
        }
        self._step, self._updates, self._updating = step, updates, 0.0
        self._began = time.perf_counter()
        return speeds
