import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import mechsearch
from mechsearch.evaluation import policies
from mechsearch.evaluation.policies import IdlePolicy, RandomPolicy, config_of_run, make_policy
from mechsearch.observe.observation import KINDS, without_holes
from mechsearch.types import MechSearchError, Policy


@pytest.fixture
def user_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "users_own_policies.py").write_text(
        "import numpy as np\n"
        "class Up:\n"
        "    keys = ('ee_position',)\n"
        "    def reset(self, rng): pass\n"
        "    def act(self, obs): return np.array([0, 0, 1], np.float32)\n"
        "def make(): return Up()\n"
        "def broken(): return 3\n"
        "number = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield "users_own_policies"
    sys.modules.pop("users_own_policies", None)


@pytest.mark.parametrize("spec", policies.policy_names())
def test_every_named_policy_is_a_policy(spec: str) -> None:
    assert isinstance(make_policy(spec), Policy)


def test_names_are_those_of_the_results_table() -> None:
    teachers = ("teacher-straight", "teacher-zigzag", "teacher-spiral")
    assert policies.policy_names() == ("random", "idle", *teachers)


def test_random_draws_all_from_the_generator_it_is_given() -> None:
    policy = RandomPolicy()
    draws = []
    for _ in range(2):
        policy.reset(np.random.default_rng(5))
        draws.append(np.stack([policy.act({}) for _ in range(400)]))
    np.testing.assert_array_equal(*draws)
    assert draws[0].shape == (400, 3)
    assert draws[0].dtype == np.float32
    assert np.abs(draws[0]).max() <= 1
    np.testing.assert_allclose(draws[0].mean(axis=0), 0, atol=0.1)
    np.testing.assert_allclose(draws[0].var(axis=0), 1 / 3, atol=0.05)


def test_idle_stays() -> None:
    policy = IdlePolicy()
    policy.reset(np.random.default_rng(0))
    np.testing.assert_array_equal(policy.act({}), np.zeros(3, np.float32))


BAD = {
    "teacher-straight": ("target_offset", np.full(3, np.nan), "target_offset holds nan in 3 of 3"),
    "grasp-only": ("grasp_depth", np.full((512, 512), 800.0), "grasp_depth is 800 in the median"),
    "uncover": ("position_image", np.full((3, 64, 64), np.nan), "position_image holds nan"),
}


@pytest.mark.parametrize("spec", BAD)
def test_a_policy_made_by_name_refuses_what_it_cannot_read(spec: str) -> None:
    if not spec.startswith("teacher"):
        pytest.importorskip("torch")
    policy = make_policy(spec)
    policy.reset(np.random.default_rng(0))
    sides = {"H": 64, "W": 64, "N": 2, "G": 512}
    spaces = {key: KINDS[key].space(**sides) for key in policy.keys}
    good = {key: np.full(space.shape, 0.1).astype(space.dtype) for key, space in spaces.items()}
    if spec != "grasp-only":
        assert np.isfinite(policy.act(good)).all()
    key, value, message = BAD[spec]
    with pytest.raises(MechSearchError, match=message):
        policy.act({**good, key: value})
    with pytest.raises(MechSearchError, match=f"the observation lacks {key}"):
        policy.act({name: good[name] for name in good if name != key})


def test_a_trained_policy_acts_on_depth_with_holes_as_on_what_fills_them() -> None:
    pytest.importorskip("torch")
    obs, _ = mechsearch.make_env().reset(seed=0, options={"heap": 0, "fixed_start": True})
    holed = obs["depth"].copy()
    holed[0, 5:9, 30:40], holed[0, 40, 7] = np.nan, 0
    policy, actions = make_policy("uncover"), []
    for depth in (holed, without_holes(holed)):
        policy.reset(np.random.default_rng(0))
        actions.append(policy.act({**obs, "depth": depth}))
    np.testing.assert_array_equal(*actions)


def test_a_users_own_factory_or_class_is_found(user_module: str) -> None:
    for name in ("make", "Up"):
        np.testing.assert_array_equal(make_policy(f"{user_module}:{name}").act({}), [0, 0, 1])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("broken", "gives a int without keys, reset, act"),
        ("number", "has no function or class 'number'; it has Up, broken, make"),
        ("absent", "has no function or class 'absent'"),
    ],
)
def test_what_is_no_policy_is_refused(user_module: str, name: str, message: str) -> None:
    with pytest.raises(MechSearchError, match=message):
        make_policy(f"{user_module}:{name}")


@pytest.mark.parametrize("spec", ["", "best", "teacher-circle", "teacher-", "straight", "a b:c"])
def test_an_unknown_policy_is_refused_with_the_choices(spec: str) -> None:
    with pytest.raises(MechSearchError, match=r"choose one of random, idle, teacher-straight"):
        make_policy(spec)


def test_a_missing_module_is_named() -> None:
    with pytest.raises(MechSearchError, match="No module named 'not_to_be_found'"):
        make_policy("not_to_be_found:make")


def test_a_missing_actor_is_named(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match=r"no actor at .*actor\.safetensors"):
        make_policy(str(tmp_path / "actor.safetensors"))


def test_a_trained_policy_without_pytorch_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match=r"pip install '\.\[learn\]'"):
        make_policy(str(tmp_path))


def test_a_run_is_found_from_its_folder_its_actor_and_an_earlier_actor(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"name": "method", "image_size": 48}))
    for spec in (tmp_path, tmp_path / "actor.safetensors", tmp_path / "actors" / "a.safetensors"):
        assert config_of_run(str(spec))["image_size"] == 48
    assert config_of_run("random") == {}
    assert config_of_run(str(tmp_path.parent / "elsewhere.safetensors")) == {}
