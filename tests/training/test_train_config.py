import json
from dataclasses import replace
from pathlib import Path

import pytest

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.learner import LearnerConfig
from mechsearch.algorithm import RunConfig, Schedule
from mechsearch.env.heap_env import TaskConfig
from mechsearch.push_values.algorithm import PushValues
from mechsearch.teachers import PAPER_TEACHERS
from mechsearch.training.config import PRESETS, load_config, run_config, save_config
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, RGB_ACTOR_KEYS, MechSearchError


@pytest.mark.parametrize("name", PRESETS)
def test_presets_come_back_from_their_file(name, tmp_path):
    config = PRESETS[name].changed(max_actions=33, reward=replace(TaskConfig().reward, movement=9))
    save_config(config, tmp_path / "config.json")
    assert load_config(tmp_path / "config.json") == config
    assert config.name == name


def test_a_file_has_the_options_of_its_own_algorithm_alone(tmp_path):
    save_config(PRESETS["plus"], tmp_path / "config.json")
    found = json.loads((tmp_path / "config.json").read_text())
    assert found["algorithm"].keys() == {
        "kind",
        "networks",
        "candidates",
        "tries",
        "explore",
        "ranked",
        "searches",
        "full_steps",
        "also",
        "value",
    }
    assert {"learner", "teachers", "noise", "pushes"} & found.keys() == set()


def test_ddpg_differs_in_guidance_critic_and_what_imitation_needs_alone():
    ddpg, method = PRESETS["ddpg"].algorithm, PRESETS["method"].algorithm
    assert ddpg.teachers == ()
    assert ddpg.critic_keys == ddpg.actor_keys == method.actor_keys
    same = replace(
        ddpg,
        teachers=method.teachers,
        imitated=method.imitated,
        critic_keys=method.critic_keys,
        learner=replace(
            ddpg.learner,
            dropout=method.learner.dropout,
            samples=50,
            imitation=method.learner.imitation,
            mirrors=method.learner.mirrors,
            network=replace(ddpg.learner.network, directions=True, lengths=True),
        ),
    )
    assert same == method


def test_pushes_are_learnt_under_any_camera():
    assert PRESETS["plus"].changed(camera="tilted").task.camera == "tilted"


def test_only_the_no_pose_ablation_and_retrieval_change_what_the_actor_sees():
    found = {name for name, config in PRESETS.items() if config.algorithm.keys != ACTOR_KEYS}
    assert found == {"no-pose-input", "as-printed-no-pose-input", "retrieve"}


def test_the_loss_as_printed_is_the_value_alone_of_the_papers_actor_and_each_ablation_one_change():
    printed = PRESETS["as-printed"].algorithm
    assert printed.learner.imitation == 0
    network = printed.learner.network
    assert (network.directions, network.lengths, network.centroid) == (False,) * 3
    assert printed.teachers == PAPER_TEACHERS
    assert printed.critic_keys == PRESETS["method"].algorithm.critic_keys
    for part, change in (
        ("teachers", {"teachers": ()}),
        ("asymmetry", {"critic_keys": ACTOR_KEYS}),
        ("pose-input", {"actor_keys": RGB_ACTOR_KEYS}),
    ):
        assert PRESETS[f"as-printed-no-{part}"].algorithm == replace(printed, **change)


def test_no_actor_sees_privileged_keys():
    for config in PRESETS.values():
        assert not set(config.algorithm.keys) & set(PRIVILEGED_KEYS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"imitated": ("sprial",)},
            "imitated names 'sprial', but .* straight, zigzag",
        ),
        ({"imitated": ("spiral",), "teachers": ()}, "imitated names 'spiral'.* are none"),
        ({"learner": LearnerConfig(dropout=0.0)}, "teachers need a Bayesian critic"),
        ({"actor_keys": ("target_offset",)}, "must not see 'target_offset'"),
        ({"camera": "tilted", "learner": LearnerConfig(symmetry=True)}, "overhead"),
        (
            {"grasp_network": "shipped"},
            "grasp_network is 'shipped', and held_out_heaps 0: there are no targets",
        ),
        ({"threads": 0}, "threads is 0; expected at least 1"),
        ({"actions": -1}, "actions is -1"),
        ({"updates_per_action": -0.5}, "updates_per_action"),
        ({"critic_keys": ()}, "at least one observation key"),
    ],
)
def test_contradictions_are_refused(changes, message):
    with pytest.raises(MechSearchError, match=message):
        RunConfig("method", ActorCritic()).changed(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"networks": 0}, "networks is 0; expected at least 1"),
        ({"tries": 0}, "tries is 0; expected at least 1"),
        ({"explore": 1.5}, r"explore is 1.5 and ranked 0.5; expected shares in \[0, 1\]"),
    ],
)
def test_pushes_that_cannot_be_learnt_are_refused(changes, message):
    with pytest.raises(MechSearchError, match=message):
        PushValues(**changes)


def test_an_unknown_variant_is_refused_with_the_valid_ones():
    with pytest.raises(MechSearchError, match="method, ddpg"):
        run_config("sac")


def test_an_unknown_field_in_a_file_is_refused(tmp_path):
    path = tmp_path / "config.json"
    save_config(PRESETS["method"], path)
    found = {k: v for k, v in json.loads(path.read_text()).items() if k not in ("check", "record")}
    path.write_text(json.dumps({**found, "algorithm": {**found["algorithm"], "speed": 3}}))
    with pytest.raises(MechSearchError, match="ActorCritic has no speed"):
        load_config(path)
    with pytest.raises(MechSearchError, match="no training configuration"):
        load_config(tmp_path / "none.json")


PAPER = Path(__file__).parents[2] / "results" / "paper"


@pytest.mark.parametrize(
    "variant", ["method", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input", "plus"]
)
def test_runs_of_earlier_versions_are_the_presets_that_they_were(variant):
    """The committed runs of the paper's table, whose files had the options of both algorithms."""
    found = load_config(PAPER / "single" / "runs" / f"{variant}-seed2" / "config.json")
    watched = found.schedule.grasp_network
    schedule = replace(Schedule(), validation_heaps=0, held_out_heaps=50, grasp_network=watched)
    assert found == replace(PRESETS[variant], seed=2, schedule=schedule)


def test_an_option_that_went_is_read_where_it_had_the_value_that_all_have_now(tmp_path):
    old = {"name": "method", "seed": 0, "learner": {"horizon": 1, "gamma": 0.5}}
    path = tmp_path / "config.json"
    path.write_text(json.dumps(old))
    assert load_config(path).algorithm.learner == LearnerConfig(gamma=0.5)
    path.write_text(json.dumps({**old, "learner": {"horizon": 3}}))
    with pytest.raises(MechSearchError, match="horizon is 3, and this version knows 1 alone"):
        load_config(path)
    path.write_text(json.dumps({**old, "speed": 3}))
    with pytest.raises(MechSearchError, match="has no speed"):
        load_config(path)
