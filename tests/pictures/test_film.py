from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mechsearch.camera import preset
from mechsearch.pictures.canvas import tinted
from mechsearch.pictures.film import (
    PATH_COLOUR,
    Film,
    FilmConfig,
    draw_path,
    filmstrip,
    frame_steps,
    start_and_end,
)
from mechsearch.types import MechSearchError


@pytest.fixture
def film(models, make_evaluation) -> Film:
    record = make_evaluation("method", 1.0).episodes[0]
    return Film(record, models, FilmConfig(size=96, captions=False))


def greenness(image: Image.Image) -> int:
    red, green, blue = np.moveaxis(np.asarray(image).astype(int), -1, 0)
    return int(((green > red + 60) & (green > blue + 60)).sum())


def blueness(image: Image.Image) -> int:
    red, _, blue = np.moveaxis(np.asarray(image).astype(int), -1, 0)
    return int((blue > red + 100).sum())


def test_more_of_the_target_is_green_at_the_end_than_at_the_start(film: Film) -> None:
    last = len(film.record.actions)
    assert greenness(film.frame(last, until=0)) > 2 * greenness(film.frame(0)) > 0


def test_the_path_is_blue_at_the_start_and_absent_at_the_end(film: Film) -> None:
    picture = start_and_end(film)
    assert picture.size == (2 * 96 + 6, 96)
    left, right = picture.crop((0, 0, 96, 96)), picture.crop((102, 0, 198, 96))
    assert blueness(left) > 50
    assert blueness(right) == 0


def test_the_path_runs_where_the_end_effector_was() -> None:
    camera = preset("overhead", 128)
    image = Image.new("RGB", (128, 128), "white")
    positions = np.array([[-0.2, 0.1, 0.05], [0.0, 0.1, 0.05], [0.2, -0.1, 0.05]])
    draw_path(image, camera, positions)
    middle = camera.project(np.array([-0.1, 0.1, 0.05]))[:2].round().astype(int)
    assert image.getpixel(tuple(map(int, middle))) == PATH_COLOUR
    assert image.getpixel((64, 120)) == (255, 255, 255)


def test_only_the_mask_turns_green() -> None:
    rgb = np.full((40, 40, 3), (200, 40, 40), np.uint8)
    mask = np.zeros((40, 40), np.bool_)
    mask[10:20, 10:20] = True
    before = rgb.copy()
    result = tinted(rgb, mask).astype(int)
    np.testing.assert_array_equal(rgb, before)
    green = (result[..., 1] > result[..., 0]) & (result[..., 1] > result[..., 2])
    np.testing.assert_array_equal(green, mask)


def luminance(rgb):
    """Return what is left of colours in grey print, from 0 to 1 (ITU-R BT.709)."""
    return np.asarray((np.asarray(rgb) / 255) ** 2.2 @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("colour", [(230, 220, 80), (200, 40, 40), (150, 150, 150), (20, 20, 20)])
def test_the_mask_is_marked_without_its_colour_too(colour) -> None:
    rgb = np.full((40, 40, 3), colour, np.uint8)
    mask = np.zeros((40, 40), np.bool_)
    mask[10:20, 10:20] = True
    row = luminance(tinted(rgb, mask))[15]
    # From outside: white, then dark.
    assert row[9] > 0.9
    assert row[10] < 0.1


def test_nothing_but_the_target_is_green_whatever_the_colours() -> None:
    steps = np.arange(0, 256, 15, np.uint8)
    rgb = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(18, -1, 3)
    drawn = tinted(rgb, np.zeros(rgb.shape[:2], np.bool_)).astype(int)
    assert (drawn[..., 1] <= drawn[..., ::2].max(axis=2)).all()
    # Light and dark stay, but for what clipping and rounding take.
    darker = rgb.astype(int).mean(axis=2) - drawn.mean(axis=2)
    assert (np.abs(darker) < 1.1)[drawn.max(axis=2) < 255].all()
    # Half grey it is (65, 145, 60), with no more green than red (65, 65, 60), as light (92, ...).
    leaf = tinted(np.full((4, 4, 3), (40, 200, 30), np.uint8), np.zeros((4, 4), np.bool_))
    np.testing.assert_array_equal(leaf[0, 0], [92, 92, 85])


def test_an_invisible_target_leaves_nothing_green() -> None:
    rgb = np.full((20, 20, 3), 120, np.uint8)
    np.testing.assert_array_equal(tinted(rgb, np.zeros((20, 20), np.bool_)), rgb)


@pytest.mark.parametrize(
    ("last", "frames", "steps"),
    [(8, 5, [0, 2, 4, 6, 8]), (1, 5, [0, 1]), (0, 2, [0]), (50, 3, [0, 25, 50])],
)
def test_frames_are_spread_evenly_from_start_to_end(last, frames, steps) -> None:
    assert frame_steps(last, frames) == steps


def test_a_filmstrip_has_as_many_frames_as_asked_for(film: Film) -> None:
    assert filmstrip(film, 4).width == 4 * 96 + 3 * 6
    with pytest.raises(MechSearchError, match="a filmstrip of 1 frames"):
        filmstrip(film, 1)


def test_captions_add_a_line_below(models, make_evaluation) -> None:
    record = make_evaluation("method", 1.0).episodes[0]
    frame = Film(record, models, FilmConfig(size=96)).frame(0)
    assert frame.width == 96
    assert frame.height > 96


def test_the_pusher_is_drawn_where_it_is_given(models, make_evaluation) -> None:
    record = make_evaluation("method", 1.0).episodes[0]
    config = FilmConfig(size=96, captions=False)
    without = Film(record, models, config).frame(3, until=0)
    pushed = Film(record, models, config, models["small1"]).frame(3, until=0)
    assert np.asarray(without).tolist() != np.asarray(pushed).tolist()


def test_another_object_set_is_refused(models, make_evaluation) -> None:
    record = make_evaluation("method", 1.0).episodes[0]
    fewer = {name: model for name, model in models.items() if name != "lid"}
    with pytest.raises(MechSearchError, match="lacks: lid"):
        Film(record, fewer, FilmConfig())


def test_what_the_frame_cuts_is_noted_in_the_picture(models, make_evaluation) -> None:
    """The lid is still in view when the cube, the target, is half beyond the frame of 0.70 m."""
    record = make_evaluation("method", 1.0).episodes[0]

    def noted(x: float) -> int:
        poses = record.poses.copy()
        poses[:, 2, 0] = x
        frame = Film(replace(record, poses=poses), models, FilmConfig(size=192)).frame(0, until=0)
        return int((np.asarray(frame)[170:192] == 255).all(axis=2).sum())

    assert noted(0.0) == noted(0.29) == 0
    assert noted(0.34) > noted(0.6) > 200
