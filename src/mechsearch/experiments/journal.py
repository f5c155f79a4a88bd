"""Which jobs began and ended when: data for who watches, on which no result depends."""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mechsearch.files import CHECK_MARK, append_line, line_of, record_of, write_text

SWEEP, BEGAN, ENDED, RAISED, FAILED = "sweep", "began", "ended", "raised", "failed"


@dataclass(frozen=True)
class Journal:
    """JSON lines, to which every process appends.

    Attributes:
        path: The file.
    """

    path: Path

    def write(self, event: str, **facts: Any) -> None:
        """Append an event."""
        append_line(self.path, {"event": event, "time": round(time.time(), 1), **facts})

    def records(self) -> list[dict[str, Any]]:
        """Return all events; a torn or damaged line is left out."""
        found = []
        text = self.path.read_text(encoding="utf-8", errors="replace") if self.path.exists() else ""
        # Earlier versions wrote no checksums.
        mark = CHECK_MARK if CHECK_MARK in text else ""
        for line in text.splitlines():
            with suppress(ValueError):
                record = record_of(line)
                if "event" in record and mark in line:
                    found.append(record)
        return found

    def begin(self, workers: int) -> None:
        """Note that a sweep begins: what was running before runs no longer."""
        kept = "".join(map(line_of, self.records()))
        write_text(self.path, kept)
        self.write(SWEEP, workers=workers)


@dataclass
class Past:
    """What a journal tells.

    Attributes:
        running: When each running job began, by name [s since the epoch].
        ended: Jobs that the present sweep has finished.
        failed: Why each job failed for good that was not tried again since, by name.
        seconds: How long each finished job took, by name.
        workers: Jobs at a time.
    """

    running: dict[str, float] = field(default_factory=dict)
    ended: set[str] = field(default_factory=set)
    failed: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    workers: int = 1

    @classmethod
    def of(cls, records: Iterable[dict[str, Any]]) -> "Past":
        """Read the events in their order."""
        past = cls()
        for record in records:
            past._take(record, str(record.get("job", "")))
        return past

    def _take(self, record: dict[str, Any], job: str) -> None:
        self.running.pop(job, None)
        event = record["event"]
        if event == SWEEP:
            self.running.clear()
            self.ended.clear()
            self.workers = int(record.get("workers", 1))
        elif event == BEGAN:
            self.running[job] = float(record.get("time", 0.0))
            self.failed.pop(job, None)
        elif event == ENDED:
            self.seconds[job] = float(record.get("seconds", 0.0))
            self.ended.add(job)
        elif event == FAILED:
            self.failed[job] = str(record.get("reason", ""))
