import subprocess
import sys
from pathlib import Path

import pytest

from mechsearch.files import locked, write_folder
from mechsearch.types import MechSearchError

HOLDER = """
import sys, time
from pathlib import Path
from mechsearch.files import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_lock_keeps_others_out_and_ends_with_its_holder_however_that_ends(tmp_path: Path) -> None:
    path = tmp_path / "file.csv"
    words = [sys.executable, "-c", HOLDER, str(path)]
    holder = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    with locked(path, wait=False) as free:
        assert not free
    holder.kill()
    holder.wait()
    with locked(path, wait=False) as free:
        assert free


def test_a_lock_is_free_again_after_an_error(tmp_path: Path) -> None:
    class Trouble(Exception):  # noqa: N818
        pass

    try:
        with locked(tmp_path / "file.csv"):
            raise Trouble
    except Trouble:
        pass
    with locked(tmp_path / "file.csv", wait=False) as free:
        assert free


KILLED = """
import os, signal, sys
from pathlib import Path
from mechsearch.files import write_folder


def write(folder):
    (folder / "first.txt").write_text("half of it")
    os.kill(os.getpid(), signal.SIGKILL)


write_folder(Path(sys.argv[1]), write)
"""


def test_a_folder_is_whole_or_absent_whoever_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "data"
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert not path.exists()
    write_folder(path, lambda folder: (folder / "second.txt").write_text("all of it"))
    assert [file.name for file in path.iterdir()] == ["second.txt"]
    assert [file.name for file in tmp_path.iterdir() if file.is_dir()] == ["data"]
    with pytest.raises(MechSearchError, match="there already"):
        write_folder(path, lambda folder: None)
    with pytest.raises(ZeroDivisionError):
        write_folder(tmp_path / "other", lambda folder: 1 / 0)
    assert not (tmp_path / "other").exists()
