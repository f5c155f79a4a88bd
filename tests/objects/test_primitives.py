from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mechsearch.objects.household.object_set import (
    hausdorff,
    moments_of,
    triangle_distances,
    union_of,
)
from mechsearch.objects.household.paint import (
    band,
    blend,
    dots,
    every,
    layers,
    panel,
    plain,
    seam,
    spot,
)
from mechsearch.objects.household.primitives import (
    TEXEL_CENTRE,
    box,
    cylinder,
    ellipsoid,
    fitted,
    frustum,
    prism,
    shell,
    skin,
    stack,
    tube,
)
from mechsearch.objects.model import TEXEL_ROWS, ObjectModel, texel_weights
from mechsearch.types import MechSearchError

SOLIDS = {
    "box": box(0.06, 0.16, 0.21),
    "cylinder": cylinder(0.1, 0.14),
    "frustum": frustum(0.08, 0.03, 0.05, 12),
    "ellipsoid": ellipsoid(0.07, 0.06, 0.05),
    "prism": prism([(0, 0), (0.1, 0), (0.1, 0.02), (0, 0.05)], 0.01, bands=3, cells=2),
    "clockwise prism": prism([(0, 0.05), (0.1, 0.02), (0.1, 0), (0, 0)], 0.01),
    "tube": tube([(0, 0), (0.05, 0), (0.08, 0.04)], [0.01, 0.02, 0.01], [0.01, 0.02, 0.02])[1],
    "shell": shell([(0.03, 0.0), (0.035, 0.08)], [(0.04, 0.08), (0.04, 0.0)], 8)[3],
}
length = st.floats(0.005, 0.3)
triples = st.tuples(length, length, length)


def signed_volume(solid):
    corners = solid.vertices[solid.faces] - solid.vertices.mean(axis=0)
    return np.linalg.det(corners).sum() / 6


@pytest.mark.parametrize("name", SOLIDS)
def test_surface_is_closed_and_faces_outwards(name):
    solid = SOLIDS[name]
    places, index = np.unique(np.round(solid.vertices, 9), axis=0, return_inverse=True)
    corners = index[solid.faces]
    edges = Counter(
        (a, b) for face in corners for a, b in zip(face, np.roll(face, -1), strict=True)
    )
    assert all(edges[b, a] == count for (a, b), count in edges.items())
    assert signed_volume(solid) > 0
    assert signed_volume(solid) == pytest.approx(ConvexHull(places).volume, rel=0.02)


@pytest.mark.parametrize("name", SOLIDS)
def test_convex_part_is_small_and_has_the_volume_of_the_surface(name):
    solid = SOLIDS[name]
    assert len(solid.hull) <= 32
    assert moments_of(solid.hull)[0] == pytest.approx(signed_volume(solid), rel=0.06)
    assert hausdorff(solid.vertices, solid.hull) < 0.003


def test_round_solids_have_exactly_their_diameters():
    assert np.ptp(cylinder(0.102, 0.139).vertices, axis=0) == pytest.approx([0.102, 0.102, 0.139])
    assert np.ptp(ellipsoid(0.1, 0.2, 0.3).vertices, axis=0) == pytest.approx([0.1, 0.2, 0.3])


def test_slices_of_a_stack_meet_in_equal_circles():
    low, high = stack([(0.02, 0.0), (0.04, 0.01), (0.03, 0.03)])
    top = low.vertices[np.isclose(low.vertices[:, 2], 0.01)]
    bottom = high.vertices[np.isclose(high.vertices[:, 2], 0.01)]
    assert np.ptp(top, axis=0) == pytest.approx([0.04, 0.04, 0])
    assert np.sort(top, axis=0) == pytest.approx(np.sort(bottom, axis=0))


def test_turning_moves_x_to_y():
    solid = box(0.4, 0.2, 0.1).turned("z", 90).moved(x=1.0)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx([0.2, 0.4, 0.1])
    assert solid.hull.mean(axis=0) == pytest.approx([1, 0, 0])


