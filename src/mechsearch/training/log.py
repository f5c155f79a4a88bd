"""A run's metrics: JSON lines, which are the truth, and TensorBoard beside them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from mechsearch.files import (
    EVENTS_FOLDER,
    METRICS_FILE,
    SPEED_FILE,
    append_line,
    line_of,
    naming,
    read_lines,
    write_text,
    write_whole,
)
from mechsearch.files.tensors import Archive
from mechsearch.types import MechSearchError


class RunLog:
    """Appends records to a run directory.

    `metrics.jsonl` holds what the seed decides, so that two equal runs write the same bytes;
    `speed.jsonl` holds what depends on the machine.
    """

    def __init__(self, directory: Path, checkpoint: Archive | None = None) -> None:
        """Open the log as it was at a checkpoint; what came later will come again.

        Raises:
            MechSearchError: If lines of before the checkpoint are missing or damaged.
        """
        step, size = (checkpoint.meta[name] if checkpoint else 0 for name in ("step", "logged"))
        self._directory = directory
        _cut(directory / METRICS_FILE, size)
        _drop_after(directory / SPEED_FILE, step)
        events = str(directory / EVENTS_FOLDER)
        with naming(directory / EVENTS_FOLDER):
            self._events = SummaryWriter(events, purge_step=step + 1 if step else None)

    @property
    def size(self) -> int:
        """Length of the metrics [bytes], for a checkpoint."""
        file = self._directory / METRICS_FILE
        return file.stat().st_size if file.exists() else 0

    def write(self, kind: str, step: int, values: Mapping[str, Any]) -> None:
        """Append what was found at a step: text and numbers; numbers become curves.

        What is of the kind "speed" depends on the machine, and has a file of its own.
        """
        if kind == "speed":
            append_line(self._directory / SPEED_FILE, {"step": step, **values})
        else:
            append_line(self._directory / METRICS_FILE, {"step": step, "kind": kind, **values})
        with naming(self._directory / EVENTS_FOLDER):
            for name, value in values.items():
                if isinstance(value, int | float):
                    self._events.add_scalar(f"{kind}/{name}", value, step)

    def close(self) -> None:
        """Finish the TensorBoard file."""
        with naming(self._directory / EVENTS_FOLDER):
            self._events.close()


def _cut(path: Path, size: int) -> None:
    """Keep the first `size` bytes of a log, which must be whole and sound."""
    content = path.read_bytes() if path.exists() else b""
    if len(content) < size:
        raise MechSearchError(
            f"{path} has {len(content)} bytes, and had {size} at the run's last checkpoint: lines "
            "are missing; bring the file back, or begin the run anew in another folder"
        )
    if content:
        write_whole(path, lambda partial: partial.write_bytes(content[:size]))
    for _ in read_lines(path):
        pass


def _drop_after(path: Path, step: int) -> None:
    if path.exists():
        kept = (record for record in read_lines(path) if step and record["step"] <= step)
        write_text(path, "".join(map(line_of, kept)))
