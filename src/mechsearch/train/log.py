"""A run's metrics: JSON lines, which are the truth, and TensorBoard beside them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from mechsearch.runs import append_line, read_lines, write_whole

METRICS_FILE = "metrics.jsonl"
SPEED_FILE = "speed.jsonl"


class RunLog:
    """Appends records to a run directory.

    `metrics.jsonl` holds what the seed decides, so that two equal runs write the same bytes;
    `speed.jsonl` holds what depends on the machine.
    """

    def __init__(self, directory: Path, step: int = 0) -> None:
        """Open the log at a step; records of later steps, which will come again, are dropped."""
        directory.mkdir(parents=True, exist_ok=True)
        self._directory = directory
        for name in (METRICS_FILE, SPEED_FILE):
            _drop_after(directory / name, step)
        events = str(directory / "tensorboard")
        self._events = SummaryWriter(events, purge_step=step + 1 if step else None)

    def write(self, kind: str, step: int, values: Mapping[str, Any]) -> None:
        """Append what was found at a step: text and numbers; numbers become curves."""
        append_line(self._directory / METRICS_FILE, {"step": step, "kind": kind, **values})
        self._draw(kind, step, values)

    def write_speed(self, step: int, values: Mapping[str, float]) -> None:
        """Append how fast the machine was."""
        append_line(self._directory / SPEED_FILE, {"step": step, **values})
        self._draw("speed", step, values)

    def _draw(self, kind: str, step: int, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if isinstance(value, int | float):
                self._events.add_scalar(f"{kind}/{name}", value, step)

    def close(self) -> None:
        """Finish the TensorBoard file."""
        self._events.close()


def _drop_after(path: Path, step: int) -> None:
    """Keep what was logged up to a step; a run that begins anew keeps nothing."""
    if not path.exists():
        return
    kept = [record for record in read_lines(path) if step and record["step"] <= step]
    text = "".join(json.dumps(record) + "\n" for record in kept)

    def write(partial: Path) -> None:
        partial.write_text(text, encoding="utf-8")

    write_whole(path, write)
