"""A training of the segmentation can be cut off, and learns what it is shown."""

import numpy as np
import pytest
import torch

from mechsearch.segmentation import fitting, training
from mechsearch.segmentation.network import load_segmentation_network
from mechsearch.segmentation.training import SegmentTrainConfig, train_segmentation
from mechsearch.types import MechSearchError

SMALL = {"batch": 2, "targets": 2, "views": 2, "validation": 0.3}


@pytest.fixture(autouse=True)
def often(monkeypatch):
    monkeypatch.setattr(fitting, "_EVERY", 2)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_a_training_that_was_cut_off_goes_on_to_the_same_network(seen, tmp_path, monkeypatch):
    config = SegmentTrainConfig(updates=4, **SMALL)
    whole = train_segmentation(seen, config, tmp_path / "whole")
    calls = []

    def cut(label, done, total):
        calls.append(done)
        if done == 3 and len(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_segmentation(seen, config, tmp_path / "cut", progress=cut)
    assert train_segmentation(seen, config, tmp_path / "cut", progress=cut) == whole
    assert calls == [1, 2, 3, 3, 4]
    networks = [
        load_segmentation_network(tmp_path / name / "network.safetensors")
        for name in ("whole", "cut")
    ]
    assert networks[0][1] == networks[1][1]
    for one, other in zip(*(n.state_dict().values() for n, _ in networks), strict=True):
        assert torch.equal(one, other)
    # A training that begins with the network of another one is another one.
    with pytest.raises(MechSearchError, match="holds a training with another start"):
        train_segmentation(seen, config, tmp_path / "cut", tmp_path / "whole/network.safetensors")
    with pytest.raises(MechSearchError, match="holds a training with another seed"):
        train_segmentation(seen, SegmentTrainConfig(updates=4, seed=1, **SMALL), tmp_path / "cut")


def test_the_loss_is_zero_only_where_the_mask_is_right():
    truth = torch.zeros(2, 8, 8)
    truth[0, :4, :4] = 1
    right = 60 * truth - 30
    assert float(training._loss(right, truth)) < 1e-3
    assert float(training._loss(-right, truth)) > 10


def test_a_wrong_number_is_refused():
    with pytest.raises(MechSearchError, match="updates is 0; expected more than 0"):
        SegmentTrainConfig(updates=0)
    with pytest.raises(MechSearchError, match="a validation share of 1"):
        SegmentTrainConfig(validation=1.0)


def test_examples_show_the_objects_that_are_asked_for(seen):
    rng = np.random.default_rng(0)
    for index in range(len(seen.images)):
        crop, masks, numbers = training._example(seen.images, index, len(seen.names), 5, rng)
        assert crop.shape == (6, 80, 80)
        assert masks.shape == (5, 80, 80)
        there = set(seen.images.objects[index].tolist())
        for mask, number in zip(masks, numbers.tolist(), strict=True):
            assert mask.any() == (number in there)
