import json

import numpy as np
import pytest
from PIL import Image

from mechsearch.grasp.depth_image import read_view
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
    one = read_view(files / "all.npz", None, None)
    other = read_view(files / "depth.npy", files / "mask.png", files / "camera.json")
    np.testing.assert_array_equal(one.depth, other.depth)
    np.testing.assert_array_equal(one.mask, other.mask)
    assert one.camera == other.camera
    millimetres = read_view(
        files / "depth_mm.png", files / "mask.png", files / "camera.json", scale=0.001
    )
    np.testing.assert_allclose(millimetres.depth, one.depth, atol=6e-4)


def test_files_that_do_not_fit_are_refused_in_words(files, bumpy):
    depth, mask, camera = files / "depth.npy", files / "mask.png", files / "camera.json"

    def refused(text, *arguments):
        with pytest.raises(MechSearchError, match=text):
            read_view(*arguments)

    refused("divide millimetres by 1000", files / "depth_mm.png", mask, camera)
    refused("name a file for the mask too", depth, None, camera)
    refused("name a file for the intrinsics too", depth, mask, None)
    refused("no depth at", files / "absent.npy", mask, camera)
    refused("no intrinsics at", depth, mask, files / "absent.json")
    (files / "few.json").write_text('{"fx": 1.0, "cx": "wide"}')
    refused("lacks a number for fy, cx, cy", depth, mask, files / "few.json")
    (files / "list.json").write_text("[1, 2]")
    refused("is no JSON object", depth, mask, files / "list.json")
    (files / "broken.png").write_text("no picture")
    refused("the mask at .* is damaged", depth, files / "broken.png", camera)
    np.savez(files / "odd.npz", depth=bumpy, mask=bumpy)
    refused("has no array 'K'; it has depth, mask", files / "odd.npz", None, None)
    np.savez(files / "odd.npz", depth=bumpy, mask=bumpy, K=np.zeros(3))
    refused("expected .3, 3.", files / "odd.npz", None, None)
    np.save(files / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    refused("is damaged", files / "objects.npy", mask, camera)
