import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mechsearch.geometry import (
    apply,
    cap_length,
    invert,
    quaternion_product,
    random_quaternion,
    rotation_from_quaternion,
    transform_from_pose,
    yaw_quaternion,
)

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_rotation_matrices_agree_with_scipy(seed):
    q = random_quaternion(np.random.default_rng(seed))
    np.testing.assert_allclose(
        rotation_from_quaternion(q),
        Rotation.from_quat(q, scalar_first=True).as_matrix(),
        atol=1e-12,
    )


@given(seeds)
def test_a_product_rotates_by_the_right_factor_first(seed):
    rng = np.random.default_rng(seed)
    a, b = random_quaternion(rng), random_quaternion(rng)
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion_product(a, b)),
        rotation_from_quaternion(a) @ rotation_from_quaternion(b),
        atol=1e-12,
    )


@given(seeds)
def test_a_random_quaternion_has_length_one_and_its_rotation_keeps_lengths_and_hands(seed):
    q = random_quaternion(np.random.default_rng(seed))
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-12)
    rotation = rotation_from_quaternion(q)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(-q), rotation, atol=1e-15)


@given(seeds)
def test_products_of_quaternions_are_associative_and_the_conjugate_is_the_inverse(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (random_quaternion(rng) for _ in range(3))
    left = quaternion_product(quaternion_product(a, b), c)
    np.testing.assert_allclose(left, quaternion_product(a, quaternion_product(b, c)), atol=1e-12)
    product = quaternion_product(a, a * [1, -1, -1, -1])
    np.testing.assert_allclose(product, [1, 0, 0, 0], atol=1e-12)


@given(st.floats(-7, 7), st.floats(-7, 7))
def test_yaws_add_up_and_leave_the_vertical_alone(one, other):
    both = quaternion_product(yaw_quaternion(one), yaw_quaternion(other))
    np.testing.assert_allclose(both, yaw_quaternion(one + other), atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(both) @ [0, 0, 1], [0, 0, 1], atol=1e-12)


@given(seeds)
def test_transforms_are_carried_out_from_right_to_left(seed):
    rng = np.random.default_rng(seed)
    one, other = (
        transform_from_pose([*rng.normal(size=3), *random_quaternion(rng)]) for _ in range(2)
    )
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose(
        apply(one @ other, points), apply(one, apply(other, points)), atol=1e-12
    )


@given(seeds)
def test_an_inverse_undoes_a_transform(seed):
    rng = np.random.default_rng(seed)
    transform = transform_from_pose([*rng.normal(size=3), *random_quaternion(rng)])
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose(
        apply(invert(transform), apply(transform, points)), points, atol=1e-12
    )


def test_a_quarter_yaw_takes_x_to_y():
    np.testing.assert_allclose(
        rotation_from_quaternion(yaw_quaternion(np.pi / 2)) @ [1, 0, 0], [0, 1, 0], atol=1e-15
    )


@given(seeds, st.floats(0.01, 10))
def test_a_capped_vector_keeps_its_direction_and_never_exceeds_the_limit(seed, limit):
    vector = np.random.default_rng(seed).normal(size=3) * 5
    capped = cap_length(vector, limit)
    assert np.linalg.norm(capped) <= limit * (1 + 1e-12) or np.array_equal(capped, vector)
    np.testing.assert_allclose(np.cross(capped, vector), 0, atol=1e-9)


@given(seeds, st.floats(0.01, 10))
def test_capping_twice_is_capping_once_and_short_vectors_stay_as_they_are(seed, limit):
    vector = np.random.default_rng(seed).normal(size=3)
    capped = cap_length(vector, limit)
    np.testing.assert_allclose(cap_length(capped, limit), capped, rtol=1e-15)
    length = np.linalg.norm(vector)
    assert np.linalg.norm(capped) == pytest.approx(min(length, limit))
    if length < limit * (1 - 1e-12):
        np.testing.assert_array_equal(capped, vector)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 15, 64])
def test_a_rotation_has_the_same_bits_alone_and_among_others(count):
    rng = np.random.default_rng(count)
    many = np.stack([random_quaternion(rng) for _ in range(300)])
    together = rotation_from_quaternion(many)
    for start in range(0, 300 - count, count):
        part = rotation_from_quaternion(many[start : start + count])
        np.testing.assert_array_equal(part, together[start : start + count])
    np.testing.assert_array_equal(rotation_from_quaternion(many[7]), together[7])
