import json

import numpy as np
import pytest
from PIL import Image

from mechsearch.camera import Camera
from mechsearch.grasp.depth_image import read_view, view_of_image
from mechsearch.grasp.graspability import rate
from mechsearch.grasp.network import load_network
from mechsearch.types import MechSearchError


@pytest.fixture
def files(tmp_path, bumpy):
    mask = np.zeros(bumpy.shape, np.uint8)
    mask[50:70, 60:90] = 255
    k = np.array([[552.5, 0, 79.5], [0, 552.5, 59.5], [0, 0, 1]])
    np.savez(tmp_path / "all.npz", depth=bumpy, mask=mask, K=k)
    np.save(tmp_path / "depth.npy", bumpy)
    Image.fromarray(mask).save(tmp_path / "mask.png")
    Image.fromarray(np.round(bumpy * 1000).astype(np.uint16)).save(tmp_path / "depth_mm.png")
    numbers = {"fx": 552.5, "fy": 552.5, "cx": 79.5, "cy": 59.5}
    (tmp_path / "camera.json").write_text(json.dumps(numbers))
    return tmp_path


def test_all_formats_hold_the_same_view(files):
    one, camera = read_view(files / "all.npz")
    other, same = read_view(files / "depth.npy", files / "mask.png", files / "camera.json")
    np.testing.assert_array_equal(one.depth, other.depth)
    np.testing.assert_array_equal(one.mask, other.mask)
    assert one.camera == other.camera == camera == same
    millimetres, _ = read_view(
        files / "depth_mm.png", files / "mask.png", files / "camera.json", scale=0.001
    )
    np.testing.assert_allclose(millimetres.depth, one.depth, atol=6e-4)


def test_files_that_do_not_fit_are_refused_in_words(files, bumpy):
    depth, mask, camera = files / "depth.npy", files / "mask.png", files / "camera.json"

    def refused(text, *arguments):
        with pytest.raises(MechSearchError, match=text):
            read_view(*arguments)

    refused("is it in millimetres", files / "depth_mm.png", mask, camera)
    refused("name a file for the mask too", depth, None, camera)
    refused("name a file for the intrinsics too", depth, mask, None)
    refused("no depth image at", files / "absent.npy", mask, camera)
    (files / "broken.png").write_text("no picture")
    refused("the mask at .* is damaged", depth, files / "broken.png", camera)
    np.savez(files / "odd.npz", depth=bumpy, mask=bumpy > 0.78)
    refused("lacks fx, fy, cx, cy; it has depth, mask", files / "odd.npz")
    np.savez(files / "odd.npz", depth=bumpy)
    refused("has no array 'mask'; it has depth", files / "odd.npz")
    np.save(files / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    refused("is damaged", files / "objects.npy", mask, camera)


@pytest.fixture
def scene():
    """A block 4 cm high on a table, another one beside it: depth (240, 320), mask, camera."""
    depth = np.full((240, 320), 0.8, np.float32)
    depth[100:130, 120:190] = 0.76
    depth[150:200, 60:90] = 0.74
    camera = Camera(320, 240, 552.5, 552.5, 159.5, 119.5, tuple(np.eye(4).ravel()))
    return depth, depth == np.float32(0.76), camera


@pytest.mark.filterwarnings("error")
def test_a_clean_image_has_the_graspability_that_it_always_had(scene):
    view = view_of_image(*scene)
    np.testing.assert_array_equal(view.depth, scene[0])
    assert view.far == np.float32(0.8)
    assert rate(load_network(), view).graspability.score == pytest.approx(0.836, abs=5e-4)


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        (np.s_[5, 5], 65.535, "1 deeper than the table at 0.800 m, down to 65.535 m"),
        (np.s_[115, 150], 65535.0, "1 deeper than the table"),
        (np.s_[100:240:20, 200:320:30], 0.83, "28 deeper than the table at 0.800 m, down to 0.830"),
        (np.s_[:, 280:], 1.5, "9600 deeper than the table"),
        (np.s_[115, 150], 0.3, "1 of the mask above the target at 0.760 m, up to 0.300 m"),
        (np.s_[115:118, 150:153], 0.74, "9 of the mask above the target"),
    ],
    ids=["far", "far on the target", "specks", "a floor beside the table", "near", "a near patch"],
)
def test_pixels_that_cannot_belong_there_are_named_and_change_nothing(scene, where, value, said):
    depth, mask, camera = scene
    strange = depth.copy()
    strange[where] = value
    with pytest.warns(UserWarning, match=said):
        view = view_of_image(strange, mask, camera)
    np.testing.assert_array_equal(view.depth, depth)
    np.testing.assert_array_equal(view.mask, mask)
    np.testing.assert_array_equal(view.gripper_depths, view_of_image(*scene).gripper_depths)


def test_the_table_is_where_it_is_in_spite_of_noise(scene):
    depth, mask, camera = scene
    noisy = depth + np.random.default_rng(0).normal(0, 0.002, depth.shape)
    assert view_of_image(noisy, mask, camera).far == pytest.approx(0.8, abs=2e-4)


# Odd sides: the middle of no new pixel lies between two old ones.
@pytest.mark.parametrize("size", [(961, 721), (161, 121)])
def test_an_image_too_large_or_small_is_resized_as_its_owner_would(scene, size):
    depth, mask, _ = scene

    def scaled(image, size):
        return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.NEAREST))

    brought = scaled(depth, size), scaled(mask, size)
    focal = 552.5 * size[0] / 320
    level = tuple(np.eye(4).ravel())
    camera = Camera(*size, focal, focal, size[0] / 2 - 0.5, size[1] / 2 - 0.5, level)
    # 5 cm at 0.76 m are to be 34.5 px.
    factor = 34.5 / (focal * 0.05 / np.float32(0.76))
    to = round(size[0] * factor), round(size[1] * factor)
    f = focal * to[0] / size[0], focal * to[1] / size[1]
    by_hand = Camera(*to, *f, to[0] / 2 - 0.5, to[1] / 2 - 0.5, level)
    one = view_of_image(*brought, camera)
    other = view_of_image(*(scaled(image, to) for image in brought), by_hand)
    np.testing.assert_array_equal(one.depth, other.depth)
    np.testing.assert_array_equal(one.mask, other.mask)
    found = [getattr(one.camera, n) - getattr(by_hand, n) for n in ("fx", "fy", "cx", "cy")]
    np.testing.assert_allclose(found, 0, atol=1e-9)
