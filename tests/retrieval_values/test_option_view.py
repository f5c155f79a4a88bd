"""How options look, against numbers worked out by hand."""

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.grippers import HeightMap
from mechsearch.pushes.push import Push, Sight
from mechsearch.retrieval.grasper import Candidate
from mechsearch.retrieval_values.view import (
    MIRRORED_OPTION_NUMBERS,
    OPTION_NUMBERS,
    OPTION_PATCH,
    PushOption,
    RemovalOption,
    Situation,
    view_options,
)

DOWN = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def heights():
    """A target 5 cm high, 4 cm along x and 2 cm along y; 6 cm towards +x a block, 10 cm high."""
    x = y = np.arange(202) * 0.002 - 0.201
    x, y = np.meshgrid(x, y, indexing="ij")
    target = (np.abs(x) < 0.0201) & (np.abs(y) < 0.0101)
    height = np.where(target, 0.05, 0.0)
    height[(np.abs(x - 0.06) < 0.0101) & (np.abs(y) < 0.0201)] = 0.1
    return HeightMap(height.astype(np.float32), target, np.array([-0.201, -0.201]))


@pytest.fixture
def situation(heights):
    grasps = [
        Candidate(0, np.array([-0.003, 0.0315, 0.04, *DOWN]), 0.75),
        Candidate(0, np.array([-0.0035, 0.031, 0.03, *DOWN]), 0.25),
    ]
    return Situation(heights, np.zeros(2), grasps)


@pytest.fixture
def push():
    """Along +y, 6 cm before to 9 cm beyond the target, at 6 cm; the tip is there already."""
    sight = Sight(
        np.zeros((64, 64)), np.zeros((64, 64), np.bool_), np.array([0.0, 0.0, 0.05]),
        np.zeros((0, 3)), np.array([0.0, -0.06, 0.06]), preset("overhead"),
    )  # fmt: skip
    return PushOption.plan(Push("straight", np.pi / 2, 0.0, 0.06, 0.09, height=0.01), sight)


@pytest.fixture
def removal():
    """Of the block: the robot's grasp of it promises 0.4."""
    place = np.array([[0.057, 0.003], [0.063, -0.003]])
    return RemovalOption(Candidate(1, np.array([0.06, 0, 0.09, *DOWN]), 0.4), place, 0.1, True)


def test_a_push_is_seen_in_its_own_frame(push, situation):
    views = view_options([push], situation)
    assert views.patches.shape == (1, *OPTION_PATCH)
    height, target, chance, path, above = views.patches[0].astype(np.float64)
    # Cells are 6 mm; columns go along +y, rows towards -x, and the middle is between 19 and 20.
    np.testing.assert_allclose(height[19:21, 19:21], 0.5, atol=1e-3)
    np.testing.assert_allclose(height[9:11, 19:21], 1.0, atol=1e-3)
    assert height[30, 19] == height[9, 35] == 0
    # 4 cm across, where cells are 3, 9 and 15 mm from the middle; 2 cm along, where 3 and 9 are.
    assert target[17:23, 18:22].all()
    assert target.sum() == 6 * 4
    # Both grasps are in one cell, 3 mm and 31.5 mm away; the better one counts.
    assert chance[20, 25] == 0.75
    assert np.count_nonzero(chance) == 1
    # 3 mm, 9 mm and 15 mm beside the path; beyond its end, 9 cm ahead.
    np.testing.assert_allclose(path[20:23, 20], [0.85, 0.55, 0.25], atol=1e-3)
    assert path[24, 20] == 0
    np.testing.assert_allclose(path[19, 34], 0.85, atol=1e-3)
    np.testing.assert_allclose(path[19, 36], 1 - np.hypot(0.009, 0.003) / 0.02, atol=1e-3)
    np.testing.assert_allclose(above, height - 0.6, atol=1e-3)


def test_a_removal_is_seen_along_the_line_to_what_is_removed(removal, situation):
    height, _, chance, place, above = view_options([removal], situation).patches[0]
    # Columns go along +x: the block is 6 cm ahead.
    np.testing.assert_allclose(height[19:21, 29:31], 1.0, atol=1e-3)
    assert place[20, 29] == place[19, 30] == 1
    assert place.sum() == 2
    # The better grasp is 31.5 mm to the left, and 3 mm behind the middle.
    assert chance[25, 19] == 0.75
    assert not above.any()


def test_the_numbers_of_options(push, removal, situation):
    visible = 20 * 0.002 * np.sqrt(20 * 10)
    shared = [1.5, visible, 0.5, 2 / 50]
    pushed, removed = view_options([push, removal], situation).numbers
    assert pushed.shape == removed.shape == (OPTION_NUMBERS,)
    # 15 cm, and 1.2 cm less to do, in actions of 5 cm; no way to its beginning.
    own = [1, 1, 8 * 0.06, 8 * 0.09, 0, 0.6, 0, 0.3, 0]
    np.testing.assert_allclose(pushed, [*shared, *own], atol=1e-6)
    np.testing.assert_allclose(removed, [*shared, *[0] * 6, 0.8, 1.0, 0.6], atol=1e-6)


def test_a_push_to_the_other_side_is_the_mirrored_picture(heights):
    sight = Sight(
        np.zeros((64, 64)), np.zeros((64, 64), np.bool_), np.array([0.0, 0.0, 0.05]),
        np.zeros((0, 3)), np.array([0.0, -0.06, 0.06]), preset("overhead"),
    )  # fmt: skip
    mirrored = HeightMap(heights.height[::-1], heights.target[::-1], heights.corner)
    left, right = (
        view_options(
            [PushOption.plan(Push("straight", np.pi / 2, side * 0.02, 0.06, 0.09), sight)],
            Situation(seen, np.zeros(2), []),
        )
        for side, seen in ((1, heights), (-1, mirrored))
    )
    signs = np.ones(OPTION_NUMBERS)
    signs[list(MIRRORED_OPTION_NUMBERS)] = -1
    np.testing.assert_allclose(right.patches, left.patches[:, :, ::-1], atol=1e-3)
    np.testing.assert_allclose(right.numbers, left.numbers * signs, atol=1e-6)


def test_neither_options_nor_grasps_nor_a_target_in_any_cell_are_needed(push, situation, heights):
    nothing = view_options([], situation)
    assert len(nothing.patches) == len(nothing.numbers) == 0
    unseen = HeightMap(heights.height, np.zeros_like(heights.target), heights.corner)
    bare = view_options([push], Situation(unseen, np.zeros(2), []))
    assert np.isfinite(bare.numbers).all()
    np.testing.assert_array_equal(bare.numbers[0, :4], 0)
    assert not bare.patches[0, 2].any()
