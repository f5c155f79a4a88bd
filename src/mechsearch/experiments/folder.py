"""Where everything of a sweep is kept."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SweepFolder:
    """The layout of a sweep on disk; nothing is read or written here."""

    path: Path

    @property
    def lock(self) -> Path:
        """What a sweep at work holds locked."""
        return self.path / "sweep"

    @property
    def plan(self) -> Path:
        """What is to be carried out."""
        return self.path / "sweep.json"

    @property
    def journal(self) -> Path:
        """Which jobs began and ended when."""
        return self.path / "jobs.jsonl"

    @property
    def summary(self) -> Path:
        """Scores of all finished evaluations."""
        return self.path / "summary.csv"

    @property
    def curves(self) -> Path:
        """Learning curves of all finished runs."""
        return self.path / "curves.csv"

    def heaps(self, condition: str) -> Path:
        """Return where a heap set is generated, if none was given."""
        return self.path / condition / "heaps.parquet"

    def run(self, condition: str, variant: str, seed: int) -> Path:
        """Return a run directory."""
        return self.path / condition / "runs" / f"{variant}-seed{seed}"

    def evaluations(self, condition: str) -> Path:
        """Return the folder of a condition's recorded episodes."""
        return self.path / condition / "evaluations"
