"""Every image of tests/corpus/images, as a depth image and as a mask.

make_images.py says what is in them; what is expected comes from the scene, not from a reader.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mechsearch.grasp.image_files import depth_in_metres, read_stored, target_pixels
from mechsearch.types import MechSearchError

FOLDER = Path(__file__).parents[1] / "corpus" / "images"
EIGHT = "keeps no depth; expected 16-bit grey"
# By name: what it is as a depth image, and as a mask. None: the scene, else the words of refusal.
OUTCOMES = {
    "depth_16_bits.png": (None, "values 740, 760, 800; choose the target's by --label"),
    "depth_16_bits_thrice.png": (None, r"shape \(240, 320, 3\)"),
    "depth_16_bits_colour.png": ("is in colour", r"shape \(240, 320, 3\)"),
    "depth_float.tif": (None, "values 0.74, 0.76, 0.8; so it would be the whole image"),
    "depth_8_bits.png": (EIGHT, "values 74, 76, 80"),
    "depth_8_bits.jpg": (EIGHT, "values 72, 73, 74"),
    "depth_palette.png": (EIGHT, "values 74, 76, 80"),
    "depth_colour.png": (EIGHT, "values 74, 76, 80"),
    "mask_white.png": (EIGHT, None),
    "mask_ones.png": (EIGHT, None),
    "mask_bilevel.png": (EIGHT, None),
    "mask_16_bits.png": ("not tried", None),
    "mask_inverted_palette.png": (EIGHT, None),
    "mask_red_palette.png": (EIGHT, None),
    "mask_transparent_palette.png": (EIGHT, None),
    "mask_colour.png": (EIGHT, None),
    "mask_alpha_of_white.png": (EIGHT, None),
    "mask_alpha_of_black.png": (EIGHT, None),
    "mask_opaque.png": (EIGHT, None),
    "mask_photograph.png": (EIGHT, None),
    "mask_jpeg.jpg": (EIGHT, None),
    "mask_soft.png": (EIGHT, "not tried"),
    "labels.png": (EIGHT, "values 0, 1, 2; choose the target's by --label"),
    "labels_palette.png": (EIGHT, "values 0, 1, 2; choose the target's by --label"),
    "mask_red_on_white.png": (EIGHT, "2 colours, #c80000, #ffffff; expected one, on black"),
    "mask_all_white.png": (EIGHT, "holds 255 alone; so it would be the whole image"),
    "mask_of_nothing.png": (EIGHT, "not tried"),
    "torn.png": ("is damaged", "is damaged"),
}


@pytest.fixture(scope="module")
def scene():
    depth = np.full((240, 320), 0.8, np.float32)
    depth[100:130, 120:190] = 0.76
    depth[150:200, 60:90] = 0.74
    return depth


def test_no_image_is_left_out():
    assert {path.name for path in FOLDER.iterdir()} == {*OUTCOMES, "view.npz"}


@pytest.mark.parametrize("name", OUTCOMES)
def test_an_image_is_the_scene_or_is_refused_in_words(name, scene):
    def depth():
        metre = 1.0 if name.endswith(".tif") else 0.001
        return depth_in_metres(read_stored(FOLDER / name, "depth image"), metre)

    def mask():
        return target_pixels(read_stored(FOLDER / name, "mask"))

    for read, said, expected in zip(
        (depth, mask), OUTCOMES[name], (scene, scene == np.float32(0.76)), strict=True
    ):
        if said is None:
            np.testing.assert_allclose(read(), expected, atol=1e-6)
        elif said != "not tried":
            with pytest.raises(MechSearchError, match=said):
                read()


def test_a_label_chooses_among_several(scene):
    for name in ("labels.png", "labels_palette.png"):
        stored = read_stored(FOLDER / name, "mask")
        np.testing.assert_array_equal(target_pixels(stored, 2), scene == np.float32(0.74))
        with pytest.raises(MechSearchError, match="no pixel of the mask is 7; it holds the values"):
            target_pixels(stored, 7)


def test_soft_edges_count_from_their_middle_on(scene):
    found = target_pixels(read_stored(FOLDER / "mask_soft.png", "mask"))
    wrong = found != (scene == np.float32(0.76))
    assert wrong.sum() == 4  # the corners
    assert wrong[[100, 100, 129, 129], [120, 189, 120, 189]].all()


TARGET = np.pad(np.ones((2, 3)), ((1, 1), (2, 2))) > 0
NOISE = np.linspace(-0.05, 0.05, TARGET.size).reshape(TARGET.shape)


@pytest.mark.parametrize(
    "mask",
    [
        TARGET,
        TARGET[..., None],
        TARGET[None],
        TARGET.astype(np.int64),
        TARGET * 255.0,
        np.where(TARGET, 5, -1),
        np.where(TARGET, 1.0, np.nan),
        np.where(TARGET, 0.9, 0.1) + NOISE,
        np.where(TARGET, 0.9, np.nan) + NOISE,
        np.repeat(np.where(TARGET, 255, 0).astype(np.uint8)[..., None], 3, -1),
    ],
)
def test_arrays_that_mean_one_thing_are_understood(mask):
    np.testing.assert_array_equal(target_pixels(mask), TARGET)


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        (np.where(TARGET, 4, -4) + NOISE, "28 values from .*; those of logits x are"),
        (np.where(TARGET, 0, -1), "values -1, 0"),
        (np.where(TARGET, 2, 1), "values 1, 2"),
        (TARGET | True, "1 alone"),
        (np.where(NOISE > 0.04, 0, np.where(TARGET, 1, -1)), "values -1, 0, 1"),
        (np.where(TARGET, np.inf, -np.inf), "values -inf, inf"),
        (np.where(TARGET, "yes", "no"), "expected numbers"),
        (TARGET.ravel(), "expected .H, W."),
    ],
)
def test_arrays_that_could_mean_several_things_are_refused(mask, said):
    with pytest.raises(MechSearchError, match=said):
        target_pixels(mask)


def test_what_cannot_be_a_depth_is_refused():
    for depth, said in [
        (np.full((4, 4), -0.8), "16 pixels of the depth image are negative, down to -0.8"),
        (np.ones((4, 4), np.uint8), "of uint8, which keeps no depth"),
        (np.ones((4, 4), bool), "of bool, which keeps no depth"),
        (np.ones((4, 4, 4)), r"has shape \(4, 4, 4\)"),
    ]:
        with pytest.raises(MechSearchError, match=said):
            depth_in_metres(depth)
    for scale in (0.0, -0.001, np.nan):
        with pytest.raises(MechSearchError, match="expected a positive number"):
            depth_in_metres(np.ones((4, 4)), scale)


def test_the_first_bytes_tell_what_a_file_is(tmp_path):
    np.save(tmp_path / "depth.npy", np.eye(3))
    (tmp_path / "depth.npy").rename(tmp_path / "DEPTH.NPY")
    np.testing.assert_array_equal(read_stored(tmp_path / "DEPTH.NPY", "depth image"), np.eye(3))
    Image.new("L", (3, 2)).save(tmp_path / "mask.png")
    (tmp_path / "mask.png").rename(tmp_path / "mask")
    assert read_stored(tmp_path / "mask", "mask").size == (3, 2)
