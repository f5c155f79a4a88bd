import json
from pathlib import Path

import pytest
from PIL import Image

pytest.importorskip("torch")

from mechsearch.cli import GRIPPER_COMMANDS, main
from mechsearch.evaluation.episodes import CEILING_METRICS, read_summary
from mechsearch.heaps.dataset import embedded_file
from tests.test_cli_grasp import failure

HEAPS = ["--heaps", str(embedded_file("single"))]
ONE = ["--workers", "1"]


@pytest.fixture(scope="module")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two rounds of trials of the suction cup, the second one with a network of the first."""
    folder = tmp_path_factory.mktemp("gripper_cli")
    first, second, run = (folder / name for name in ("first", "second", "run"))
    label = ["grasp", "label", "--gripper", "suction", *HEAPS, *ONE]
    label += ["--per-object", "2", "--proposals", "10"]
    main([*label, "--limit", "4", "--out", str(first)])
    train = ["grasp", "train", "--gripper=suction", "--validation", "0.5", "--epochs", "1"]
    main([*train, "--labels", str(first), "--out", str(run)])
    network = ["--network", str(run / "network.safetensors")]
    main([*label, *network, "--limit", "2", "--out", str(second)])
    return first, second


@pytest.fixture(scope="module")
def network(rounds: tuple[Path, Path]) -> str:
    run = rounds[0].parent / "again"
    train = ["grasp", "train", "--gripper", "suction", "--validation", "0.5", "--epochs", "1"]
    main([*train, "--labels", *map(str, rounds), "--out", str(run)])
    return str(run / "network.safetensors")


def test_a_network_is_judged_on_several_rounds(
    rounds: tuple[Path, Path], network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "test", network, "--gripper", "suction", "--labels", *map(str, rounds)]
    main([*words, "--out", str(tmp_path / "test.json"), "--plot", str(tmp_path / "test.svg")])
    assert "calibration error" in capsys.readouterr().out
    found = json.loads((tmp_path / "test.json").read_text())
    assert "again" in found["networks"]
    assert "share that succeeds" in (tmp_path / "test.svg").read_text()


def test_the_chosen_grasp_is_held_against_the_first_one(
    network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "lift", "--gripper", "suction", "--network", network, *HEAPS, *ONE]
    words += ["--limit", "3", "--states", "alone", "pushed", "--repeats", "1"]
    files = tmp_path / "lift.png", tmp_path / "lift.json"
    main([*words, "--out", str(files[0]), "--table", str(files[1])])
    said = capsys.readouterr().out
    assert "Share of targets that suction lifts" in said
    rows = json.loads(files[1].read_text())["rows"]
    assert [(row["state"], row["executed"]) for row in rows] == [
        (state, executed)
        for state in ("alone", "pushed")
        for executed in ("as planned", "perturbed")
    ]
    for row in rows:
        gain = row["chosen"]["mean"] - row["drawn"]["mean"]
        assert row["gain"]["mean"] == pytest.approx(gain)
    with Image.open(files[0]) as picture:
        assert picture.height >= 200


def test_a_ceiling_is_printed_and_entered(
    network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["grasp", "ceiling", "--gripper", "suction", "--networks", network, *HEAPS, *ONE]
    words += ["--limit", "2", "--geometric", "5", "--summary", str(tmp_path / "s.csv")]
    main(words)
    assert "2 targets without clutter" in capsys.readouterr().out
    rows = read_summary(tmp_path / "s.csv")
    assert {row.metric for row in rows} == set(CEILING_METRICS)
    assert {row.variant for row in rows} == {"ceiling-suction"}


def test_another_gripper_is_refused_with_the_choices(
    rounds: tuple[Path, Path], network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, labels = ["--out", str(tmp_path / "out")], ["--labels", str(rounds[0])]
    options = {"grasp label": [*HEAPS, *out], "grasp lift": HEAPS, "grasp test": labels,
               "grasp train": [*labels, *out], "grasp ceiling": HEAPS}  # fmt: skip
    assert {*GRIPPER_COMMANDS, "grasp ceiling"} == set(options)
    for name, words in options.items():
        said = failure([*name.split(), "--gripper", "tongs", *words], capsys)
        assert "unknown gripper 'tongs'; choose one of jaws-56, jaws-85, suction" in said
    jaws = ["--gripper", "jaws-56"]
    said = failure(["grasp", "lift", *jaws, "--network", network, *HEAPS], capsys)
    assert "is a network of the gripper 'suction'; expected 'jaws-56'" in said
    for command in ("train", "test"):
        words = ["grasp", command, *jaws, *labels, *(out if command == "train" else [])]
        assert "holds grasps of 'suction'; expected 'jaws-56'" in failure(words, capsys)
