"""Claims about convex hulls: few vertices, true mass, true error."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from mechsearch.objects.meshes.hull import (
    HULL_VERTICES,
    as_mesh,
    hull_error,
    mass_properties,
    reduced_hull,
    sample_surface,
)


def moved_box(sides, centre):
    return trimesh.creation.box(sides, trimesh.transformations.translation_matrix(centre))


def test_the_hull_of_points_in_a_box_is_its_eight_corners():
    rng = np.random.default_rng(0)
    corners = np.array(moved_box((0.1, 0.2, 0.3), (0, 0, 0)).vertices)
    points = np.concatenate([rng.uniform(-0.04, 0.04, (100, 3)), corners])
    hull = reduced_hull(points)
    assert sorted(map(tuple, hull)) == sorted(map(tuple, corners))


def test_a_reduced_ball_has_few_vertices_the_full_volume_and_a_small_error():
    ball = trimesh.creation.icosphere(4, radius=0.05)
    hull = reduced_hull(np.array(ball.vertices))
    assert len(hull) == HULL_VERTICES
    assert ConvexHull(hull).volume == pytest.approx(ball.volume)
    assert hull_error(ball, [hull]) < 0.005


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 200))
def test_a_reduced_hull_never_has_more_vertices_than_allowed(seed, count):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    hull = reduced_hull(points, limit=12)
    assert len(ConvexHull(hull).vertices) == len(hull) <= 12


def test_points_in_a_plane_have_no_hull():
    with pytest.raises(QhullError):
        reduced_hull(np.random.default_rng(0).normal(size=(50, 3)) * [1, 1, 0])


def test_a_box_has_the_inertia_of_the_textbook():
    body = mass_properties([moved_box((0.1, 0.2, 0.3), (1, 2, 3))], mass=6.0)
    assert body.centre == pytest.approx([1, 2, 3])
    expected = np.diag([0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2]) * 6 / 12
    assert body.inertia == pytest.approx(expected)


def test_two_half_boxes_weigh_like_the_whole_box():
    halves = [moved_box((0.1, 0.2, 0.3), (x, 0, 0)) for x in (-0.05, 0.05)]
    parts, whole = (
        mass_properties(m, 2.0) for m in (halves, [moved_box((0.2, 0.2, 0.3), (0,) * 3)])
    )
    assert parts.centre == pytest.approx(whole.centre, abs=1e-12)
    assert parts.inertia == pytest.approx(whole.inertia, abs=1e-12)


def test_the_error_of_the_true_parts_is_zero(bracket):
    parts = [np.array(piece.vertices) for piece in bracket.split()]
    assert len(parts) == 2
    assert hull_error(bracket, parts) < 1e-6


def test_the_error_of_a_filled_corner_is_its_distance_to_the_arms(bracket):
    # The hull's slanted face runs from (10, 2) to (2, 10) cm; its middle, (6, 6) cm, is 4 cm away.
    hull = reduced_hull(np.array(bracket.vertices))
    assert hull_error(bracket, [hull]) == pytest.approx(0.04, abs=0.001)


def test_the_error_of_a_missing_arm_is_its_length(bracket):
    (arm,) = [piece for piece in bracket.split() if piece.bounds[1, 0] > 0.09]
    assert hull_error(bracket, [np.array(arm.vertices)]) == pytest.approx(0.08, abs=0.001)


def test_surface_samples_lie_in_their_triangles_in_proportion_to_area():
    box = moved_box((0.1, 0.1, 0.4), (0, 0, 0))
    points, face, weights = sample_surface(box, 20_000, np.random.default_rng(0))
    assert (weights >= 0).all()
    assert weights.sum(axis=1) == pytest.approx(1)
    rebuilt = np.einsum("nk,nkd->nd", weights, box.triangles[face])
    assert points == pytest.approx(rebuilt)
    ends = np.abs(box.face_normals[face, 2]) > 0.5
    assert ends.mean() == pytest.approx(2 / 18, abs=0.01)


def test_the_mesh_of_a_part_faces_outwards():
    hull = as_mesh(np.random.default_rng(0).normal(size=(30, 3)))
    assert hull.is_volume
