import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.actor_critic.symmetry import SYMMETRIES, TURNS, Symmetry, transform
from mechsearch.camera import preset
from mechsearch.types import MechSearchError

SIZE = 16
POINTS = st.tuples(*[st.floats(-0.25, 0.25)] * 2, st.floats(0, 0.2))


def matrix(symmetry):
    """The plane's linear map, written out."""
    swap = np.array([[0, 1], [1, 0]]) if symmetry.swap else np.eye(2)
    return np.diag([-1 if symmetry.flip_x else 1, -1 if symmetry.flip_y else 1]) @ swap


def move(symmetry, points):
    flat = matrix(symmetry) @ np.asarray(points)[:, :2].T
    return np.column_stack([flat.T, np.asarray(points)[:, 2]])


def picture(points, ee):
    """Depth and position image of a few points, drawn pixel by pixel with the camera."""
    camera = preset("overhead", SIZE)
    depth = np.ones((1, SIZE, SIZE), np.float32)
    offsets = np.zeros((3, SIZE, SIZE), np.float32)
    for point in points:
        column, row, z = camera.project(np.array([point]))[0]
        r, c = round(row), round(column)
        if 0 <= r < SIZE and 0 <= c < SIZE:
            depth[0, r, c] = z
            offsets[:, r, c] = np.asarray(point) - ee
    return depth, offsets


def test_the_eight_are_all_different_and_one_changes_nothing():
    maps = {tuple(matrix(s).ravel()) for s in SYMMETRIES}
    assert len(maps) == 8
    np.testing.assert_array_equal(matrix(SYMMETRIES[0]), np.eye(2))
    assert all(np.linalg.det(matrix(s)) == (-1 if s.mirrors else 1) for s in SYMMETRIES)
    assert len(TURNS) == 4
    assert all(np.linalg.det(matrix(s)) == 1 for s in TURNS)


@settings(deadline=None, max_examples=40)
@given(st.lists(POINTS, min_size=1, max_size=5), POINTS, st.sampled_from(SYMMETRIES))
def test_a_turned_scene_gives_the_turned_observation(points, ee, symmetry):
    camera = preset("overhead", SIZE)
    pixels = camera.project(np.array(points))[:, :2]
    if np.abs(pixels - np.floor(pixels) - 0.5).min() < 0.01:
        return  # halfway between two pixels, where rounding decides
    if len({tuple(p) for p in np.round(pixels)}) < len(points):
        return  # two points in one pixel, where the order of drawing decides
    depth, offsets = (torch.tensor(a)[None] for a in picture(points, np.array(ee)))
    turned_ee = move(symmetry, [ee])[0]
    expected_depth, expected_offsets = picture(move(symmetry, points), turned_ee)
    np.testing.assert_allclose(symmetry.of("depth", depth)[0], expected_depth, atol=1e-6)
    np.testing.assert_allclose(
        symmetry.of("position_image", offsets)[0], expected_offsets, atol=1e-6
    )
    np.testing.assert_allclose(
        symmetry.of("ee_position", torch.tensor([ee])), turned_ee[None], atol=1e-6
    )


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_repeating_a_symmetry_comes_back(symmetry):
    image = torch.rand(2, 3, SIZE, SIZE)
    turned = image
    for _ in range(4):
        turned = symmetry.of("position_image", turned)
    assert torch.equal(turned, image)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_a_batch_is_turned_as_a_whole(symmetry):
    batch = {
        "depth": torch.rand(4, 1, 6, 6),
        "position_image": torch.rand(4, 3, 6, 6),
        "clutter_offsets": torch.rand(4, 5, 3),
        "clutter_mask": torch.ones(4, 5),
        "action": torch.rand(4, 3),
    }
    turned = transform(batch, symmetry)
    for key, value in batch.items():
        one_by_one = torch.cat([symmetry.of(key, sample[None]) for sample in value])
        torch.testing.assert_close(turned[key], one_by_one)


def test_vectors_turn_like_hand_computed():
    quarter = Symmetry(swap=True, flip_x=True, flip_y=False)
    assert quarter.of_vectors(torch.tensor([1.0, 2.0, 3.0])).tolist() == [-2.0, 1.0, 3.0]


def test_an_unknown_key_is_refused():
    with pytest.raises(MechSearchError, match="unknown how"):
        SYMMETRIES[1].of("sound", torch.zeros(1, 3))
