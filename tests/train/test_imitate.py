from dataclasses import replace

import numpy as np
import pytest

from mechsearch.agent.cloner import ClonerConfig
from mechsearch.agent.policy import load_actor
from mechsearch.runs import read_lines
from mechsearch.train.config import ImitationConfig
from mechsearch.train.demonstrations import Demonstration
from mechsearch.train.imitate import imitate
from mechsearch.types import ACTOR_KEYS, MechSearchError


@pytest.fixture
def expert(pointer):
    """Acts from the present state to the end, as a look-ahead expert would."""

    def act(env):
        guide, samples, over, total = pointer(), [], False, 0.0
        guide.reset(np.random.default_rng(0))
        obs = env.observe()
        while not over:
            action = guide.act({key: obs[key] for key in guide.keys})
            samples.append((obs, action))
            obs, reward, terminated, truncated, _ = env.step(action)
            over, total = terminated or truncated, total + reward
        tried = 24 * len(samples)
        return Demonstration.of(samples, ACTOR_KEYS, tried, len(samples), total), tried

    return act


@pytest.fixture
def demonstrations(reach_env, expert):
    env, found = reach_env(), []
    for i in range(60):
        env.reset(seed=i, options={"heap": i % 20})
        found.append(expert(env)[0])
    return found


@pytest.fixture
def plus(config):
    cloner = ClonerConfig(batch=32, average=0.95, rate=3e-3)
    return replace(
        config,
        name="plus",
        actions=0,
        evaluate_every=60,
        checkpoint_every=30,
        imitation=ImitationConfig(updates=100, cloner=cloner),
    )


def lines(run, kind):
    return [record for record in read_lines(run / "metrics.jsonl") if record["kind"] == kind]


def test_the_clone_does_what_the_expert_does(plus, demonstrations, make_parts, tmp_path, score):
    plus = replace(plus, imitation=replace(plus.imitation, updates=250))
    scores = imitate(plus, demonstrations, tmp_path, make_parts())
    assert scores["uncovered_rate"] > 0.7
    assert scores == score(load_actor(tmp_path))
    errors = [record["angle_error"] for record in lines(tmp_path, "validation_error")]
    assert errors[-1] < 0.6


def test_a_resumed_imitation_is_the_one_that_was_never_stopped(
    plus, demonstrations, make_parts, expert, tmp_path
):
    class Killed(Exception):  # noqa: N818
        pass

    calls = []

    def dying(env):
        calls.append(env)
        if len(calls) == 4:
            raise Killed
        return expert(env)

    total = sum(d.executed_actions for d in demonstrations) + 200
    plan = replace(plus.imitation, updates=40, executed_actions=total, longest_lead=3)
    plus = replace(plus, imitation=plan, evaluate_every=25)
    imitate(plus, demonstrations, tmp_path / "whole", make_parts(), expert)
    with pytest.raises(Killed):
        imitate(plus, demonstrations, tmp_path / "parts", make_parts(), dying)
    imitate(plus, demonstrations, tmp_path / "parts", make_parts(), expert, resume=True)
    for name in ("metrics.jsonl", "actor.safetensors"):
        whole = (tmp_path / "whole" / name).read_bytes()
        assert (tmp_path / "parts" / name).read_bytes() == whole


def test_corrections_are_counted_kept_and_learnt(
    plus, demonstrations, make_parts, expert, tmp_path
):
    shown = sum(d.executed_actions for d in demonstrations)
    plan = replace(plus.imitation, updates=20, executed_actions=shown + 60, longest_lead=4)
    imitate(replace(plus, imitation=plan), demonstrations, tmp_path, make_parts(), expert)
    last = lines(tmp_path, "corrections")[-1]
    assert shown + 60 <= last["executed"] < shown + 90
    before = sum(d.simulated_actions for d in demonstrations)
    assert last["simulated"] > before
    assert len(list((tmp_path / "corrections").glob("*.npz"))) == last["episodes"] > 0
    assert last["updates"] > 20
    assert load_actor(tmp_path).training_actions == last["executed"]


def test_nothing_to_imitate_is_refused(plus, make_parts, tmp_path):
    with pytest.raises(MechSearchError, match="no demonstration"):
        imitate(plus, [], tmp_path, make_parts())


def test_demonstrations_without_the_actors_keys_are_refused(
    plus, demonstrations, make_parts, tmp_path
):
    plus = replace(plus, actor_keys=("depth", "rgb"))
    with pytest.raises(MechSearchError, match="lack rgb"):
        imitate(plus, demonstrations, tmp_path, make_parts())
