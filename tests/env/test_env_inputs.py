"""What people hand to either kind of environment: understood, or refused and nothing changes."""

import copy
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest

import mechsearch
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.reward import RewardConfig
from mechsearch.env.task import RetrievalReward, RetrieveConfig, TaskConfig
from mechsearch.heaps.dataset import Heap
from mechsearch.sim.scene import PhysicsConfig
from mechsearch.types import MechSearchError

KINDS = {
    "uncover": (HeapEnv, HeapEnvConfig(keys=("ee_position",)), [0.5, -0.25, 1.0]),
    "retrieve": (
        RetrieveEnv, RetrieveConfig(keys=("ee_position",)), [0, 0, 0.5, -0.25, 1.0, 0, 0, 0, 0],
    ),
}  # fmt: skip


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


@pytest.fixture
def heaps(covered):
    return [replace(covered, seed=seed) for seed in range(3)]


@pytest.fixture
def env(kind, heaps, boxes):
    made, config, _ = kind
    env = made(heaps, boxes, config)
    env.reset(seed=0, options={"heap": 1})
    return env


@pytest.fixture
def action(kind):
    return kind[2]


def everything(env):
    return b"".join(value.tobytes() for _, value in sorted(env.snapshot().items()))


def refused(text, do):
    with pytest.raises(MechSearchError, match=text) as found:
        do()
    assert "\n" not in str(found.value)


def tensor(numbers):
    torch = pytest.importorskip("torch")
    return torch.tensor(numbers, dtype=torch.float64, requires_grad=True)


@pytest.mark.parametrize("given", [tuple, list, np.array, tensor, lambda a: tensor(a).detach()])
def test_an_action_is_numbers_in_any_container(env, action, given):
    start = env.snapshot()
    env.step(np.array(action, np.float64))
    expected = everything(env)
    env.restore(start)
    env.step(given(action))
    assert everything(env) == expected


@pytest.mark.parametrize(
    "given",
    [
        lambda a: None,
        lambda a: "up",
        lambda a: list(map(str, a)),
        lambda a: [a],
        lambda a: a[:-1],
        lambda a: [a, *a[1:]],
        lambda a: [*a[:-1], None],
        lambda a: [*a[:-1], 10**400],
        lambda a: [*a[:-1], np.nan],
        lambda a: [*a[:-1], -np.inf],
        lambda a: np.array(a) + 0j,
        lambda a: dict(enumerate(a)),
        lambda a: set(a),
        lambda a: np.zeros(len(a), "datetime64[s]"),
    ],
)
def test_what_is_no_action_is_refused_and_nothing_happens(env, action, given):
    before = everything(env)
    refused(r"is \(\d,\) finite numbers.*; got ", lambda: env.step(given(action)))
    assert everything(env) == before


@pytest.mark.parametrize("heap", [2, 2.0, np.int64(2), np.float32(2)])
def test_a_heap_is_chosen_by_a_whole_number_of_any_type(env, heap):
    assert env.reset(options={"heap": heap})[1]["heap"] == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heap": "3"}, "heap is '3'; expected a whole number from 0 to 2"),
        ({"heap": True}, "heap is True; expected a whole number"),
        ({"heap": 1.5}, r"heap is 1\.5; expected a whole number"),
        ({"heap": float("nan")}, "heap is nan; expected a whole number"),
        ({"heap": [1]}, r"heap is \[1\]; expected a whole number"),
        ({"heap": -1}, "heap -1 does not exist; choose 0 to 2"),
        ({"heap": 10**40}, "heap 1000.* does not exist; choose 0 to 2"),
        ({"heaps": 1}, "unknown option 'heaps'; choose among heap, fixed_start"),
        ({"fixed_start": "no"}, "fixed_start is 'no'; expected True or False"),
        ([1], r"options are \[1\]; expected a mapping with any of heap, fixed_start"),
    ],
)
def test_an_option_that_means_nothing_is_refused_and_the_episode_goes_on(env, options, message):
    before = everything(env)
    refused(message, lambda: env.reset(options=options))
    assert everything(env) == before


