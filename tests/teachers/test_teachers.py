import json

import numpy as np
import pytest

from mechsearch.pushes.push import spiral, straight, zigzag
from mechsearch.teachers import PAPER_TEACHERS, PushTeacher, make_teacher
from mechsearch.types import ACTION_LENGTH, TEACHER_KEYS, Policy

TARGET = np.array([0.05, -0.02, 0.03])
CLUTTER = np.array([[0.06, 0.0, 0.08], [-0.02, 0.05, 0.04]])


def observe(ee):
    mask = np.zeros(4, np.int8)
    mask[:2] = 1
    offsets = np.zeros((4, 3), np.float32)
    offsets[:2] = CLUTTER - ee
    return {
        "ee_position": np.asarray(ee, np.float32),
        "target_offset": (TARGET - ee).astype(np.float32),
        "clutter_offsets": offsets,
        "clutter_mask": mask,
    }


def follow(teacher, ee, actions=60, disturb=None):
    """Let a frictionless effector execute the teacher's actions; return its path."""
    path = [np.array(ee, float)]
    for i in range(actions):
        action = teacher.act(observe(path[-1]))
        assert action.shape == (3,)
        assert np.linalg.norm(action) <= 1 + 1e-5
        step = action.astype(float) * ACTION_LENGTH
        if disturb is not None and i in disturb:
            step = disturb[i]
        path.append(path[-1] + step)
    return np.array(path)


@pytest.mark.parametrize("name", PAPER_TEACHERS)
def test_a_teacher_is_a_policy_on_privileged_positions(name):
    teacher = make_teacher(name)
    assert isinstance(teacher, Policy)
    assert teacher.keys == TEACHER_KEYS


@pytest.mark.parametrize("name", PAPER_TEACHERS)
def test_every_push_passes_over_the_target_and_another_follows(name):
    teacher = make_teacher(name)
    teacher.reset(np.random.default_rng(4))
    path = follow(teacher, [0.25, 0.2, 0.2], 120)
    pushing = path[np.abs(path[:, 2] - 0.06) < 0.005]
    near = np.linalg.norm(pushing[:, :2] - TARGET[:2], axis=1)
    assert near.min() < 0.04
    passes = np.flatnonzero(near < 0.045)
    assert (np.diff(passes) > 3).any()


@pytest.mark.parametrize("shape", [straight, zigzag, spiral])
def test_a_teacher_carried_away_comes_back_to_its_push(shape):
    teacher = PushTeacher(shape, 0.0)
    teacher.reset(np.random.default_rng(4))
    away = {i: np.array([0.0, 0.045, 0.0]) for i in range(8, 13)}
    path = follow(teacher, [-0.25, 0.0, 0.1], 60, away)
    after = path[14:]
    pushing = after[np.abs(after[:, 2] - 0.06) < 0.005]
    assert np.linalg.norm(pushing[:, :2] - TARGET[:2], axis=1).min() < 0.045


def test_a_jammed_teacher_gives_up_its_waypoint():
    teacher = PushTeacher(straight, 0.0)
    teacher.reset(np.random.default_rng(0))
    stuck = np.array([-0.1, -0.02, 0.06])
    first = teacher.act(observe(stuck))
    later = [teacher.act(observe(stuck)) for _ in range(12)]
    assert any(np.dot(action, first) < 0.5 for action in later)


def test_a_straight_push_is_straight_and_goes_where_it_is_told():
    teacher = PushTeacher(straight, np.pi / 2)
    teacher.reset(np.random.default_rng(0))
    path = follow(teacher, [0.05, -0.25, 0.06], 8)
    np.testing.assert_allclose(path[:, 0], 0.05, atol=1e-6)
    assert (np.diff(path[:, 1]) >= 0).all()


def test_a_zigzag_swings_to_both_sides_and_a_spiral_turns_one_way():
    teacher = PushTeacher(zigzag, 0.0)
    teacher.reset(np.random.default_rng(0))
    path = follow(teacher, [-0.2, -0.02, 0.06], 16)
    assert path[:, 1].max() > 0.0
    assert path[:, 1].min() < -0.04
    points = spiral(TARGET[:2], 0.0) - TARGET[:2]
    turns = np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
    assert (turns > 0).all()
    assert (np.diff(np.linalg.norm(points, axis=1)) > 0).all()


@pytest.mark.parametrize("name", PAPER_TEACHERS)
def test_the_same_generator_gives_the_same_push(name):
    first, second = make_teacher(name), make_teacher(name)
    first.reset(np.random.default_rng(7))
    second.reset(np.random.default_rng(7))
    np.testing.assert_array_equal(
        follow(first, [0.2, 0.2, 0.1], 80), follow(second, [0.2, 0.2, 0.1], 80)
    )


@pytest.mark.parametrize("after", [0, 1, 4, 11, 30])
@pytest.mark.parametrize("name", PAPER_TEACHERS)
def test_a_teacher_that_is_kept_in_the_middle_of_a_push_goes_on_with_it(name, after):
    whole, kept = make_teacher(name), make_teacher(name)
    whole.reset(np.random.default_rng(5))
    start = [-0.2, 0.15, 0.1]
    path = follow(whole, start, after)
    # Through text, as a checkpoint keeps it.
    kept.restore(json.loads(json.dumps(whole.state())))
    np.testing.assert_array_equal(follow(kept, path[-1], 40), follow(whole, path[-1], 40))


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("straight", [[-0.020947, -0.093038, 0.173232], [0.160563, -0.020461, 0.064429],
                      [-0.09757, -0.046893, 0.06], [-0.009838, -0.100147, 0.068308]]),
        ("zigzag", [[-0.020947, -0.093038, 0.173232], [0.199998, -0.020681, 0.06],
                    [0.111011, -0.018352, 0.06], [0.092915, 0.023397, 0.06]]),
        ("spiral", [[0.063821, -0.005544, 0.07], [0.064481, -0.00432, 0.119518],
                    [0.093286, -0.123982, 0.06], [0.064855, -0.054289, 0.06]]),
    ],
)  # fmt: skip
def test_the_papers_teachers_go_where_they_always_went(name, places):
    """After 8, 24, 45 and 60 actions, carried away once."""
    teacher = make_teacher(name)
    teacher.reset(np.random.default_rng(11))
    path = follow(teacher, [0.25, 0.2, 0.2], 60, {20: np.array([0.1, 0.0, 0.05])})
    np.testing.assert_allclose(path[[8, 24, 45, 60]], places, atol=2e-6)
