"""Where results go: full disks, read-only places, and two processes at one place."""

import errno
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mechsearch.cli import main
from mechsearch.files import (
    append_line,
    check_place,
    locked,
    write_json,
    write_whole,
)
from mechsearch.types import MechSearchError

HEAPS = str(resources.files("mechsearch.heaps") / "household_single.parquet")

COMMANDS = {
    "heaps generate": ["--heaps", "4", "--counts", "4", "--workers", "1", "--out", "OUT/h.parquet"],
    "train": ["debug", "--heaps", HEAPS, "--actions", "9", "--out", "OUT"],
    "train plus": [
        *("--heaps", HEAPS, "--actions", "9", "--evaluate-every", "9", "--validation-heaps", "2"),
        *("--out", "OUT"),
    ],
    "evaluate": ["idle", "--heaps", HEAPS, "--limit", "1", "--workers", "1", "--out", "OUT"],
    "grasp label": [
        *("--heaps", HEAPS, "--limit", "1", "--per-object", "1", "--workers", "1"),
        *("--out", "OUT"),
    ],
    "sweep": ["--quick", "--workers", "1", "--out", "OUT"],
    "report": ["SUMMARY", "--out", "OUT/page.svg"],
}
"""Words of every command that writes, for a place called OUT."""


@pytest.fixture
def summary(tmp_path: Path) -> Path:
    path = tmp_path / "summary.csv"
    path.write_text(
        "experiment,condition,variant,seed,actions,metric,mean,ci_low,ci_high\n"
        "main,single,idle,0,0,reward,1.0,0.5,1.5\n"
    )
    return path


def refused(
    command: str, place: Path, summary: Path, capsys: pytest.CaptureFixture[str], *more: str
) -> str:
    """Return the one line that a command says before it exits with 1 or 2."""
    if command not in ("heaps generate", "evaluate", "report"):
        pytest.importorskip("torch")
    words = [word.replace("OUT", str(place)) for word in COMMANDS[command]]
    words = [word.replace("SUMMARY", str(summary)) for word in words]
    with pytest.raises(SystemExit) as stopped:
        main([*command.split(), *words, *more])
    said = capsys.readouterr().err.splitlines()
    assert stopped.value.code in (1, 2)
    lines = [line for line in said if line.startswith("mechsearch: ")]
    assert len(lines) == 1
    assert not any("Traceback" in line for line in said)
    return lines[0]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_in_the_folder_s_place_is_named_and_stays(
    command: str, tmp_path: Path, summary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "thesis"
    place.write_text("mine")
    said = refused(command, place, summary, capsys)
    assert "cannot write" in said
    assert str(place) in said
    assert "nothing of that name is in the way" in said
    assert place.read_text() == "mine"


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.ENOSPC, "free some space"), (errno.EROFS, "a place that you may write to")],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_or_read_only_disk_is_told_in_one_line_and_nothing_half_written_is_seen(
    command: str,
    number: int,
    advice: str,
    tmp_path: Path,
    summary: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    # The disk is full when the content is there; a read-only one lets no file begin.
    owner, name = (os, "fsync") if number == errno.ENOSPC else (tempfile, "mkstemp")
    monkeypatch.setattr(owner, name, refuse)
    place = tmp_path / "out"
    said = refused(command, place, summary, capsys)
    assert os.strerror(number) in said
    assert advice in said
    files = [file for file in place.rglob("*") if file.is_file()]
    assert all(file.name.endswith(".lock") for file in files)


def test_a_table_that_cannot_be_written_is_refused_before_the_episodes(
    tmp_path: Path, summary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--summary", str(summary / "table.csv")]
    said = refused("evaluate", tmp_path / "out", summary, capsys, *words)
    assert str(summary / "table.csv") in said
    assert not list((tmp_path / "out").glob("*.npz"))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    try:
        done = subprocess.run(mount, check=False, capture_output=True)
    except FileNotFoundError:
        pytest.skip("no mount command")
    if done.returncode:
        pytest.skip("no disk may be mounted here")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture
def small_files(tmp_path: Path) -> Iterator[Path]:
    """A folder whose files may have 64 kB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (65536, hard))
    try:
        yield tmp_path
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write_arrays(path: Path) -> None:
    noise = np.random.default_rng(0).normal(size=40_000)
    write_whole(path, lambda partial: np.savez_compressed(partial, noise=noise))


def write_tensors(path: Path) -> None:
    torch = pytest.importorskip("torch")
    weights = pytest.importorskip("mechsearch.files.tensors")
    weights.save_archive(path, weights.Archive("large", {"noise": torch.rand(40_000)}, {}))


def write_record(path: Path) -> None:
    write_json(path, ["x"] * 40_000)


@pytest.mark.parametrize("room", ["small_disk", "small_files"])
@pytest.mark.parametrize("write", [write_arrays, write_tensors, write_record])
def test_a_really_full_disk_keeps_what_was_there_and_is_clean_again(
    room: str, write: Callable[[Path], None], request: pytest.FixtureRequest
) -> None:
    place = request.getfixturevalue(room)
    path = place / "large.npz"
    write_json(path, "before")
    before = path.read_bytes()
    with pytest.raises(MechSearchError, match=r"cannot write .*large.npz: .*free some space"):
        write(path)
    assert path.read_bytes() == before
    assert [file for file in place.iterdir() if file.is_file()] == [path]


def test_a_log_on_a_really_full_disk_is_named(small_disk: Path) -> None:
    (small_disk / "filler").write_bytes(bytes(61_440))
    with pytest.raises(MechSearchError, match=r"cannot write .*log.jsonl: No space left"):
        append_line(small_disk / "log.jsonl", {"text": "x" * 10_000})


def test_a_folder_in_a_file_s_place_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="Is a directory"):
        check_place(tmp_path)
    check_place(tmp_path / "new" / "file.csv")
    assert not (tmp_path / "new").exists()


HOLDER = """
import sys, time
from contextlib import ExitStack
from pathlib import Path
from mechsearch.files import locked
with ExitStack() as stack:
    for path in sys.argv[1:]:
        stack.enter_context(locked(Path(path)))
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def held(tmp_path: Path) -> Iterator[Path]:
    """A place where another process is at work in every way."""
    place = tmp_path / "out"
    names = ("h.parquet", "run", "grasps", "sweep", "training")
    words = [sys.executable, "-c", HOLDER, *(str(place / name) for name in names)]
    holder = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    yield place
    holder.kill()
    holder.wait()


@pytest.mark.parametrize(
    "command", [name for name in COMMANDS if name not in ("evaluate", "report")]
)
def test_a_second_process_at_the_same_place_is_refused(
    command: str, held: Path, summary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(command, held, summary, capsys)
    assert "another" in said
    assert "wait for its end, or stop it" in said
    assert str(held) in said
    assert all(file.name.endswith(".lock") for file in held.rglob("*") if file.is_file())


def test_of_two_commands_at_once_the_second_is_refused_and_the_first_finishes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "heaps.parquet"
    options = ["--heaps", "16", "--counts", "4", "--workers", "1", "--out", str(out)]
    first = subprocess.Popen([sys.executable, "-m", "mechsearch", "heaps", "generate", *options])
    journal = tmp_path / ".heaps.attempts.jsonl"
    deadline = time.monotonic() + 200
    while not journal.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    with locked(out, wait=False) as free:
        assert not free
    with pytest.raises(SystemExit) as stopped:
        main(["heaps", "generate", *options])
    assert stopped.value.code == 2
    assert "another process is at work" in capsys.readouterr().err
    assert first.wait() == 0
    assert out.exists()
