import subprocess
import sys
from pathlib import Path

import pytest

import mechsearch
from mechsearch.evaluation.episodes import load_episodes, save_episodes
from mechsearch.heaps.dataset import embedded_file
from mechsearch.types import MechSearchError


def test_every_public_name_is_found_and_they_are_sorted():
    assert mechsearch.__all__ == sorted(mechsearch.__all__)
    assert set(mechsearch._PLACES) == set(mechsearch.__all__)
    for name in mechsearch.__all__:
        assert getattr(mechsearch, name) is not None


def test_an_unknown_name_is_no_attribute():
    with pytest.raises(AttributeError, match="'nonsense'"):
        _ = mechsearch.nonsense


@pytest.mark.parametrize(
    "module", ["env.heap_env", "evaluation.rollout", "findings.analysis", "report.contents", "cli"]
)
def test_the_base_install_needs_no_torch(module):
    code = f"import sys, mechsearch.{module}; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_needs_torch_says_so_where_there_is_none(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"{name} imports torch", name="torch")

    monkeypatch.setattr(mechsearch, "import_module", missing)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match=r"mechsearch.train needs PyTorch: install it by"):
        _ = mechsearch.train


def test_files_are_named_by_text_or_by_path(tmp_path):
    heaps = embedded_file("single")
    for kind in (str, Path):
        found = mechsearch.load_heaps(kind(heaps))
        assert found.hash == mechsearch.load_heaps(heaps).hash
        evaluation = mechsearch.evaluate("idle", kind(heaps), limit=1)
        save_episodes(kind(tmp_path / "idle.npz"), evaluation)
        assert load_episodes(kind(tmp_path / "idle.npz")).header == evaluation.header
    with pytest.raises(MechSearchError, match=r"no actor at absent\.safetensors"):
        mechsearch.make_policy(Path("absent.safetensors"))
