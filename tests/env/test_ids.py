import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common import env_checker

import mechsearch
from mechsearch.types import ACTOR_KEYS, MechSearchError

IDS = ("mechsearch/SingleHeap-v0", "mechsearch/DualHeap-v0")


@pytest.mark.parametrize("name", IDS)
@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_and_stable_baselines_checkers_pass(name):
    env = gymnasium.make(name, disable_env_checker=True, render_mode="rgb_array").unwrapped
    assert set(env.observation_space) == set(ACTOR_KEYS)
    check_env(env)
    env_checker.check_env(env)


@pytest.mark.parametrize("name", IDS)
def test_every_teacher_and_the_random_policy_run_on_every_id(name):
    env = gymnasium.make(name, privileged=True).unwrapped
    for spec in ("teacher-straight", "teacher-zigzag", "teacher-spiral", "random", "idle"):
        policy = mechsearch.make_policy(spec)
        assert set(policy.keys) <= set(env.observation_space)


def test_a_picture_is_rendered_when_asked_for():
    env = gymnasium.make("mechsearch/SingleHeap-v0", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (256, 256, 3)


def test_unknown_names_are_answered_with_the_choices():
    with pytest.raises(MechSearchError, match=r"'test'.*train, held-out, all"):
        mechsearch.make_env(split="test")
    with pytest.raises(MechSearchError, match=r"'colour'.*camera"):
        mechsearch.make_env(colour=True)
    with pytest.raises(MechSearchError, match="unknown condition 'triple'"):
        mechsearch.make_env("triple")
