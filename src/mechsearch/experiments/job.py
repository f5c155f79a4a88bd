"""A piece of a sweep that can be redone by itself."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.plan import SweepPlan
from mechsearch.heaps.dataset import HeapSet, load_heaps


@dataclass(frozen=True)
class Job:
    """One unit of work; subclasses say which.

    A job that was cut off goes on, or begins anew, when it is carried out again.

    Attributes:
        plan: Of the sweep.
        folder: Where everything is kept.
        condition: "single" or "dual".
    """

    plan: SweepPlan
    folder: SweepFolder
    condition: str

    @property
    def name(self) -> str:
        """What tells it from the sweep's other jobs."""
        raise NotImplementedError

    @property
    def kind(self) -> str:
        """What the job is, in words; jobs of one kind are equally much dearer than their cost."""
        raise NotImplementedError

    @property
    def after(self) -> tuple[str, ...]:
        """Names of the jobs that must be done before."""
        return (f"{self.condition}/heaps",) if not self.plan.heap_file(self.condition) else ()

    @property
    def cost(self) -> float:
        """About how long it takes on one core of 2025 [s]; only ratios matter in the end."""
        raise NotImplementedError

    def is_done(self) -> bool:
        """Return whether its result is there.

        Raises:
            MechSearchError: If something else, or something damaged, is in its place.
        """
        raise NotImplementedError

    def carry_out(self) -> None:
        """Do it, in one thread.

        Raises:
            MechSearchError: If something else is in its place, or its inputs do not fit.
        """
        raise NotImplementedError

    @property
    def heaps(self) -> Path:
        """File of the condition's heap set."""
        return Path(self.plan.heap_file(self.condition) or self.folder.heaps(self.condition))

    @property
    def heap_set(self) -> HeapSet:
        """The condition's heap set."""
        state = self.heaps.stat()
        return _loaded(self.heaps, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4)
def _loaded(path: Path, modified: int, size: int) -> HeapSet:
    """Return a heap set, read once as long as its file stays the same."""
    return load_heaps(path)
