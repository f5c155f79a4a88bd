"""A training of the estimate of occlusion can be cut off, and its chances are what they say."""

import numpy as np
import pytest
import torch

from mechsearch.segmentation import fitting
from mechsearch.segmentation import occlusion_training as training
from mechsearch.segmentation.occlusion import make_estimator, silhouette_areas
from mechsearch.segmentation.occlusion_training import OcclusionTrainConfig, train_occlusion
from mechsearch.types import MechSearchError


@pytest.fixture(autouse=True)
def often(monkeypatch):
    monkeypatch.setattr(fitting, "_EVERY", 2)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_a_training_that_was_cut_off_goes_on_to_the_same_network(seen, tmp_path):
    config = OcclusionTrainConfig(updates=4, batch=8, validation=0.3)
    whole = train_occlusion(seen, config, tmp_path / "whole")
    calls = []

    def cut(label, done, total):
        calls.append(done)
        if done == 3 and len(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_occlusion(seen, config, tmp_path / "cut", cut)
    assert train_occlusion(seen, config, tmp_path / "cut", cut) == whole
    assert calls == [1, 2, 3, 3, 4]
    one, other = (
        (tmp_path / name / "network.safetensors").read_bytes() for name in ("whole", "cut")
    )
    assert one == other
    believed = make_estimator(tmp_path / "whole" / "network.safetensors").estimate(
        np.zeros((3, 48, 48), np.float32), np.zeros(5, np.float32)
    )
    assert 0 < believed.uncovered < 1
    assert 0 < believed.hidden < 1
    with pytest.raises(MechSearchError, match="holds a training with another seed"):
        train_occlusion(
            seen, OcclusionTrainConfig(updates=4, batch=8, validation=0.3, seed=1), tmp_path / "cut"
        )


def test_examples_are_of_objects_on_the_images_with_what_is_hidden_of_them(seen):
    areas = [silhouette_areas(views.mask, views.width) for views in seen.references]
    found = training.examples(seen.images, np.arange(6), areas, np.random.default_rng(0))
    assert found.patch.shape == (len(found.hidden), 3, 48, 48)
    assert len(found.hidden) == len(found.numbers) <= 24
    assert set(found.hidden.tolist()) <= set(seen.images.hidden.ravel().tolist())


def test_scores_are_those_counted_by_hand():
    """By chance from the first on: right, right, wrong, right; occlusion off by .5, .5, .1, 0."""
    logits = np.array([[4.0, 0.0], [3.0, 0.0], [2.0, 0.0], [1.0, -30.0]])
    found = training.scores(logits, np.array([0.0, 0.0, 0.6, 0.0]))
    assert found["error"] == pytest.approx((0.5 + 0.5 + 0.1 + 0) / 4)
    assert found["average_precision"] == pytest.approx((1 + 1 + 3 / 4) / 3)
    assert found["recall"] == pytest.approx(2 / 3)


def test_calibrated_chances_come_true_as_often():
    rng = np.random.default_rng(0)
    logits = rng.normal(0, 3, 20000)
    right = rng.random(20000) < 1 / (1 + np.exp(-(0.5 * logits - 1)))
    assert training.fitted_chance(logits, right) == pytest.approx([0.5, -1.0], abs=0.06)


def test_a_wrong_number_is_refused():
    with pytest.raises(MechSearchError, match="batch is 0; expected more than 0"):
        OcclusionTrainConfig(batch=0)
    with pytest.raises(MechSearchError, match="a validation share of 1"):
        OcclusionTrainConfig(validation=1.0)