def test_pieces_of_a_tube_share_their_joint_and_leave_no_gap():
    first, second = tube([(0, 0), (0.1, 0), (0.1, 0.1)], [0.02] * 3, [0.02] * 3)
    shared = {tuple(p) for p in np.round(first.hull, 9)} & {
        tuple(p) for p in np.round(second.hull, 9)
    }
    assert len(shared) == 8
    assert np.array(sorted(shared)).mean(axis=0) == pytest.approx([0.1, 0, 0])


def test_sectors_of_a_shell_leave_the_inside_free():
    pieces = shell([(0.03, 0.0), (0.03, 0.08)], [(0.04, 0.08), (0.04, 0.0)], 8)
    planes = [ConvexHull(piece.hull).equations for piece in pieces]
    for radius, inside in ((0.0, 0), (0.027, 0), (0.038, 1)):
        point = np.array([radius, 0.0, 0.04])
        assert sum((p[:, :3] @ point + p[:, 3] <= 0).all() for p in planes) == inside


def test_fitting_fills_the_box():
    solids = fitted([box(1, 1, 1), box(1, 1, 1).moved(x=2)], 0.3, 0.2, 0.1)
    points = np.concatenate([solid.vertices for solid in solids])
    assert np.ptp(points, axis=0) == pytest.approx([0.3, 0.2, 0.1])


def test_a_part_of_too_many_corners_is_refused():
    ring = cylinder(0.1, 0.1, sides=16).hull
    with pytest.raises(MechSearchError, match="64 corners; expected at most 32"):
        skin([ring, ring + np.array([0, 0, 1])])


def test_texels_are_found_again_by_their_weights():
    n = TEXEL_ROWS
    weights = texel_weights(n, TEXEL_CENTRE)
    assert len(weights) == n * (n + 1) / 2
    assert weights.sum(axis=1) == pytest.approx(1)
    assert (weights >= -1e-12).all()
    i, j = np.floor(weights[:, 1:] * n + 1e-9).astype(int).T
    assert (i * n - i * (i - 1) // 2 + j).tolist() == list(range(len(weights)))


def test_paint_is_laid_where_the_solid_is():
    solid = box(2, 2, 2).painted(layers("000000", (band("z", 0.0, 2.0), "ff0000"))).moved(z=5)
    points = np.einsum(
        "tc,fcd->ftd", texel_weights(TEXEL_ROWS, TEXEL_CENTRE), solid.vertices[solid.faces]
    )
    red = solid.texels[..., 0] == 255
    assert (red == (points[..., 2] >= 5)).all()


def test_marks_cover_what_they_say():
    points = np.array([[0, 0, 1.0], [0, 0.9, 1.0], [1.0, 0, 0], [0, -1.0, 0]])
    assert spot("z", 0, 0, 0.5)(points, points).tolist() == [True, False, False, False]
    assert panel("x", (-1, 1), (-1, 1))(points, points).tolist() == [False, False, True, False]
    assert every(band("z", 1, 1), band("y", 0, 0))(points, points).tolist() == [True] + 3 * [False]
    assert dots(2, 0.99)(points, points).sum() <= 2
    assert not seam(0.1)(points, points)[0]


def test_blend_is_the_mean_in_the_middle():
    points = np.array([[0, 0, -1.0], [0, 0, 0.5], [0, 0, 9.0]])
    colours = blend("000000", "646464", "z", 0.0, 1.0)(points, points)
    assert colours[:, 0].tolist() == [0, 50, 100]


def test_moments_of_a_box_are_the_textbook_ones():
    volume, centre, second = moments_of(box(0.2, 0.4, 0.6).moved(1, 2, 3).hull)
    assert volume == pytest.approx(0.048)
    assert centre == pytest.approx([1, 2, 3])
    about = second - volume * np.outer(centre, centre)
    assert np.diag(about) == pytest.approx(0.048 / 12 * np.array([0.04, 0.16, 0.36]))


@given(sides=triples, seed=st.integers(0, 1000))
def test_inertia_turns_with_the_object(sides, seed):
    rotation = Rotation.random(random_state=seed).as_matrix()
    corners = box(*sides).hull
    volume, _, second = moments_of(corners @ rotation.T)
    expected = rotation @ np.diag(volume / 12 * np.square(sides)) @ rotation.T
    assert np.allclose(second, expected, rtol=1e-7, atol=1e-12)


def test_distances_to_a_triangle_are_those_to_face_edge_and_corner():
    triangle = np.array([[[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]]])
    points = np.array([[0.2, 0.2, 3.0], [0.5, -2.0, 0.0], [4.0, 0.0, 4.0], [0.1, 0.1, 0.0]])
    assert triangle_distances(points, triangle)[:, 0] == pytest.approx([3, 2, 5, 0])


def test_distance_of_a_cube_to_one_twice_as_large_is_between_corners():
    assert hausdorff(box(2, 2, 2).hull, box(4, 4, 4).hull) == pytest.approx(3**0.5)


@given(sides=triples, shift=st.tuples(*[st.floats(-1, 1)] * 3))
def test_distance_to_a_displaced_copy_is_the_displacement(sides, shift):
    corners = ellipsoid(*sides).hull
    expected = np.linalg.norm(shift)
    assert hausdorff(corners, corners + shift) == pytest.approx(expected, abs=1e-8)


def test_assembled_object_is_balanced_on_its_origin():
    model = union_of("bar", "block", 2.0, [box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1).moved(x=0.1)])
    assert model.parts[0].mean(axis=0) == pytest.approx([-0.05, 0, 0])
    expected = 2.0 / 12 * np.array([0.02, 0.05, 0.05])
    assert model.inertia == pytest.approx(np.diag(expected))
    assert model.hull_error == 0


