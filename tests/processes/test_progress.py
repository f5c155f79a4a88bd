"""What is told of long work, on a terminal and in a file."""

import io
import sys

import pytest

from mechsearch.processes import progress


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand."""

    class Clock:
        now = 100.0

    monkeypatch.setattr(progress.time, "monotonic", lambda: Clock.now)
    return Clock


def shown(monkeypatch, terminal):
    """A stream that takes what is shown."""
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


def test_a_file_gets_a_line_at_first_every_half_a_minute_and_last(clock, monkeypatch):
    stream = shown(monkeypatch, terminal=False)
    with progress.bars() as tell:
        for done in range(1, 101):
            tell(f"method, reward {-done}", done, 100)
            clock.now += 0.5
        tell("method, scoring", 100, 100)
    lines = stream.getvalue().splitlines()
    assert [line.split(",")[1].split()[1] for line in lines] == ["-1", "-61", "-100"]
    assert "─ 1/100" in lines[0]
    assert "left" not in lines[0]
    # Two a second: the 39 that are left take 20 seconds.
    assert lines[1].endswith("61/100  2.0/s  0:00:20 left")
    assert lines[2].endswith("100/100  2.0/s")


def test_a_terminal_keeps_one_line_that_fits_it(clock, monkeypatch):
    stream = shown(monkeypatch, terminal=True)
    monkeypatch.setenv("COLUMNS", "60")
    with progress.bars() as tell:
        for done in (40, 41, 42):
            tell("a very long name of something that is being done, now", done, 90)
            clock.now += 40
    states = stream.getvalue().removesuffix("\n").split("\r")[1:]
    assert len(states) == 3
    assert all(len(state.removesuffix("\x1b[K")) <= 59 for state in states)
    # Gone on with at 40: one in 40 seconds.
    assert states[-1].removesuffix("\x1b[K").endswith("42/90  1.5/min  0:32:00 left")


def test_silence_is_empty(monkeypatch):
    stream = shown(monkeypatch, terminal=True)
    with progress.bars():
        pass
    assert stream.getvalue() == ""
