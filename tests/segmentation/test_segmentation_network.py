"""The segmentation network: what it reads, and what must not matter."""

import copy
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import mechsearch.segmentation.network as own
from mechsearch.camera import Camera, look_at, preset
from mechsearch.observe.masks import at_size, image_channels, logits_by, mask_features, surest_parts
from mechsearch.segmentation.images import ImageConfig, see_heaps
from mechsearch.segmentation.judging import found_by, partly_hidden
from mechsearch.segmentation.network import (
    NetworkSegmenter,
    SegmentationNetwork,
    load_segmentation_network,
    network_segmenter,
    reference_channels,
    save_segmentation_network,
)
from mechsearch.segmentation.reference import render_references
from mechsearch.types import MechSearchError

SHIPPED = Path(own.__file__).with_name("segmentation.safetensors")


@pytest.fixture(scope="module")
def fresh():
    torch.manual_seed(0)
    return SegmentationNetwork().eval()


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    depth = np.full((128, 128), 1.0, np.float32)
    depth[40:60, 50:90] = 0.9
    return rng.integers(0, 255, (128, 128, 3)).astype(np.uint8), depth, preset("overhead", 128)


def test_what_is_read_of_an_image():
    camera = Camera(2, 1, 100.0, 100.0, 0.0, 0.0, look_at((0, 0, 1.0), (0, 0, 0), (0, 1, 0)))
    rgb = np.array([[[255, 0, 51], [0, 0, 0]]], np.uint8)
    found = image_channels(rgb, np.array([[0.9, 0.0]], np.float32), camera)
    np.testing.assert_allclose(found[:3, 0, 0], [0.5, -0.5, -0.3], atol=1e-6)
    # 10 cm over the table, nothing where there is a hole, and 9 mm a pixel.
    np.testing.assert_allclose(found[3, 0], [1.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(found[4, 0], [0, 1])
    assert found[5, 0, 0] == pytest.approx(np.log(0.009 / 0.0054), abs=1e-6)


def test_the_order_of_views_does_not_matter(fresh, scene, make_box):
    views = render_references(make_box("box", (0.1, 0.05, 0.03)))
    order = np.random.default_rng(1).permutation(len(views.rgb))
    turned = type(views)(views.rgb[order], views.mask[order], views.width[order])
    segmenter, found = NetworkSegmenter(fresh, (1.0, 0.0, 0.0)), []
    for references in (views, turned):
        segmenter.look_for(references)
        found.append(segmenter.logits(*scene))
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)


def test_images_of_other_sizes_give_masks_of_theirs(fresh, scene, make_box):
    segmenter = NetworkSegmenter(fresh, (1.0, 0.0, 0.0))
    segmenter.look_for(render_references(make_box("box", (0.1, 0.05, 0.03))))
    rgb, depth, camera = scene
    larger = (rgb.repeat(3, 0).repeat(3, 1), depth.repeat(3, 0).repeat(3, 1), camera.resized(384))
    wide = (rgb[:64], depth[:64], camera.resized(64, 128))
    for (colours, depths, view), looked in ((larger, 256), (scene, 112), (wide, 112)):
        assert segmenter.logits(colours, depths, view).shape[1] == looked
        assert segmenter.segment(colours, depths, view)[0].shape == depths.shape


def test_a_segmenter_asks_a_network_that_normalises_as_the_one_it_is_given(scene, make_box):
    torch.manual_seed(1)
    network = SegmentationNetwork().eval()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(std=0.1)
            module.running_var.uniform_(0.5, 2)
    views = render_references(make_box("box", (0.1, 0.05, 0.03)))
    segmenter = NetworkSegmenter(network, (1.0, 0.0, 0.0))
    segmenter.look_for(views)
    with torch.inference_mode():
        arrays = (views.rgb, views.mask, views.width)
        target = network.look(reference_channels(*map(torch.from_numpy, arrays))[None])
        image = torch.from_numpy(image_channels(*at_size(*scene, 112)))[None]
        own = network.decode(network.encode(image), target, torch.zeros(1, dtype=torch.long))[0]
    np.testing.assert_allclose(segmenter.logits(*scene), own.numpy(), atol=1e-3)
    assert any(isinstance(m, torch.nn.BatchNorm2d) for m in network.modules())


def bright(image):
    """Return logits of what is bright."""
    return np.where(image[0] > 0.3, 4.0, -4.0).astype(np.float32)


@pytest.mark.parametrize("corner", [(0, 0), (100, 130), (253, 251)])
def test_a_larger_image_is_looked_at_closer_where_the_target_is_likeliest(corner):
    seen = []

    def network(image):
        seen.append(image)
        return bright(image)

    row, column = corner
    rgb = np.zeros((256, 256, 3), np.uint8)
    rgb[row : row + 3, column : column + 3] = 255
    depth = np.full((256, 256), 1.0, np.float32)
    logits = logits_by(network, (128, 128), 256, rgb, depth, preset("overhead", 256))
    found = logits > 0
    np.testing.assert_array_equal(found[rgb[..., 0] > 0], True)
    # Pixels of the second look are half as large, and it shows the bright spot whole.
    whole, close = seen
    np.testing.assert_allclose(close[5], whole[5] - np.log(2), atol=1e-5)
    assert (close[0] > 0).sum() == (rgb[..., 0] > 0).sum()


def test_an_image_that_is_hardly_larger_is_looked_at_once():
    depth = np.full((160, 160), 1.0, np.float32)
    rgb = np.zeros((160, 160, 3), np.uint8)
    assert logits_by(bright, (112, 128), 256, rgb, depth, preset("overhead", 160)).shape == (
        112,
        112,
    )


def test_confidence_is_the_logistic_of_its_features(fresh):
    logits = np.full((128, 8), -30.0)
    assert mask_features(logits, logits > 0).tolist() == [-6.0, 0.0]
    logits[:2, :2] = np.log(3)
    # Four pixels of chance 3 / 4 and nothing elsewhere: expected IoU 3 / 4.
    np.testing.assert_allclose(mask_features(logits, logits > 0), [np.log(3), np.log(4)])


def test_parts_of_a_mask_that_are_clearly_less_sure_than_another_are_not_in_it():
    logits = np.full((4, 8), -3.0)
    logits[0, :2], logits[1, 2], logits[3, 3:5], logits[0, 5:7] = (4.0, 0.5), 0.1, 3.1, 2.9
    # The first part has a corner in common with its weakest pixel.
    assert surest_parts(logits).nonzero()[1].tolist() == [0, 1, 2, 3, 4]
    assert surest_parts(logits - 3.5).sum() == 1
    assert not surest_parts(logits - 5).any()


def test_a_segmenter_without_views_is_refused(fresh, scene):
    with pytest.raises(MechSearchError, match="call look_for first"):
        NetworkSegmenter(fresh, (1.0, 0.0, 0.0)).segment(*scene)


def test_a_network_is_read_back_in_16_bits_and_a_damaged_one_refused(fresh, tmp_path):
    file = tmp_path / "network.safetensors"
    save_segmentation_network(file, fresh, (1.0, 2.0, 3.0), {})
    network, confidence = load_segmentation_network(file)
    assert confidence == (1.0, 2.0, 3.0)
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(tensor, fresh.state_dict()[name], atol=2e-3, rtol=1e-3)
    data = bytearray(file.read_bytes())
    data[-9] ^= 1
    file.write_bytes(data)
    with pytest.raises(MechSearchError, match="damaged"):
        load_segmentation_network(file)


def test_the_shipped_network_is_the_one_of_its_card_and_small():
    card = json.loads(SHIPPED.with_suffix(".json").read_text())
    assert card["sha256"] == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()
    assert SHIPPED.stat().st_size < 2.3e6


def test_the_shipped_network_finds_targets_that_it_never_saw_as_such():
    config = ImageConfig(
        1, "all", 24, ("stereo",), randomised=False, also=(), variants=0, without=()
    )
    seen = see_heaps(Path("household-single"), "", config)
    found = found_by(network_segmenter(), seen, partly_hidden(seen.images))
    assert len(found.iou) >= 20
    # A heap has 5, 10 or 15 objects, so that guesses would be right in 12 %.
    assert found.right.mean() > 0.5
    assert found.summary["iou"] > 0.45
    # What it is sure of is right more often than what it is not.
    sure = found.confidence >= np.median(found.confidence)
    assert found.iou[sure].mean() > found.iou[~sure].mean()


def test_a_raised_bound_lowers_all_logits(fresh, scene, make_box):
    network, found = copy.deepcopy(fresh), []
    for bound in (0.0, 1.5):
        network.raise_bound(bound)
        segmenter = NetworkSegmenter(network, (1.0, 0.0, 0.0))
        segmenter.look_for(render_references(make_box("box", (0.1, 0.05, 0.03))))
        found.append(segmenter.logits(*scene))
    np.testing.assert_allclose(found[0] - found[1], 1.5, atol=1e-4)
