import shutil
from importlib import resources
from pathlib import Path

import pytest

pytest.importorskip("torch")

from mechsearch.heaps.dataset import load_heaps
from mechsearch.training.run import RunInputs, _record


def recorded(heaps, run):
    run.mkdir(parents=True)
    _record(RunInputs(heaps, "household"), load_heaps(heaps), run, False, {})


@pytest.fixture
def heaps(tmp_path):
    place = tmp_path / "here" / "heaps" / "single.parquet"
    place.parent.mkdir(parents=True)
    shutil.copy(str(resources.files("mechsearch.heaps") / "household_single.parquet"), place)
    return place


def test_a_folder_that_holds_run_and_heaps_can_be_moved(heaps, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path / "here")
    recorded(Path("heaps/single.parquet"), Path("results/runs/method-0"))
    shutil.move(tmp_path / "here", tmp_path / "there")
    monkeypatch.chdir(tmp_path)
    found = RunInputs.of_run(tmp_path / "there/results/runs/method-0").heaps
    assert found.resolve() == tmp_path / "there" / "heaps" / "single.parquet"
    assert found.exists()


def test_heaps_from_elsewhere_are_found_wherever_the_run_goes(heaps, tmp_path, monkeypatch):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    recorded(heaps, Path("method-0"))
    shutil.move("method-0", tmp_path / "moved")
    assert RunInputs.of_run(tmp_path / "moved").heaps == heaps
