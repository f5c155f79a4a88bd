from pathlib import Path

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common import env_checker

import mechsearch
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, RGB_ACTOR_KEYS, MechSearchError

REGISTERED = sorted(name for name in gymnasium.registry if name.startswith("mechsearch/"))
IDS = [name for name in REGISTERED if not name.startswith("mechsearch/Benchmark")]
PUSHING = [name for name in IDS if "Retrieve" not in name]


def test_the_registered_ids_are_those_of_the_guide():
    assert [
        f"mechsearch/{name}-v0" for name in ("DualHeap", "Retrieve", "RetrieveDual", "SingleHeap")
    ] == IDS
    guide = (Path(__file__).parents[2] / "docs" / "environment.md").read_text()
    assert all(name in guide for name in IDS)


@pytest.mark.parametrize("view", [{}, {"privileged": True}, {"keys": RGB_ACTOR_KEYS}])
@pytest.mark.parametrize("name", PUSHING)
@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_and_stable_baselines_checkers_pass(name, view):
    env = gymnasium.make(name, disable_env_checker=True, render_mode="rgb_array", **view).unwrapped
    expected = set(view.get("keys", ACTOR_KEYS))
    assert set(env.observation_space) == expected | set(
        PRIVILEGED_KEYS if "privileged" in view else ()
    )
    check_env(env)
    env_checker.check_env(env)


@pytest.mark.parametrize("name", PUSHING)
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
    with pytest.raises(MechSearchError, match=r"'test'.*held-out, train, all"):
        mechsearch.make_env(split="test")
    with pytest.raises(MechSearchError, match=r"'colour'.*camera"):
        mechsearch.make_env(colour=True)
    with pytest.raises(MechSearchError, match="unknown condition 'triple'"):
        mechsearch.make_env("triple")
