import hashlib
import json

import numpy as np
import pytest
import torch
from PIL import Image

from mechsearch.camera import Camera
from mechsearch.grasp.graspability import ceiling, rate
from mechsearch.grasp.network import (
    SHIPPED_GRASP_NETWORK,
    GraspNetwork,
    load_network,
    ready,
    save_network,
)
from mechsearch.grippers import GraspView
from mechsearch.types import MechSearchError


def test_the_network_has_the_published_number_of_parameters():
    assert sum(p.numel() for p in GraspNetwork().parameters()) == 633_200


@pytest.mark.parametrize(("case", "best", "mean"), [(0, 0.997, 0.99), (1, 0.998, 0.996)])
def test_the_released_weights_reproduce_the_reference_images(
    released, fcgqcnn_folder, case, best, mean
):
    reference = fcgqcnn_folder / "reference"
    depth = np.load(reference / f"depth_{case}.npy")
    depth, seen = depth.squeeze(), depth.squeeze() > 0
    mask = seen & (np.asarray(Image.open(reference / f"segmask_{case}.png")) > 0)
    numbers = json.loads((reference / "phoxi.intr").read_text())
    camera = Camera(
        516, 386, *(numbers[key] for key in ("_fx", "_fy", "_cx", "_cy")), tuple(np.eye(4).ravel())
    )
    # As the authors' code has it: down to the deepest pixel, though that is none of the table's.
    filled = np.where(seen, depth, np.median(depth[seen]))
    grasps = rate(released, GraspView(filled, mask, camera, float(filled.max()))).best(10)
    assert grasps[0].quality == pytest.approx(best, abs=1e-3)
    assert np.mean([grasp.quality for grasp in grasps]) == pytest.approx(mean, abs=4e-3)


def test_each_cell_sees_its_own_96_pixels_and_nothing_else(untrained, bumpy):
    depths = torch.tensor([0.72, 0.78])
    whole = untrained.quality(torch.from_numpy(bumpy), depths)
    assert whole.shape == (2, 16, 7, 17)
    window = torch.from_numpy(bumpy[8:104, 20:116].copy())
    np.testing.assert_allclose(
        untrained.quality(window, depths)[:, :, 0, 0], whole[:, :, 2, 5], atol=1e-5
    )


def test_quality_is_the_pairwise_softmax_of_success(untrained, bumpy):
    image = torch.from_numpy(bumpy[:96, :96].copy())
    with torch.inference_mode():
        logits = untrained((image - 0.75)[None, None])[0, :, :, 0, 0]
        expected = torch.softmax(logits, dim=1)[:, 1]
    found = untrained.quality(image, torch.tensor([0.75]))[0, :, 0, 0]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_only_depth_relative_to_the_gripper_matters(untrained, bumpy):
    one = untrained.quality(torch.from_numpy(bumpy), torch.tensor([0.75]))
    other = untrained.quality(torch.from_numpy(bumpy + 0.25), torch.tensor([1.0]))
    np.testing.assert_allclose(one, other, atol=1e-4)


def test_a_saved_network_is_the_same_network(untrained, bumpy, tmp_path):
    path = tmp_path / "grasp.safetensors"
    save_network(path, untrained, {"note": "test"})
    again = load_network(path)
    image, depth = torch.from_numpy(bumpy), torch.tensor([0.75])
    assert torch.equal(again.quality(image, depth), untrained.quality(image, depth))


def test_files_that_hold_no_such_network_are_refused(tmp_path):
    with pytest.raises(MechSearchError, match="no network at"):
        load_network(tmp_path / "absent.npz")
    with pytest.raises(MechSearchError, match="no mechsearch grasp network at"):
        load_network(tmp_path / "absent.safetensors")
    np.savez(tmp_path / "other.npz", conv1_1_weights=np.zeros(3))
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(MechSearchError, match="does not hold the released"):
        load_network(tmp_path / "other.npz")
    with pytest.raises(MechSearchError, match="is damaged or no released network"):
        load_network(tmp_path / "text.npz")


def test_readiness_changes_no_weight():
    network = GraspNetwork()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    for name, tensor in ready(network).state_dict().items():
        assert torch.equal(tensor, before[name])


def test_the_shipped_network_is_the_one_of_its_card():
    card = json.loads(SHIPPED_GRASP_NETWORK.with_suffix(".json").read_text())
    assert hashlib.sha256(SHIPPED_GRASP_NETWORK.read_bytes()).hexdigest() == card["sha256"]
    assert card["held_out"]["average_precision"] > 0.7
    assert card["labels"]["heap_set"] == card["held_out"]["heap_set"]
    assert {card["labels"]["config"]["split"], card["held_out"]["config"]["split"]} == {
        "train",
        "held-out",
    }


def test_the_shipped_network_knows_a_bar_from_a_plate(make_box):
    """Jaws close over a bar 3 cm wide, and not over a plate of 16 cm."""
    network = load_network()
    bar, plate = make_box("bar", (0.1, 0.03, 0.03)), make_box("plate", (0.16, 0.16, 0.03))
    pose = np.array([0, 0, 0.015, 1.0, 0, 0, 0])
    assert ceiling(network, bar, pose).score > 0.8
    assert ceiling(network, plate, pose).score < 0.4
