"""What `mechsearch doctor` says of installations, whole and broken."""

import importlib.util
import subprocess
import sys

import mujoco
import pytest

from mechsearch.cli import main
from mechsearch.types import EXTRAS

BASE = ("Python", "cores", "MuJoCo", "embree", "cache", "heap")


def told(capsys):
    """Return the state and the text of each part."""
    lines = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    return {name: (state, text) for state, name, text in lines}


@pytest.fixture
def bare(monkeypatch):
    """An installation without optional parts."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)


@pytest.mark.usefixtures("bare")
def test_a_bare_installation_works_and_hears_what_more_there_is(tmp_path, capsys):
    for name in ("mug.obj", "fork.stl", "masses.csv"):
        (tmp_path / name).touch()
    main(["doctor", "--objects", str(tmp_path)])
    found = told(capsys)
    assert {found[name][0] for name in BASE} == {"works"}
    assert found["MuJoCo"][1] == mujoco.__version__
    assert "an action with images takes" in found["heap"][1]
    for extra, (name, _) in EXTRAS.items():
        assert found[name][0] == "missing"
        # mink asks for another build of the engine.
        how = "pip install --no-deps mink" if extra == "arms" else f"pip install '.[{extra}]'"
        assert how in found[name][1]
    assert found["objects"] == ("works", f"2 meshes in {tmp_path}")


def test_optional_parts_tell_their_versions(capsys):
    torch = pytest.importorskip("torch")
    main(["doctor", "--objects", "absent"])
    found = told(capsys)
    assert found["PyTorch"] == ("works", torch.__version__)
    for name, module in EXTRAS.values():
        there = importlib.util.find_spec(module) is not None
        assert found[name][0] == ("works" if there else "missing")
    assert found["objects"][0] == "broken"
    assert "does not exist" in found["objects"][1]


@pytest.mark.usefixtures("bare")
def test_another_engine_in_the_folder_of_ours_and_a_cache_in_the_way_are_named(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(mujoco, "__version__", "3.17.0")
    with pytest.raises(SystemExit) as stopped:
        main(["doctor"])
    assert stopped.value.code == 1
    found = told(capsys)
    assert {name for name, (state, _) in found.items() if state == "broken"} == {"MuJoCo", "cache"}
    assert "gives 3.17.0" in found["MuJoCo"][1]
    assert "pip uninstall mujoco" in found["MuJoCo"][1]
    assert "MECHSEARCH_CACHE" in found["cache"][1]


def test_where_a_library_cannot_be_loaded_doctor_still_tells_and_others_name_it():
    code = """
import importlib.util, sys
from mechsearch.cli import main
from mechsearch.types import EXTRAS
sys.modules["mujoco"] = None
importlib.util.find_spec = lambda name: None
main(sys.argv[1:])
"""

    def outcome(*words):
        return subprocess.run(
            [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
        )

    done = outcome("doctor")
    assert done.returncode == 1
    assert not done.stderr
    states = [line.split()[:2] for line in done.stdout.splitlines()]
    assert ["broken", "MuJoCo"] in states
    assert ["broken", "heap"] in states
    assert ["works", "embree"] in states
    done = outcome("heaps", "show", "household-single")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot start: import of mujoco halted" in done.stderr
    assert "`mechsearch doctor` says what is missing" in done.stderr
