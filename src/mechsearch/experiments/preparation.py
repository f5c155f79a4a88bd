"""What runs are made from: heap sets."""

from dataclasses import dataclass

from mechsearch.experiments.job import Job
from mechsearch.heaps.generate import generate
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Heaps(Job):
    """Generates a heap set where none is given."""

    @property
    def name(self) -> str:
        """Such as "single/heaps"."""
        return f"{self.condition}/heaps"

    @property
    def kind(self) -> str:
        """A heap set."""
        return "heap sets"

    @property
    def after(self) -> tuple[str, ...]:
        """Nothing."""
        return ()

    @property
    def cost(self) -> float:
        """A quarter of a second for each heap."""
        return 0.25 * self.plan.generated(self.condition).heaps

    def is_done(self) -> bool:
        """Return whether the heap set is there."""
        if not self.heaps.exists():
            return False
        config = self.plan.generated(self.condition)
        found = self.heap_set.manifest["config"]
        names = ("condition", "heaps", "objects", "seed")
        if any(found[name] != getattr(config, name) for name in names):
            raise MechSearchError(f"{self.heaps} is not of this sweep; move it away")
        return True

    def carry_out(self) -> None:
        """Generate it; what was generated before it was cut off is kept."""
        generate(self.plan.generated(self.condition), self.heaps)
