"""Light in pictures: what lies on what, and how high the end effector is."""

import numpy as np

from mechsearch.camera import preset
from mechsearch.pictures.canvas import photographed
from mechsearch.render.renderer import Renderer

SIZE = 512
CAMERA = preset("overhead", SIZE)


def grey(boxes, heights, place=(0.0, 0.0)):
    """Return the brightness (H, W) of a small cube at a place and height, and a plate far away."""
    models, poses = [boxes.models["small0"], boxes.models["plate"]], np.zeros((2, 7))
    poses[:, 3], poses[0, :2], poses[0, 2], poses[1, :3] = 1, place, heights, (-0.3, 0.3, 0.01)
    image = photographed(Renderer(models), CAMERA, poses, 1)
    return np.asarray(image, np.float64).mean(axis=2)


def brightness(image, x, y):
    column, row, _ = CAMERA.project([x, y, 0.0])
    return image[round(row) - 1 : round(row) + 2, round(column) - 1 : round(column) + 2].mean()


def test_the_shadow_is_the_farther_away_the_higher_something_is(boxes):
    # The lamp is at (0.75, 0.55, 1.15): a point at height h throws its shadow h / (1.15 - h) of
    # the way from the lamp beyond it.
    for height in (0.05, 0.15, 0.25):
        image, beyond = grey(boxes, height), height / (1.15 - height)
        table = brightness(image, 0.3, -0.3)
        assert brightness(image, -0.75 * beyond, -0.55 * beyond) < 0.75 * table
        other = (height + 0.15) / (1.15 - height - 0.15)
        assert brightness(image, -0.75 * other, -0.55 * other) > 0.9 * table
        assert brightness(image, 0.75 * beyond, 0.55 * beyond) > 0.9 * table


def test_the_table_is_evenly_lit_and_darker_where_something_stands_on_it(boxes):
    image = grey(boxes, 0.015)
    table = image[290:420, 320:500]
    assert np.ptp(table) < 2
    # On the lamp's side, where no shadow falls, one sees it touch.
    assert brightness(image, 0.019, 0.0) < 0.95 * table.mean() < brightness(image, 0.06, 0.0)


def test_edges_of_shadows_are_soft(boxes):
    image = grey(boxes, 0.25)
    way = [brightness(image, x, -0.55 * 0.25 / 0.9) for x in np.linspace(-0.3, -0.1, 200)]
    dark, light = min(way), max(way)
    between = sum(dark + 0.15 * (light - dark) < v < light - 0.15 * (light - dark) for v in way)
    # Of the 20 cm at least 6 mm on either side.
    assert between >= 12
