import subprocess
import sys
from pathlib import Path

from mechsearch.files import (
    locked,
)

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
