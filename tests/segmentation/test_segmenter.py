"""Segmenters by name, and what becomes of what they find."""

import sys

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env import HeapEnv, HeapEnvConfig, RetrieveConfig, TaskConfig
from mechsearch.evaluation.rollout import evaluate, replay_all
from mechsearch.heaps.dataset import embedded_file
from mechsearch.objects.model import ObjectSet
from mechsearch.segmentation.segmenter import (
    TargetFinder,
    check_segmenter,
    make_segmenter,
    resized,
    visible_target,
)
from mechsearch.types import MechSearchError

CAMERA = preset("overhead", 128)
RGB, DEPTH = np.zeros((128, 128, 3), np.uint8), np.ones((128, 128), np.float32)

OWN = """
import numpy as np

class Reddish:
    def look_for(self, references):
        self.target = references.rgb[references.mask].mean(axis=0)

    def segment(self, rgb, depth, camera):
        away = np.abs(rgb.astype(float) - self.target).max(axis=2)
        return away < 90, 0.9

class Unsure(Reddish):
    def segment(self, rgb, depth, camera):
        return super().segment(rgb, depth, camera)[0], 0.3

class Half:
    def look_for(self, references): ...

class Follow:
    keys = ("position_image",)

    def reset(self, rng): ...

    def act(self, obs):
        return 4 * obs["position_image"].mean(axis=(1, 2)).astype(np.float32)
"""


class Gives:
    """Gives the same mask and confidence for all."""

    def __init__(self, *found):
        self.found = found

    def look_for(self, references): ...

    def segment(self, rgb, depth, camera):
        return self.found


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A module of a user's segmenters."""
    (tmp_path / "ownsegmenter.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    yield "ownsegmenter"
    sys.modules.pop("ownsegmenter", None)


@pytest.fixture(scope="module")
def coloured(boxes):
    """The boxes; the cube is red, what lies on it blue."""
    from dataclasses import replace

    colours = {"cube": (220, 20, 20), "lid": (20, 20, 220)}
    return ObjectSet("boxes", {
        name: replace(model, texels=np.full((12, 1, 3), colours.get(name, 180), np.uint8))
        for name, model in boxes.models.items()
    }, {})  # fmt: skip


def observed(covered, objects, **config):
    env = HeapEnv([covered], objects, HeapEnvConfig(**config))
    return env.reset(seed=0, options={"heap": 0, "fixed_start": True})[0]


def mask(pixels):
    found = np.zeros((128, 128), np.bool_)
    found.ravel()[:pixels] = True
    return found


def test_a_policy_sees_the_target_where_a_segmenter_of_ones_own_does(covered, coloured, own):
    true = observed(covered, coloured, image_size=128)
    found = observed(covered, coloured, image_size=128, segmenter=f"{own}:Reddish")
    seen = [(obs["position_image"] != 0).any(axis=0) for obs in (true, found)]
    assert seen[0].sum() > 20
    for key in true:
        np.testing.assert_array_equal(true[key], found[key])


def test_a_segmenter_looks_at_the_mounted_cameras_own_image(covered, coloured, own):
    """What it finds there is reprojected with the image, as true masks are."""
    aside = {"mounted": "35 0.9 320x240", "image_size": 128}
    true = observed(covered, coloured, **aside)
    found = observed(covered, coloured, segmenter=f"{own}:Reddish", **aside)
    for key in true:
        np.testing.assert_array_equal(true[key], found[key])


def test_what_a_segmenter_is_unsure_of_is_not_seen(covered, coloured, own):
    obs = observed(covered, coloured, segmenter=f"{own}:Unsure")
    assert not obs["position_image"].any()


def test_an_evaluation_keeps_its_segmenter_and_is_verified(own):
    task = TaskConfig(segmenter=f"{own}:Reddish", max_actions=2)
    found = evaluate(f"{own}:Follow", limit=2, task=task)
    assert found.header["env"]["segmenter"] == f"{own}:Reddish"
    assert f"segmenter true -> {own}:Reddish" in found.header["task_differs"]
    assert all(check.passed for check in replay_all(found, embedded_file("single")))


def test_the_simulators_own_masks_are_the_default(covered, boxes):
    for key, value in observed(covered, boxes, segmenter="true").items():
        np.testing.assert_array_equal(value, observed(covered, boxes)[key])


@pytest.mark.parametrize(
    ("pixels", "confidence", "seen"),
    [(50, 0.5, 50), (50, 0.49, 0), (4, 1.0, 4), (3, 1.0, 0), (0, 1.0, 0)],
)
def test_a_mask_counts_if_it_is_sure_and_not_tiny(pixels, confidence, seen):
    found, sure = visible_target(Gives(mask(pixels), confidence), RGB, DEPTH, CAMERA)
    assert found.sum() == seen
    assert sure == confidence


@pytest.mark.parametrize(
    ("found", "rgb", "depth", "words"),
    [
        ((mask(9), 0.9), RGB, 0 * DEPTH, "depth is holes alone"),
        ((mask(9), 0.9), RGB, np.nan * DEPTH, "depth is holes alone"),
        ((mask(9), 0.9), RGB[:9], DEPTH, r"colours \(9, 128, 3\) of uint8"),
        ((mask(9), 0.9), RGB / 255, DEPTH, "of float64"),
        ((mask(9), 1.1), RGB, DEPTH, r"mask \(128, 128\) and 1.1"),
        ((mask(9), np.nan), RGB, DEPTH, "and nan"),
        ((mask(9)[:5], 0.9), RGB, DEPTH, r"a mask \(5, 128\)"),
        ((mask(9),), RGB, DEPTH, "a segmenter gives a mask"),
    ],
)
def test_what_is_no_image_or_no_mask_is_refused(found, rgb, depth, words):
    with pytest.raises(MechSearchError, match=words):
        visible_target(Gives(*found), rgb, depth, CAMERA)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x", "unknown segmenter 'x'; choose true, shipped, a network's file"),
        ("true", "a simulator's own mask"),
        ("ownsegmenter:Half", "a Half without segment"),
        ("ownsegmenter:Nothing", "has no function or class 'Nothing'; it has Follow, Half"),
        ("nowhere:make", "cannot be imported"),
        (
            "missing.safetensors",
            "no mechsearch segmentation network of two looks at missing.safetensors",
        ),
    ],
)
def test_what_is_no_segmenter_is_refused(own, name, words):
    with pytest.raises(MechSearchError, match=words):
        make_segmenter(name)


