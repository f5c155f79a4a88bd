"""What runs are made from: heap sets and demonstrations."""

from dataclasses import asdict, dataclass

from mechsearch.experiments.job import Job
from mechsearch.heaps.generate import generate
from mechsearch.train.demonstrations import MANIFEST_FILE, DemonstrationStore
from mechsearch.train.expert import DemonstrateConfig, demonstrate, missing
from mechsearch.types import MechSearchError

DEMONSTRATED_AT_ONCE = 20
"""Heaps demonstrated in one job."""


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


@dataclass(frozen=True)
class Demonstrations(Job):
    """Demonstrates some training heaps, for the variants that imitate.

    Attributes:
        first: Index of the first heap, in an order where object counts alternate.
    """

    first: int

    @property
    def name(self) -> str:
        """Such as "single/demonstrations-0040"."""
        return f"{self.condition}/demonstrations-{self.first:04d}"

    @property
    def kind(self) -> str:
        """Demonstrations."""
        return "demonstrations"

    @property
    def cost(self) -> float:
        """A few seconds for each heap."""
        return 2.5 * self._config.count

    @property
    def _config(self) -> DemonstrateConfig:
        count = min(DEMONSTRATED_AT_ONCE, self.plan.demonstrations - self.first)
        return DemonstrateConfig(self.heaps, self._objects, self.first, count)

    @property
    def _objects(self) -> str:
        return self.plan.objects or str(self.heap_set.manifest["config"]["objects"])

    def is_done(self) -> bool:
        """Return whether each of the heaps has a demonstration, or a failure that says why not."""
        place = self.folder.demonstrations(self.condition)
        if not self.heaps.exists() or not (place / MANIFEST_FILE).exists():
            return False
        config, facts = self._config, DemonstrationStore(place).facts()
        wanted = {"heap_set": self.heap_set.hash, "look_ahead": asdict(config.look_ahead)}
        if any(facts.get(name) != value for name, value in wanted.items()):
            raise MechSearchError(f"{place} is not of this sweep; move it away")
        return not missing(config, self.heap_set, place)

    def carry_out(self) -> None:
        """Demonstrate those that are missing."""
        demonstrate(self._config, self.folder.demonstrations(self.condition))
