"""How long work is told of: not at all, or by a line with rate and time left."""

import shutil
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Protocol, TextIO

_WINDOW = 30.0
"""Time over which a rate is measured [s]."""

_REDRAWN, _REPEATED = 0.1, 30.0
"""Least time between two states of a line on a terminal, and between two lines in a file [s]."""

_BAR = 24


class Progress(Protocol):
    """Shown while something long goes on."""

    def __call__(self, label: str, done: int, total: int) -> None:
        """Tell that `done` of `total` pieces of `label` are finished."""


def silent(label: str, done: int, total: int) -> None:
    """Show nothing."""


@contextmanager
def bars() -> Iterator[Progress]:
    """Show progress on the error stream while inside, once there is any; yields how to tell it.

    On a terminal a line is drawn again and again; in a file another follows every half a minute.
    The first word of a label, up to a comma, names what goes on; what follows may change, such as
    the last scores.
    """
    display = _Display(sys.stderr)
    try:
        yield display
    finally:
        display.end_line()


class _Display:
    """One line about what goes on now."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._moving = stream, stream.isatty()
        self._told: dict[str, deque[tuple[float, int]]] = {}
        self._over: set[str] = set()
        self._drawn, self._open, self._label = -_REPEATED, False, ""

    def __call__(self, label: str, done: int, total: int) -> None:
        """Take what was told, and show it if it is time to."""
        now, name = time.monotonic(), label.split(",")[0]
        if name != self._label.split(",")[0]:
            self.end_line()
        # A resumed run begins in the middle: what was done before is not its rate.
        told = self._told.setdefault(name, deque())
        told.append((now, done))
        while len(told) > 2 and now - told[0][0] > _WINDOW:
            told.popleft()
        wait = _REDRAWN if self._moving else _REPEATED
        # What is begun now may take long.
        anew = len(told) == 1 or (self._moving and label != self._label)
        if done < total and now - self._drawn < wait and not anew:
            return
        if done >= total and not self._moving:
            if name in self._over:
                return
            self._over.add(name)
        self._drawn, self._label = now, label
        text = f"{label}  {_state(told, total)}"
        if self._moving:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write(f"\r{_fitted(label, text, width)}\x1b[K")
            self._open = True
        else:
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end_line(self) -> None:
        """Leave what is shown as it is, and go on below."""
        if self._open:
            self._stream.write("\n")
            self._stream.flush()
        self._open = False


def _fitted(label: str, text: str, width: int) -> str:
    """Return a text of a width, cut where its label ends."""
    spare = max(len(label) - max(len(text) - width, 0), 0)
    return f"{label[:spare]}{text[len(label) :]}"[:width]


def _state(told: deque[tuple[float, int]], total: int) -> str:
    """Return a bar, how much is done, how fast, and how long the rest will take."""
    (began, first), (now, done) = told[0], told[-1]
    filled = _BAR * min(done, total) // max(total, 1)
    parts = [f"{'━' * filled}{'─' * (_BAR - filled)} {done}/{total}"]
    if now > began and done > first:
        rate = (done - first) / (now - began)
        parts.append(f"{rate:.1f}/s" if rate >= 1 else f"{60 * rate:.1f}/min")
        if done < total:
            parts.append(f"{timedelta(seconds=round((total - done) / rate))} left")
    return "  ".join(parts)
