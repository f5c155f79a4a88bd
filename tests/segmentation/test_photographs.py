"""A user's photographs become the views that they show, or it is said which one cannot."""

import numpy as np
import pytest
from PIL import Image

from mechsearch.cli import main
from mechsearch.segmentation.photographs import (
    load_references,
    save_references,
    views_of_photographs,
)
from mechsearch.segmentation.reference import cut_out
from mechsearch.types import MechSearchError

RGB = np.full((90, 120, 3), 90, np.uint8)
MASK = np.zeros((90, 120), np.bool_)
MASK[10:50, 20:60] = True
RGB[MASK] = (200, 40, 10)


def picture(path, array):
    Image.fromarray(np.asarray(array, np.uint8)).save(path)
    return path


@pytest.fixture
def folder(tmp_path):
    """Two photographs of one object: one with a mask beside it, one cut out already."""
    picture(tmp_path / "a.png", RGB)
    picture(tmp_path / "a-mask.png", 255 * MASK)
    picture(tmp_path / "b.png", np.dstack([RGB, 255 * MASK]))
    return tmp_path


def same(one, other):
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in ("rgb", "mask", "width"))


def test_views_are_cut_out_by_masks_beside_photographs_or_in_them(folder, tmp_path):
    main(["segment", "reference", str(folder), "--out", str(tmp_path / "cup.npz")])
    assert same(load_references(tmp_path / "cup.npz"), cut_out([RGB, RGB], [MASK, MASK]))


def test_the_side_of_a_pixel_gives_the_width(folder):
    found = views_of_photographs([folder / "b.png"], 0.002)
    assert found.width == pytest.approx([40 * 1.05 * 0.002])


def test_a_photograph_is_read_as_it_is_shown(tmp_path):
    """It was taken with the camera on its side, as its EXIF says; the mask is as people see it."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.rot90(RGB)).save(tmp_path / "a.png", exif=exif)
    picture(tmp_path / "a-mask.png", 255 * MASK)
    assert same(views_of_photographs([tmp_path]), cut_out([RGB], [MASK]))


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a-mask.png", None, "a.png has no mask; expected a-mask.png beside it"),
        ("a-mask.png", 0 * MASK, "a.png: the mask of reference view 0 has 0 pixels"),
        ("a-mask.png", np.eye(90, 120) * (np.arange(120) < 9) * 255, "has 9 pixels; expected at"),
        ("a-mask.png", 255 * MASK[:40], r"a.png: reference view 0 is .* with a mask \(40, 120\)"),
        ("a-mask.png", np.arange(10800).reshape(90, 120) % 7, "a-mask.png: the mask holds"),
        ("a.png", None, "no photograph at .*a.png"),
    ],
)
def test_a_photograph_without_a_good_mask_is_named(folder, name, array, words):
    if array is None:
        (folder / name).unlink()
    else:
        picture(folder / name, array)
    with pytest.raises(MechSearchError, match=words):
        views_of_photographs([folder / "a.png"])


def test_no_photograph_no_picture_and_no_file_of_views_are_refused(folder, tmp_path):
    (tmp_path / "empty").mkdir()
    for paths in ([], [tmp_path / "empty"]):
        with pytest.raises(MechSearchError, match="no photograph in"):
            views_of_photographs(paths)
    (tmp_path / "empty" / "c.png").write_text("no picture")
    with pytest.raises(MechSearchError, match=r"the photograph at .*c.png is damaged, or no"):
        views_of_photographs([tmp_path / "empty"])
    with pytest.raises(MechSearchError, match="side of a pixel is -1"):
        views_of_photographs([folder], -1.0)
    np.savez(tmp_path / "other.npz", rgb=RGB)
    with pytest.raises(MechSearchError, match=r"holds rgb \(90, 120, 3\) of uint8; expected what"):
        load_references(tmp_path / "other.npz")
    save_references(tmp_path / "views.npz", views_of_photographs([folder]))
    assert same(load_references(tmp_path / "views.npz"), views_of_photographs([folder]))
