import numpy as np
import pytest
import torch

from mechsearch.grasp.learning.grasp_folder import OUTCOMES
from mechsearch.grasp.learning.labelling import Grasps
from mechsearch.grasp.learning.metrics import judge
from mechsearch.grasp.learning.training import (
    NETWORK_FILE,
    GraspTrainConfig,
    predict,
    split_by_heap,
    train_grasp_network,
    turned,
)
from mechsearch.grasp.network import load_network
from mechsearch.grippers import ImageGrasp, angle_bin
from mechsearch.types import MechSearchError, Outcome


def bars(count, seed=0):
    """Bars of every direction; a grasp succeeds if it closes across its bar."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:96, :96] - 48.0
    seen, bins, won = [], [], []
    for _ in range(count):
        along, angle = rng.uniform(0, np.pi), rng.uniform(0, np.pi)
        across = np.abs(-np.sin(along) * u + np.cos(along) * v)
        seen.append(np.where(across < 7, -0.02, 0.03))
        bins.append(angle_bin(angle))
        won.append(abs(np.sin(angle - along)) > 0.85)
    success, failure = OUTCOMES.index(Outcome.SUCCESS), OUTCOMES.index(Outcome.SLIPPED)
    return Grasps(
        np.array(seen, np.float16), np.full(count, 0.75, np.float32), np.array(bins, np.uint8),
        np.where(won, success, failure).astype(np.uint8), np.zeros(count, np.bool_),
        (np.arange(count) // 20).astype(np.int64), np.full(count, "bar"),
    )  # fmt: skip


@pytest.mark.parametrize("symmetry", range(8))
def test_images_and_angle_bins_turn_together(symmetry):
    # A line of pixels along the closing direction must still lie along it afterwards.
    for index in range(16):
        angle = float(np.pi / 2 - (index + 0.5) * np.pi / 16)
        axis = ImageGrasp(48, 48, 1.0, angle).axis
        image = np.zeros((1, 96, 96))
        for t in (10, 20, 30, 40):
            image[0, round(48 + t * axis[1]), round(48 + t * axis[0])] = t
        out, bins = turned(image, np.array([index]), np.array([symmetry]))
        rows, columns = np.nonzero(out[0])
        offset = np.stack([columns - 48, rows - 48], 1) / out[0][rows, columns][:, None]
        found = np.arctan2(offset[:, 1], offset[:, 0])
        middle = np.pi / 2 - (int(bins[0]) + 0.5) * np.pi / 16
        turn = np.mod(found - middle + np.pi / 2, np.pi) - np.pi / 2
        assert len(rows) == 4
        assert np.abs(turn).max() < 0.06


def test_all_symmetries_leave_the_data_as_it_was_when_none_is_asked_for():
    grasps = bars(5)
    out, bins = turned(grasps.relative, grasps.bin, np.zeros(5, int))
    np.testing.assert_array_equal(out, grasps.relative)
    np.testing.assert_array_equal(bins, grasps.bin)


def test_no_heap_is_on_both_sides_of_the_split():
    learn, check = split_by_heap(bars(200), 0.2)
    assert not set(learn.heap) & set(check.heap)
    assert (len(learn), len(check)) == (160, 40)
    with pytest.raises(MechSearchError, match="expected at least 2"):
        split_by_heap(bars(20), 0.2)


def test_a_network_learns_which_way_to_close(tmp_path):
    history = train_grasp_network(bars(400), GraspTrainConfig(epochs=4, batch=16, seed=1), tmp_path)
    assert history[-1]["loss"] < history[0]["loss"]
    fresh = bars(200, seed=7)
    verdict = judge(predict(load_network(tmp_path / NETWORK_FILE), fresh), fresh.success)
    assert verdict.auc > 0.9


def test_a_training_that_was_cut_off_goes_on_to_the_same_network(tmp_path):
    class CutOffError(Exception):
        pass

    def cut_off(label, done, total):
        raise CutOffError

    grasps, config = bars(80), GraspTrainConfig(epochs=2, batch=32, validation=0.3)
    whole = train_grasp_network(grasps, config, tmp_path / "whole")
    with pytest.raises(CutOffError):
        train_grasp_network(grasps, config, tmp_path / "cut", cut_off)
    assert train_grasp_network(grasps, config, tmp_path / "cut") == whole
    one, other = (load_network(tmp_path / name / NETWORK_FILE) for name in ("whole", "cut"))
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name])


def test_a_folder_of_another_training_is_refused(tmp_path):
    train_grasp_network(bars(60), GraspTrainConfig(epochs=1, validation=0.3), tmp_path)
    with pytest.raises(MechSearchError, match="another learning_rate"):
        train_grasp_network(
            bars(60), GraspTrainConfig(epochs=2, validation=0.3, learning_rate=0.1), tmp_path
        )
    for wrong in ({"epochs": 0}, {"validation": 1.0}, {"learning_rate": 0.0}):
        with pytest.raises(MechSearchError, match="expected"):
            GraspTrainConfig(**wrong)
