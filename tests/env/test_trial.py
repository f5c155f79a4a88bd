import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.trial import from_start, imageless, roll_out
from mechsearch.pushes.push import PlannedPush, draw_pushes, look
from mechsearch.teachers import make_teacher
from mechsearch.types import TEACHER_KEYS


@pytest.fixture
def env(covered, boxes):
    env = HeapEnv([covered], boxes, HeapEnvConfig(privileged=True, max_actions=20))
    env.reset(seed=1, options={"heap": 0})
    return env


def push_at(env, seed):
    obs = env.restore(env.snapshot())
    sight = look(obs, preset("overhead", 64))
    return PlannedPush(draw_pushes(1, np.random.default_rng(seed))[0], sight)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_tried_without_images_goes_as_it_goes_when_executed(env, seed):
    snapshot, twin = env.snapshot(), imageless(env)
    obs = twin.restore(snapshot)
    assert set(obs) == set(TEACHER_KEYS)
    tried = roll_out(twin, obs, push_at(env, seed).act)
    executed = roll_out(env, env.restore(snapshot), push_at(env, seed).act)
    np.testing.assert_array_equal(tried.actions, executed.actions)
    for name in ("reward", "terms", "clutter_moved", "end", "occlusion"):
        assert getattr(tried, name) == getattr(executed, name)


def test_it_adds_up_what_the_environment_tells(env):
    teacher, snapshot = make_teacher("straight"), env.snapshot()
    rollout = roll_out(env, env.restore(snapshot), teacher.act)
    env.restore(snapshot)
    steps = [env.step(action) for action in rollout.actions]
    infos = [step[4] for step in steps]
    assert rollout.reward == sum(step[1] for step in steps)
    assert rollout.reward == pytest.approx(sum(rollout.terms.values()))
    assert rollout.clutter_moved == sum(info["clutter_moved"] for info in infos)
    assert (rollout.end, rollout.occlusion) == (infos[-1]["end"], infos[-1]["occlusion"])
    np.testing.assert_array_equal(rollout.obs["ee_position"], steps[-1][0]["ee_position"])


def test_a_trial_from_a_start_is_not_cut_off_by_the_episodes_length_and_another_is(env):
    for _ in range(19):
        env.step(np.zeros(3, np.float32))
    push, snapshot, twin = push_at(env, 2), env.snapshot(), imageless(env)
    tried = roll_out(twin, twin.restore(from_start(snapshot)), push.act)
    assert tried.end in (None, "uncovered")
    assert len(tried.actions) > 1
    cut = roll_out(env, env.restore(snapshot), push_at(env, 2).act)
    assert (cut.end, len(cut.actions)) == ("action limit", 1)


def test_what_is_hopeless_is_given_up(env):
    def is_hopeless(rollout):
        return rollout.reward < -1.2

    rollout = roll_out(env, env.restore(env.snapshot()), lambda obs: np.zeros(3), is_hopeless)
    assert (rollout.end, len(rollout.actions)) == ("given up", 3)
