import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch")

import torch

from mechsearch.cli import main
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import GRASP_METRICS, METRICS, score
from mechsearch.grasp.network import GraspNetwork, save_network


def failure(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command says before it exits with 2."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return said


@pytest.fixture(scope="module")
def heaps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grasp_cli") / "heaps.parquet"
    words = ["heaps", "generate", "--heaps", "8", "--counts", "4", "--workers", "1"]
    main([*words, "--seed", "3", "--out", str(path)])
    return path


@pytest.fixture(scope="module")
def network(heaps: Path) -> Path:
    torch.manual_seed(0)
    path = heaps.parent / "network.safetensors"
    save_network(path, GraspNetwork(), {})
    return path


@pytest.fixture(scope="module")
def image(heaps: Path) -> Path:
    """A depth image of a bar on a table, its mask and intrinsics in files."""
    folder = heaps.parent
    depth = np.full((150, 200), 0.8, np.float32)
    depth[60:90, 80:95] = 0.76
    np.save(folder / "depth.npy", depth)
    Image.fromarray(((depth < 0.79) * 255).astype(np.uint8)).save(folder / "mask.png")
    numbers = {"fx": 552.5, "fy": 552.5, "cx": 99.5, "cy": 74.5}
    (folder / "camera.json").write_text(json.dumps(numbers))
    return folder


def test_heaps_are_scored_and_drawn(
    heaps: Path, network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "score", "--network", str(network), "--heaps", str(heaps)]
    main([*words, "--out", str(tmp_path / "scores.png")])
    said = capsys.readouterr().out
    assert "mean graspability" in said
    assert "over 4 heaps" in said
    with Image.open(tmp_path / "scores.png") as picture:
        assert picture.width == 4 * 426


def test_a_users_own_image_is_scored_and_drawn(
    image: Path, network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "score", "--network", str(network), "--depth", str(image / "depth.npy")]
    words += ["--mask", str(image / "mask.png"), "--intrinsics", str(image / "camera.json")]
    main([*words, "--out", str(tmp_path / "own.png")])
    said = capsys.readouterr().out
    assert "graspability 0." in said
    assert said.count("+0.7") >= 10
    assert (tmp_path / "own.png").stat().st_size > 1000


def test_grasps_are_told_in_the_pixels_that_were_brought_though_the_image_is_resized(
    network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    depth = np.full((450, 600), 0.8, np.float32)
    depth[180:270, 240:285] = 0.76
    depth[3:6, 3:6] = 65.535
    labels = 7 * (depth == np.float32(0.76)) + 9 * (depth > 1)
    k = np.array([[1657.5, 0, 299.5], [0, 1657.5, 224.5], [0, 0, 1]])
    np.savez(tmp_path / "view.npz", depth=depth, mask=labels, K=k)
    words = ["grasp", "score", "--network", str(network), "--depth", str(tmp_path / "view.npz")]
    assert "values 0, 7, 9; choose the target's by --label" in failure(words, capsys)
    main([*words, "--label", "7"])
    said = capsys.readouterr().out
    # Of the image as it was resized.
    assert "note: pixels not believed: 1 deeper than the table at 0.800 m, down to 65.5" in said
    rows = [line.split() for line in said.splitlines() if "+0.7" in line]
    assert len(rows) >= 5
    for column, row, z, *_, x, y, _ in (map(float, cells) for cells in rows):
        assert column == pytest.approx(299.5 + 1657.5 * x / z, abs=2.5)
        assert row == pytest.approx(224.5 + 1657.5 * y / z, abs=2.5)
        assert 240 <= column < 285
        assert 180 <= row < 270


def test_bad_input_is_named(
    heaps: Path, image: Path, network: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    score = ["grasp", "score", "--network", str(network)]
    own = [*score, "--depth", str(image / "depth.npy"), "--intrinsics", str(image / "camera.json")]
    assert "name either --heaps, or --depth" in failure(score, capsys)
    assert "the mask too" in failure(own, capsys)
    mask = ["--mask", str(image / "mask.png")]
    assert "is it in millimetres" in failure([*own, *mask, "--depth-scale", "1000"], capsys)
    sets = [*score, "--heaps", str(heaps)]
    assert "50 to 60 mm" in failure([*sets, "--opening", "0.085"], capsys)
    assert "choose one of held-out, train, all" in failure([*sets, "--split", "half"], capsys)
    assert "has 4 held-out heaps" in failure([*sets, "--limit", "5"], capsys)
    absent = ["grasp", "score", "--network", "absent.npz", "--heaps", str(heaps)]
    assert "no network at absent.npz" in failure(absent, capsys)


def test_targets_are_lifted_and_filmed(
    heaps: Path, network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "lift", "--network", str(network), "--heaps", str(heaps), "--limit", "2"]
    words += ["--repeats", "2", "--workers", "1"]
    main([*words, "--out", str(tmp_path / "lift.png")])
    said = capsys.readouterr().out
    assert "of 2 targets as planned" in said
    main(words)
    assert capsys.readouterr().out == said.replace(f"wrote {tmp_path / 'lift.png'}\n", "")
    with Image.open(tmp_path / "lift.png") as picture:
        assert picture.height >= 2 * 200
    assert "expected 0 or more" in failure([*words, "--repeats", "-1"], capsys)


def test_the_whole_way_from_labels_to_a_judged_network(
    heaps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels, run = tmp_path / "labels", tmp_path / "run"
    words = ["grasp", "label", "--heaps", str(heaps), "--out", str(labels), "--workers", "1"]
    main([*words, "--per-object", "4"])
    assert "succeed" in capsys.readouterr().out
    train = ["grasp", "train", "--labels", str(labels), "--out", str(run), "--validation", "0.5"]
    main([*train, "--epochs", "1"])
    main([*train, "--epochs", "2"])
    assert "of 2: average precision" in capsys.readouterr().out
    network = str(run / "network.safetensors")
    found, plot = tmp_path / "test.json", tmp_path / "test.svg"
    judge = ["grasp", "test", network, "--labels", str(labels)]
    main([*judge, "--out", str(found), "--plot", str(plot)])
    assert "AP of the shipped network above that of network" in capsys.readouterr().out
    assert set(json.loads(found.read_text())["networks"]) == {"shipped", "network"}
    assert "share that succeeds" in plot.read_text()
    assert "has 4 train heaps" in failure([*words, "--limit", "9"], capsys)
    assert "another config" in failure([*words, "--per-object", "5"], capsys)


def test_an_evaluation_measures_graspability_and_retrieval(
    heaps: Path, network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "idle", "teacher-spiral", "--heaps", str(heaps), "--limit", "2", "--brief"]
    words += ["--workers", "1", "--out", str(tmp_path), "--summary", str(tmp_path / "s.csv")]
    main([*words, "--grasp-network", str(network)])
    said = capsys.readouterr().out
    assert "Graspability and retrieval of the target" in said
    rows = {(row.variant, row.metric): row for row in episodes.read_summary(tmp_path / "s.csv")}
    for policy in ("idle", "teacher-spiral"):
        assert {metric for variant, metric in rows if variant == policy} == {
            *METRICS,
            *GRASP_METRICS,
        }
    assert abs(rows["idle", "graspability_change"].mean) < 0.05
    assert rows["idle", "retrieval_before"].mean == rows["idle", "retrieval_after"].mean
    recorded = episodes.load_episodes(tmp_path / "idle.npz")
    assert all(record.grasp is not None for record in recorded.episodes)
    assert score(recorded.episodes)["retrieval_after"].mean == rows["idle", "retrieval_after"].mean
    absent = failure([*words, "--grasp-network", "absent.npz"], capsys)
    assert "no network at absent.npz" in absent


def test_too_few_heaps_to_calibrate_are_named(
    heaps: Path, network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "idle", "--heaps", str(heaps), "--limit", "1", "--workers", "1", "--brief"]
    main([*words, "--out", str(tmp_path)])
    calibrate = ["grasp", "calibrate", str(tmp_path / "idle.npz"), "--network", str(network)]
    calibrate += ["--workers", "1", "--grasps", "2", "--repeats", "1"]
    assert "try more heaps" in failure(calibrate, capsys)
    assert "idle.npz has 1 episodes" in failure([*calibrate, "--limit", "2"], capsys)
    assert "expected at least one of each" in failure([*calibrate, "--repeats", "0"], capsys)
