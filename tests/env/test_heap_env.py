import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mechsearch.camera import preset
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.observe.observation import position_image
from mechsearch.teachers import make_teacher
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, MechSearchError

FIXED = {"heap": 0, "fixed_start": True}


@pytest.fixture
def env(covered, boxes):
    return HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))


def test_gymnasium_accepts_the_environment(covered, boxes):
    check_env(HeapEnv([covered], boxes), skip_render_check=True)


def test_only_the_actors_keys_are_returned_unless_privileged(covered, boxes, env):
    obs, _ = HeapEnv([covered], boxes).reset(seed=0)
    assert tuple(obs) == ACTOR_KEYS
    privileged, _ = env.reset(seed=0)
    assert set(privileged) == {*ACTOR_KEYS, *PRIVILEGED_KEYS}


def test_before_the_first_reset_there_is_no_heap_no_state_and_nothing_to_save(covered, boxes):
    env = HeapEnv([covered], boxes, render_mode="rgb_array")
    for look in (
        lambda: env.heap,
        lambda: env.world,
        lambda: env.state,
        env.snapshot,
        env.render,
    ):
        with pytest.raises(MechSearchError, match="no episode has begun; call reset first"):
            look()
    env.reset(seed=0)
    assert env.heap is covered
    assert env.state.occlusion == env.snapshot()["occlusion"]


def test_the_start_is_free_and_far_from_the_target_and_fixed_for_evaluation(env, covered):
    starts = []
    for seed in range(5):
        env.reset(seed=seed)
        position = env.state.ee_position
        assert np.linalg.norm(position - covered.poses[0, :3]) >= 0.2
        starts.append(position)
    assert len(np.unique(starts, axis=0)) == 5
    env.reset(seed=1, options=FIXED)
    first = env.state.ee_position
    env.reset(seed=2, options=FIXED)
    np.testing.assert_array_equal(env.state.ee_position, first)


@pytest.mark.parametrize("action", [(1, 0, 0), (0, -1, 0), (0.3, 0.2, 0.1), (1, 1, 1)])
def test_a_free_action_moves_the_effector_as_commanded_and_at_most_5_cm(env, action):
    env.reset(seed=0, options=FIXED)
    env.world.place_pusher([0.0, -0.2, 0.15])
    before = env.state.ee_position
    env.step(np.array(action, np.float32))
    expected = np.array(action) * 0.05
    expected *= min(1.0, 0.05 / np.linalg.norm(expected))
    np.testing.assert_allclose(env.state.ee_position - before, expected, atol=1e-3)


def test_a_command_out_of_the_workspace_is_penalised_and_stopped_at_its_bound(env):
    env.reset(seed=0, options=FIXED)
    env.world.place_pusher([0.29, -0.2, 0.15])
    *_, info = env.step(np.array([1.0, 0, 0], np.float32))
    assert info["reward_terms"]["workspace"] == -0.5
    assert env.state.ee_position[0] == pytest.approx(0.3, abs=2e-3)


def test_the_pusher_changes_neither_occlusion_nor_reward_but_hides_the_target(env):
    env.reset(seed=0, options=FIXED)
    env.world.place_pusher([-0.02, 0.0, 0.2])
    obs, _, _, _, info = env.step(np.zeros(3, np.float32))
    hidden = (obs["position_image"] != 0).any(axis=0).sum()
    without_pusher = info["occlusion"]
    assert info["reward_terms"]["uncovering"] == pytest.approx(0.0, abs=0.05)
    env.world.place_pusher([0.2, -0.2, 0.2])
    obs, _, _, _, info = env.step(np.zeros(3, np.float32))
    assert info["occlusion"] == pytest.approx(without_pusher, abs=0.02)
    assert (obs["position_image"] != 0).any(axis=0).sum() > hidden


def test_a_teacher_uncovers_and_the_episode_terminates(env):
    teacher = make_teacher("straight")
    teacher.reset(np.random.default_rng(0))
    obs, _ = env.reset(options=FIXED)
    for _ in range(50):
        obs, _, terminated, truncated, info = env.step(teacher.act(obs))
        if terminated or truncated:
            break
    assert terminated
    assert not truncated
    assert info["end"] == "uncovered"
    assert info["occlusion"] <= 0.02
    with pytest.raises(MechSearchError, match="over"):
        env.step(np.zeros(3))


