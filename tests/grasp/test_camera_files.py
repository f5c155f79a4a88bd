"""Every file of tests/corpus/cameras, which all mean the same camera or are refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from mechsearch.grasp.camera_files import camera_of, read_camera
from mechsearch.types import MechSearchError

FOLDER = Path(__file__).parents[1] / "corpus" / "cameras"
GOOD = (
    *("four.json", "perception.intr", "realsense.json", "matrix.json", "nine.json", "bare.json"),
    *("by_columns.json", "nested.json", "windows.yaml", "matrix.txt", "calibration.yaml"),
    *("opencv.yaml", "camera_info.yaml"),
)
BAD = {
    "not_a_number.json": "cx nan, .*expected finite numbers",
    "other_size.json": "for an image of width 640 and height 480, but the depth image has 320",
    "twice.json": "expected cx and cy in the image: is this the camera of a larger one",
    "no_camera.json": r"is no camera's matrix.*expected \[\[fx, 0, cx\]",
    "short.json": r"has shape \(3,\); expected \(3, 3\)",
    "word.json": "cx is 'wide'; expected numbers",
    "normalised.json": "expected focal lengths of 64 to 16000 px",
    "negative.json": "fy -552.5, .*expected focal lengths",
    "squeezed.json": "expected square pixels",
    "half.json": "lacks fy, cy; it has fx, cx; expected fx, fy",
    "contradiction.json": "has fx 600, and 552.5 in K",
    "torn.json": "are damaged, or no JSON, YAML or matrix",
    "empty.yaml": "has no names; expected fx, fy",
}


def numbers(camera):
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


def test_no_camera_is_left_out():
    assert {path.name for path in FOLDER.iterdir()} == {*GOOD, *BAD, "distorted.yaml"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", GOOD)
def test_every_usual_spelling_is_the_same_camera(name):
    camera = read_camera(FOLDER / name, (240, 320))
    assert numbers(camera) == (320, 240, 552.5, 552.5, 159.5, 119.5)
    np.testing.assert_array_equal(camera.pose, np.eye(4))


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_camera_of_this_image_is_refused_in_words(name):
    with pytest.raises(MechSearchError, match=BAD[name]):
        read_camera(FOLDER / name, (240, 320))


def test_a_distortion_is_named():
    with pytest.warns(UserWarning, match=r"distortion_coefficients \[0.12, -0.25.*not undone"):
        camera = read_camera(FOLDER / "distorted.yaml", (240, 320))
    assert camera.fx == 552.5
    four = json.loads((FOLDER / "four.json").read_text())
    with pytest.warns(UserWarning, match=r"k1 \[0.1\]"):
        camera_of({**four, "distortion": {"model": "radial", "k1": 0.1}}, (240, 320), "here")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("none", [None, "plumb_bob", [], [0, 0.0], {"model": "radial", "k1": 0}])
def test_no_distortion_is_none(none):
    four = json.loads((FOLDER / "four.json").read_text())
    assert camera_of({**four, "distortion": none}, (240, 320), "here").fx == 552.5


def test_a_part_of_a_larger_image_may_have_its_axis_outside_if_it_tells_its_size():
    part = json.loads((FOLDER / "twice.json").read_text())
    camera = camera_of({**part, "width": 320, "height": 240}, (240, 320), "here")
    assert (camera.cx, camera.cy) == (319.5, 239.5)


def test_arrays_are_read_too(tmp_path):
    k = np.array([[552.5, 0, 159.5], [0, 552.5, 119.5], [0, 0, 1]])
    np.save(tmp_path / "k.npy", k)
    np.savez(tmp_path / "k.npz", camera_matrix=k, dist=np.zeros(5), width=320)
    for name in ("k.npy", "k.npz"):
        camera = read_camera(tmp_path / name, (240, 320))
        assert numbers(camera) == (320, 240, 552.5, 552.5, 159.5, 119.5)
    with pytest.raises(MechSearchError, match="no intrinsics at"):
        read_camera(tmp_path / "absent.json", (240, 320))
