from dataclasses import replace

import numpy as np
import pytest

from mechsearch.pushes.push import (
    CELL,
    MIRRORED_NUMBERS,
    NUMBERS,
    PATCH,
    PlannedPush,
    Push,
    Sight,
    draw_pushes,
    look,
    view_pushes,
)

FIXED = {"heap": 0, "fixed_start": True}


def turned(sight):
    """Return the same heap a quarter turn further (x becomes y)."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return Sight(
        np.rot90(sight.heights), np.rot90(sight.target), quarter @ sight.centre,
        sight.obstacles @ quarter.T, quarter @ sight.ee_position, sight.camera,
    )  # fmt: skip


def mirrored(sight):
    """Return the heap with y mirrored."""
    flip = np.array([1.0, -1.0, 1.0])
    return Sight(
        np.flipud(sight.heights), np.flipud(sight.target), sight.centre * flip,
        sight.obstacles * flip, sight.ee_position * flip, sight.camera,
    )  # fmt: skip


@pytest.fixture
def seen(env, camera):
    obs, _ = env.reset(seed=0, options=FIXED)
    return look(obs, camera)


def test_a_push_looks_the_same_however_the_heap_is_turned(seen):
    pushes = draw_pushes(8, np.random.default_rng(0))
    here = view_pushes(pushes, seen)
    again = [replace(push, direction=push.direction + np.pi / 2) for push in pushes]
    there = view_pushes(again, turned(seen))
    np.testing.assert_allclose(there.patches, here.patches, atol=2e-3)
    np.testing.assert_allclose(there.numbers, here.numbers, atol=1e-5)
    np.testing.assert_array_equal(there.actions, here.actions)


def test_a_mirrored_push_looks_the_same_in_the_mirrored_heap(seen):
    pushes = [push for push in draw_pushes(20, np.random.default_rng(2)) if push.kind == "spiral"]
    here = view_pushes(pushes, seen)
    again = [
        replace(p, direction=-p.direction, lateral=-p.lateral, mirrored=not p.mirrored)
        for p in pushes
    ]
    there = view_pushes(again, mirrored(seen))
    np.testing.assert_allclose(there.patches, here.patches, atol=2e-3)
    np.testing.assert_allclose(there.numbers, here.numbers, atol=1e-5)


def test_left_and_right_of_a_straight_push_are_a_flip_of_patch_and_numbers(seen):
    push = Push("straight", 0.3, lateral=0.02, before=0.1, after=0.1)
    here = view_pushes([push], seen)
    there = view_pushes([replace(push, direction=-0.3, lateral=-0.02)], mirrored(seen))
    np.testing.assert_allclose(there.patches[0], here.patches[0][:, ::-1], atol=2e-3)
    signs = np.ones(NUMBERS)
    signs[list(MIRRORED_NUMBERS)] = -1
    np.testing.assert_allclose(there.numbers, here.numbers * signs, atol=1e-5)


def test_a_patch_shows_what_lies_ahead_in_its_columns_and_to_the_left_in_its_rows(sight):
    """An obstacle stands 11 cm from the target towards +x."""
    ahead, left, behind = (
        view_pushes([Push("straight", a, before=0.1, after=0.1)], sight).patches[0, 0]
        for a in (0.0, -np.pi / 2, np.pi)
    )
    half, step = PATCH[1] // 2, round(0.11 / CELL)
    assert ahead[half, half + step] > 0.7
    assert left[half + step, half] > 0.7
    assert behind[half, half - step] > 0.7
    assert ahead[half, half - step] == 0


def test_a_patch_shows_the_target_in_its_middle_and_the_push_on_its_way(sight):
    push = Push("straight", 0.0, lateral=0.0, before=0.11, after=0.055)
    patch = view_pushes([push], sight).patches[0].astype(float)
    rows, columns = np.nonzero(patch[2] > 0.5)
    middle = (PATCH[1] - 1) / 2
    assert rows.mean() == pytest.approx(middle, abs=0.6)
    assert columns.mean() == pytest.approx(middle, abs=0.6)
    on_way = patch[3][PATCH[1] // 2] > 0.5
    # Half a width of the drawn path reaches beyond both ends.
    assert on_way.sum() * CELL == pytest.approx(0.11 + 0.055 + 0.025, abs=2 * CELL)
    assert np.abs(patch[1] - (patch[0] - 0.4)).max() < 2e-3


def test_no_pushes_have_no_views(sight):
    views = view_pushes([], sight)
    assert views.patches.shape == (0, *PATCH)
    assert views.numbers.shape == (0, NUMBERS)


def test_pushes_are_planned_together_as_one_by_one(env, camera):
    flown = 0
    for seed in range(4):
        obs, _ = env.reset(seed=seed)
        sight = look(obs, camera)
        pushes = draw_pushes(60, np.random.default_rng(seed), full_steps=seed % 2 == 1)
        views = view_pushes(pushes, sight)
        plans = [PlannedPush(push, sight) for push in pushes]
        np.testing.assert_array_equal(views.actions, [p.approach + p.length for p in plans])
        starts = np.float32([[10 * p.start[2], p.approach / 10, p.length / 10] for p in plans])
        np.testing.assert_array_equal(views.numbers[:, [4, 9, 10]], starts)
        np.testing.assert_array_equal(views.numbers[:, 14], [p.flies for p in plans])
        flown += sum(p.flies for p in plans)
        # Nor does a view depend on what is viewed with it.
        alone = view_pushes(pushes[7:8], sight)
        np.testing.assert_array_equal(alone.patches, views.patches[7:8])
    assert 0 < flown < 240