def test_a_task_refuses_it_too_and_retrieval_has_the_simulators_alone():
    with pytest.raises(MechSearchError, match="unknown segmenter"):
        HeapEnvConfig(segmenter="x")
    with pytest.raises(MechSearchError, match="masks of all objects"):
        RetrieveConfig(segmenter="shipped")
    assert check_segmenter("a.b:c") == "a.b:c"


def test_a_finder_is_told_anew_when_the_target_is_another(own, coloured):
    finder = TargetFinder(f"{own}:Reddish", "overhead")
    shape = (finder.camera.height, finder.camera.width)
    red, blue = (np.full((*shape, 3), c, np.uint8) for c in [(220, 20, 20), (20, 20, 220)])
    depth = np.ones(shape, np.float32)
    for name, right, wrong in (("cube", red, blue), ("lid", blue, red), ("cube", red, blue)):
        target = coloured.models[name]
        assert finder.visible(target, right, depth, finder.camera).all()
        assert not finder.visible(target, wrong, depth, finder.camera).any()


def test_a_mask_of_another_size_covers_half_of_each_pixel():
    fine = np.zeros((8, 8), np.bool_)
    fine[:3] = True
    assert resized(fine, 4).sum(axis=1).tolist() == [4, 4, 0, 0]
    fine[2, 1::2] = False
    assert resized(fine, 4).sum(axis=1).tolist() == [4, 0, 0, 0]