def test_one_colour_needs_one_texel():
    red, half = plain("ff0000"), layers("ff0000", (band("z", 0.1, 1), "0000ff"))
    assert union_of("a", "x", 1.0, [box(1, 1, 1).painted(red)]).texels.shape[1] == 1
    assert union_of("a", "x", 1.0, [box(1, 1, 1).painted(half)]).texels.shape[1] == 21


def content_hash(**fields):
    return ObjectModel(category="", hull_error=0.0, **fields).content_hash


ARGUMENTS = {
    "name": "a",
    "vertices": np.zeros((3, 3)),
    "faces": np.array([[0, 1, 2]]),
    "texels": np.zeros((1, 1, 3), np.uint8),
    "parts": (np.zeros((4, 3)),),
    "mass": 1.0,
    "inertia": np.eye(3),
    "friction": 0.5,
}
OTHERS = {
    "name": "b",
    "vertices": np.full((3, 3), 1e-6),
    "faces": np.array([[0, 2, 1]]),
    "texels": np.ones((1, 1, 3), np.uint8),
    "parts": (np.zeros((2, 3)), np.zeros((2, 3))),
    "mass": 1.1,
    "inertia": 2 * np.eye(3),
    "friction": 0.6,
}


@pytest.mark.parametrize("field", ARGUMENTS)
def test_digest_changes_with_every_field(field):
    changed = ARGUMENTS | {field: OTHERS[field]}
    assert content_hash(**changed) != content_hash(**ARGUMENTS)


def test_digest_ignores_the_storage_of_equal_numbers():
    stored = ARGUMENTS | {
        "vertices": np.asfortranarray(np.full((3, 3), -0.0, ">f8")),
        "faces": [[0, 1, 2]],
        "mass": 1,
    }
    assert content_hash(**stored) == content_hash(**ARGUMENTS)
    assert len(content_hash(**stored)) == 64
