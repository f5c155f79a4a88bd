"""How thoroughly to measure."""

import time
from dataclasses import dataclass, field

from benchmarks.workload import Workload


@dataclass(frozen=True)
class Settings:
    """What all measurements share.

    Attributes:
        workload: Heaps and objects.
        heaps: For each object count.
        full: Whether to do what takes longer than a few minutes.
        began: When the first measurement began [s].
    """

    workload: Workload
    heaps: int = 12
    full: bool = False
    began: float = field(default_factory=time.perf_counter)

    def say(self, text: str) -> None:
        """Tell how far it is."""
        print(f"[{time.perf_counter() - self.began:6.1f} s] {text}", flush=True)