def test_a_snapshot_that_does_not_fit_is_refused_and_nothing_has_changed(env, heaps, boxes, kind):
    made, config, action = kind
    env.step(action)
    before, own = everything(env), env.snapshot()
    others = [
        HeapEnv(heaps, boxes, KINDS["uncover"][1]), RetrieveEnv(heaps, boxes, KINDS["retrieve"][1])
    ]  # fmt: skip
    stranger = next(other for other in others if type(other) is not made)
    stranger.reset(seed=0)
    fewer = Heap(("cube", "lid"), heaps[0].poses[:2], 0, 0.75, 9, 2, "single", False)
    smaller = made([fewer] * 2, boxes, config)
    smaller.reset(options={"heap": 1})
    for wrong, message in [
        ({}, "a snapshot without heap, world, poses"),
        (None, "a snapshot without heap"),
        ({name: own[name] for name in own if name != "over"}, "a snapshot without over"),
        (stranger.snapshot(), "a snapshot (without grasps|whose world has shape)"),
        (smaller.snapshot(), "a snapshot whose world has shape"),
        (own | {"heap": np.array(3)}, r"a snapshot of heap .*3"),
        (own | {"poses": own["poses"][:1]}, r"a snapshot whose poses has shape \(1, 7\)"),
        (own | {"occlusion": "half"}, "a snapshot's occlusion.*got 'half'"),
    ]:
        refused(message, lambda wrong=wrong: env.restore(wrong))
        assert everything(env) == before


@pytest.mark.parametrize("take", [copy.copy, copy.deepcopy, ForkingPickler.dumps])
def test_a_copy_is_refused_and_the_way_to_one_is_named(env, take):
    refused(r"neither copied nor pickled.*snapshot\(\).*restore", lambda: take(env))


def test_a_render_mode_or_a_config_of_another_kind_is_refused(kind, heaps, boxes):
    made, config, _ = kind
    refused(
        "unknown render_mode 'human'; choose 'rgb_array' or None",
        lambda: made(heaps, boxes, config, "human"),
    )
    for wrong in ({"camera": "overhead"}, TaskConfig(), RewardConfig()):
        refused(
            f"expected a {type(config).__name__}", lambda wrong=wrong: made(heaps, boxes, wrong)
        )


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("reward", "dense", "reward is 'dense'; expected RewardConfig"),
        ("physics", {}, "physics is {}; expected PhysicsConfig"),
        ("workspace", None, "workspace is None; expected Workspace"),
        ("image_size", "64", "image_size is '64'; expected int"),
        ("max_actions", 2.5, r"max_actions is 2\.5; expected int"),
        ("max_actions", True, "max_actions is True; expected int"),
        ("uncovered_at", "x", "uncovered_at is 'x'; expected float"),
        ("keys", "depth", r"keys is 'depth'; expected tuple\[str, \.\.\.\]"),
        ("privileged", "yes", "privileged is 'yes'; expected bool"),
        ("physics", PhysicsConfig(time_step="x"), r"physics\.time_step is 'x'; expected float"),
    ],
)
def test_a_field_of_another_kind_is_named(kind, name, value, message):
    refused(message, lambda: replace(kind[1], **{name: value}))


def test_a_field_of_another_kind_is_named_in_rewards_and_where_an_environment_is_made():
    refused("reward.movement is '9'; expected a finite", lambda: RewardConfig(movement="9"))
    refused("retrieval.action is None; expected a finite", lambda: RetrievalReward(action=None))
    for make in (mechsearch.make_env, mechsearch.make_retrieve_env):
        refused("reward is 'dense'; expected RewardConfig", lambda make=make: make(reward="dense"))
        refused("config is 3; expected a", lambda make=make: make(config=3))
        refused(r"condition is \['single'\]; expected", lambda make=make: make(["single"]))
        refused("heaps are 3; expected the file of a heap set", lambda make=make: make(heaps=3))