def test_fifty_idle_actions_are_truncated_and_cost_half_a_point_each(env):
    env.reset(options=FIXED)
    total = 0.0
    for i in range(50):
        _, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        total += reward
        assert truncated == (i == 49)
        assert not terminated
    assert info["end"] == "action limit"
    assert total == pytest.approx(-25.0, abs=0.2)


def test_a_snapshot_continues_bit_by_bit(env):
    rng = np.random.default_rng(3)
    env.reset(options=FIXED)
    env.world.place_pusher([-0.1, 0.0, 0.06])
    actions = rng.uniform(-1, 1, (6, 3)).astype(np.float32)
    actions[:, 0] = 1
    for action in actions[:2]:
        env.step(action)
    snapshot = env.snapshot()

    def go():
        rows = [env.step(action) for action in actions[2:]]
        return rows, env.state

    first, state = go()
    env.restore(snapshot)
    second, again = go()
    np.testing.assert_array_equal(state.poses, again.poses)
    for a, b in zip(first, second, strict=True):
        assert a[1:4] == b[1:4]
        for key in a[0]:
            np.testing.assert_array_equal(a[0][key], b[0][key])


def test_a_target_off_the_table_is_lost_terminated_and_wholly_occluded(env):
    env.reset(options=FIXED)
    env.world.place(0, [0.5, 0, 0.1, 1, 0, 0, 0])
    env.world._data.qvel[2] = -0.1
    _, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
    assert (terminated, truncated, info["end"]) == (True, False, "lost")
    assert info["occlusion"] == 1.0
    assert reward < -10


def test_clutter_off_the_table_is_penalised_once_and_leaves_the_observation(env):
    env.reset(options=FIXED)
    env.world.place(2, [0.45, 0, 0.1, 1, 0, 0, 0])
    env.world._data.qvel[6 * 2 + 2] = -0.1
    obs, _, _, _, info = env.step(np.zeros(3, np.float32))
    assert info["reward_terms"]["clutter_movement"] < -5
    assert obs["clutter_mask"].tolist() == [1, 0]
    assert (obs["clutter_offsets"][1] == 0).all()
    *_, info = env.step(np.zeros(3, np.float32))
    assert info["clutter_moved"] == pytest.approx(0.0, abs=1e-3)


def test_a_simulator_failure_truncates_by_name_and_gives_no_reward(env):
    env.reset(options=FIXED)
    env.world.place(2, [np.nan, 0, 0.1, 1, 0, 0, 0])
    env.world._data.qvel[12] = 0.1
    obs, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["failure"] == "not a number"
    assert info["end"] == "failure: not a number"
    assert all(np.isfinite(obs[key].astype(float)).all() for key in obs)


@pytest.mark.parametrize(
    ("pose", "name"),
    [
        ([0.15, 0.1, -0.05, 1, 0, 0, 0], "tunnelling"),
        ([0.025, 0, 0.05, 1, 0, 0, 0], "deep penetration"),
    ],
)
def test_each_failure_has_its_name(env, pose, name):
    env.reset(options=FIXED)
    env.world.place(2, pose)
    env.world.step(1)
    assert env.world.failure() == name


def test_privileged_offsets_are_relative_to_the_effector(env, covered):
    obs, _ = env.reset(options=FIXED)
    ee = env.state.ee_position
    np.testing.assert_allclose(obs["target_offset"], covered.poses[0, :3] - ee, atol=1e-6)
    np.testing.assert_allclose(obs["clutter_offsets"], covered.poses[1:, :3] - ee, atol=1e-6)


def test_the_position_image_points_from_the_effector_to_the_targets_surface(env):
    obs, _ = env.reset(options=FIXED)
    image = obs["position_image"].astype(float)
    visible = (image != 0).any(axis=0)
    points = image[:, visible].T + env.state.ee_position
    assert visible.sum() > 3
    assert (np.abs(points[:, :2]) < 0.035).all()
    assert (points[:, 2] < 0.062).all()


def test_a_position_image_needs_one_size(env):
    with pytest.raises(MechSearchError, match="64"):
        position_image(np.ones((3, 3), bool), np.ones((3, 3)), preset("overhead"), np.zeros(3))


def test_wrong_settings_are_named(covered, boxes):
    with pytest.raises(MechSearchError, match="at least one heap"):
        HeapEnv([], boxes)
    with pytest.raises(MechSearchError, match="max_clutter is 1"):
        HeapEnv([covered], boxes, HeapEnvConfig(max_clutter=1))
    with pytest.raises(MechSearchError, match="'smell'"):
        HeapEnv([covered], boxes, HeapEnvConfig(keys=("smell",)))
