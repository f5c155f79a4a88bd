import json
from dataclasses import asdict, replace

import pytest

from mechsearch.actor_critic.learner import LearnerConfig
from mechsearch.training.config import (
    PRESETS,
    PushLearningConfig,
    TrainConfig,
    load_config,
    preset_config,
    save_config,
)
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, MechSearchError


@pytest.mark.parametrize("name", PRESETS)
def test_presets_come_back_from_their_file(name, tmp_path):
    save_config(PRESETS[name], tmp_path / "config.json")
    assert load_config(tmp_path / "config.json") == PRESETS[name]
    assert PRESETS[name].name == name


def test_ddpg_differs_in_guidance_critic_and_what_imitation_needs_alone():
    ddpg, method = PRESETS["ddpg"], PRESETS["method"]
    assert ddpg.teachers == ()
    assert ddpg.critic_keys == ddpg.actor_keys == method.actor_keys
    same = replace(
        ddpg,
        name="method",
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
    assert replace(PRESETS["plus"], camera="tilted").learner.symmetry


def test_only_the_no_pose_ablation_changes_what_the_actor_sees():
    changed = {name for name, config in PRESETS.items() if config.actor_keys != ACTOR_KEYS}
    assert changed == {"no-pose-input"}


def test_no_actor_sees_privileged_keys():
    for config in PRESETS.values():
        assert not set(config.actor_keys) & set(PRIVILEGED_KEYS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"imitated": ("sprial",)},
            "imitated names 'sprial', but .* straight, zigzag",
        ),
        ({"imitated": ("spiral",), "teachers": ()}, "imitated names 'spiral'.* are none"),
        ({"teachers": ("push",)}, "unknown teacher 'push'; choose among straight"),
        ({"learner": LearnerConfig(dropout=0.0)}, "teachers need a Bayesian critic"),
        ({"actor_keys": ("target_offset",)}, "must not see 'target_offset'"),
        (
            {"pushes": PushLearningConfig(networks=1), "actions": 4500},
            "fits its networks every 1000 actions .* actions is 4500; expected a multiple",
        ),
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
        replace(TrainConfig(), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"networks": -1}, "networks is -1; expected at least 0"),
        ({"tries": 0}, "tries is 0; expected at least 1"),
        ({"explore": 1.5}, r"explore is 1.5 and ranked 0.5; expected shares in \[0, 1\]"),
    ],
)
def test_pushes_that_cannot_be_learnt_are_refused(changes, message):
    with pytest.raises(MechSearchError, match=message):
        PushLearningConfig(**changes)


def test_an_unknown_variant_is_refused_with_the_valid_ones():
    with pytest.raises(MechSearchError, match="method, ddpg"):
        preset_config("sac")


def test_an_unknown_field_in_a_file_is_refused(tmp_path):
    path = tmp_path / "config.json"
    path.write_text(json.dumps({**asdict(TrainConfig()), "speed": 3}))
    with pytest.raises(MechSearchError, match="TrainConfig has no speed"):
        load_config(path)
    with pytest.raises(MechSearchError, match="no training configuration"):
        load_config(tmp_path / "none.json")
