import json
from pathlib import Path

import pytest
from PIL import Image

pytest.importorskip("torch")

from mechsearch.cli import main
from tests.test_cli_grasp import failure

ONE = ["--workers", "1"]
HEAPS = ["household-single", *ONE]


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A network that has learnt hardly anything."""
    folder = tmp_path_factory.mktemp("segmentation_cli")
    images = ["segment", "images", "--heaps", *HEAPS, "--out", str(folder / "images")]
    main([*images, "--limit", "3", "--views", "1", "--also", "--variants", "0"])
    train = ["segment", "train", "--images", str(folder / "images"), "--validation", "0.4"]
    few = ["--updates", "1", "--batch", "2", "--targets", "2"]
    main([*train, *few, "--out", str(folder / "run")])
    return str(folder / "run" / "network.safetensors")


def test_segment_test_and_show_judge_a_network(
    network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = [*HEAPS, "--segmenter", network, "--limit", "3"]
    main(["segment", "test", *ours, "--out", str(tmp_path / "found.json")])
    assert "household-single" in capsys.readouterr().out
    found = json.loads((tmp_path / "found.json").read_text())
    entry = found["heap_sets"]["household-single"]["known"]
    assert found["sensor"] == "stereo"
    assert 1 <= entry["targets"] <= 3
    assert 0 <= entry["right"]["mean"] <= 1
    main(["segment", "show", *ours, "--out", str(tmp_path / "masks.png"), "--columns", "1"])
    with Image.open(tmp_path / "masks.png") as image:
        # A row of four pictures for each target.
        assert image.width > 4 * 256
        assert image.height > entry["targets"] * 256


def test_an_estimate_is_trained_on_images_of_episodes_and_stops_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["--split", "train", "--limit", "3", "--max-actions", "2", "--stop", "never"]
    main(["evaluate", "random", "--heaps", *HEAPS, *few, "--out", str(tmp_path)])
    images = ["segment", "images", "--heaps", *HEAPS, "--out", str(tmp_path / "images")]
    shown = ["--episodes", str(tmp_path / "random.npz"), "--views", "1", "--variants", "0"]
    main([*images, *shown, "--also"])
    train = ["segment", "occlusion", "--images", str(tmp_path / "images"), "--updates", "1"]
    capsys.readouterr()
    main([*train, "--validation", "0.4", "--out", str(tmp_path / "run")])
    assert "on validation heaps, occlusion is off by" in capsys.readouterr().out
    stop = ["--stop", str(tmp_path / "run" / "network.safetensors"), "--limit", "1"]
    main(["evaluate", "idle", "--heaps", *HEAPS, *stop, "--out", str(tmp_path), "--brief"])
    main(["verify", str(tmp_path / "idle.npz"), "--heaps", *HEAPS])


def test_what_segmentation_refuses_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("segmenter", "sensor"):
        said = failure(["segment", "test", *HEAPS, f"--{option}", "x"], capsys)
        assert f"unknown {option} 'x'; choose" in said
