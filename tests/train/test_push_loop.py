from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.agent.policy import ACTOR_FILE
from mechsearch.agent.push_policy import PushPolicyConfig
from mechsearch.agent.push_value import PushValueConfig
from mechsearch.agent.trained import load_policy
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.pushes import draw_pushes, look
from mechsearch.runs import read_lines
from mechsearch.train.collector import Parts
from mechsearch.train.config import PushLearningConfig, preset_config
from mechsearch.train.push_loop import learn_pushes
from mechsearch.train.push_session import PushSession, load_episode
from mechsearch.train.push_tries import Trials, carry_out
from mechsearch.types import MechSearchError


@pytest.fixture
def plus():
    pushes = PushLearningConfig(
        networks=2,
        tries=3,
        value=PushValueConfig(filters=4, hidden=(16, 8), batch=16, epochs=2),
        policy=PushPolicyConfig(candidates=12),
    )
    return replace(preset_config("plus"), actions=60, evaluate_every=20, pushes=pushes)


@pytest.fixture
def make_env(covered, boxes):
    def make():
        config = HeapEnvConfig(privileged=True, max_actions=20)
        return HeapEnv([covered, replace(covered, seed=5)], boxes, config)

    return make


@pytest.fixture
def make_parts(make_env):
    def make():
        def evaluate(policy):
            policy.reset(np.random.default_rng(0))
            return {"networks": float(len(policy.networks))}

        return Parts(make_env(), range(2), {}, {"validation": evaluate})

    return make


def lines(run, kind):
    return [record for record in read_lines(run / "metrics.jsonl") if record["kind"] == kind]


def test_a_push_tried_from_a_snapshot_goes_as_it_goes_when_executed(make_env):
    """The trial sees no images; its outcome is the executed one's to the last bit."""
    env = make_env()
    obs, _ = env.reset(seed=1, options={"heap": 0})
    sight = look(obs, env._observer.camera)
    for push in draw_pushes(4, np.random.default_rng(2)):
        snapshot = env.snapshot()
        tried = Trials(env).attempt(snapshot, push, sight)
        executed = carry_out(env, env.restore(snapshot), push, sight)
        assert tried.outcome == executed.outcome
        assert tried.outcome is not None
        env.restore(snapshot)


def test_a_trial_is_not_cut_off_by_the_episodes_length_and_an_executed_push_is(make_env):
    env = make_env()
    obs, _ = env.reset(seed=1, options={"heap": 0})
    sight = look(obs, env._observer.camera)
    for _ in range(19):
        obs, *_ = env.step(np.zeros(3, np.float32))
    push, snapshot = draw_pushes(1, np.random.default_rng(2))[0], env.snapshot()
    assert Trials(env).attempt(snapshot, push, sight).outcome is not None
    cut = carry_out(env, obs, push, sight)
    assert (cut.end, cut.actions, cut.outcome) == ("action limit", 1, None)


def test_a_run_executes_its_actions_counts_trials_apart_and_fits_as_it_goes(
    plus, make_parts, tmp_path
):
    scores = learn_pushes(plus, make_parts(), tmp_path)
    assert scores == {"networks": 2.0}
    episodes, fits = lines(tmp_path, "episode"), lines(tmp_path, "fit")
    assert 60 <= episodes[-1]["executed"] < 80
    assert episodes[-1]["executed"] == sum(record["actions"] for record in episodes)
    assert [fit["step"] for fit in fits] == [20, 40, 60]
    assert fits[-1]["simulated"] > fits[-1]["executed"]
    assert all(record["return"] <= -0.5 * record["actions"] + 25 for record in episodes)
    policy = load_policy(tmp_path)
    assert policy.training_actions == episodes[-1]["executed"]
    assert policy.networks[0].config == plus.pushes.value


def test_everything_seen_is_kept_and_fitted(plus, make_parts, tmp_path):
    learn_pushes(plus, make_parts(), tmp_path)
    files = sorted((tmp_path / "pushes").iterdir())
    kept = [load_episode(file) for file in files]
    assert [e.summary["pushes"] for e in kept] == [r["pushes"] for r in lines(tmp_path, "episode")]
    assert sum(len(e.samples) for e in kept) == lines(tmp_path, "fit")[-1]["pushes"]


def test_a_run_that_was_killed_goes_on_as_if_it_never_had_been(plus, make_parts, tmp_path):
    class Killed(Exception):  # noqa: N818
        pass

    learn_pushes(plus, make_parts(), tmp_path / "whole")
    seen = []

    def kill(label, done, total):
        seen.append(done)
        if done >= 30:
            raise Killed

    with pytest.raises(Killed):
        learn_pushes(plus, make_parts(), tmp_path / "killed", progress=kill)
    learn_pushes(plus, make_parts(), tmp_path / "killed", resume=True)
    for name in ("metrics.jsonl", ACTOR_FILE):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_run_that_is_made_longer_is_the_run_that_was_longer_from_the_start(
    plus, make_parts, tmp_path
):
    learn_pushes(plus, make_parts(), tmp_path / "long")
    learn_pushes(replace(plus, actions=40), make_parts(), tmp_path / "short")
    assert [fit["step"] for fit in lines(tmp_path / "short", "fit")] == [20, 40]
    learn_pushes(plus, make_parts(), tmp_path / "short", resume=True)

    def files(run):
        kept = (
            path for path in run.rglob("*") if path.is_file() and "tensorboard" not in str(path)
        )
        return {str(path.relative_to(run)): path.read_bytes() for path in kept}

    longer = files(tmp_path / "short")
    assert f"pushes/{len(lines(tmp_path / 'long', 'episode')) - 1:06d}.safetensors" in longer
    assert longer == files(tmp_path / "long")


def test_an_episode_over_several_fits_leaves_none_out(plus, make_parts, tmp_path):
    often = replace(plus, actions=12, evaluate_every=4)
    learn_pushes(often, make_parts(), tmp_path)
    assert [fit["step"] for fit in lines(tmp_path, "fit")] == [4, 8, 12]
    assert [score["step"] for score in lines(tmp_path, "validation")] == [4, 8, 12]


def test_later_pushes_are_the_policys_best_but_for_a_share(plus, make_env):
    explorer = replace(plus, pushes=replace(plus.pushes, explore=0.0, ranked=1.0))
    session = PushSession(explorer, make_env(), range(2))
    session.remember(session.episode())
    session.fit()
    env = session._env
    obs, _ = env.reset(seed=1, options={"heap": 0})
    sight = session.policy.see(obs)
    chosen = session._choose(sight)
    values = session.policy.judge(chosen, sight)
    assert (np.diff(values) <= 1e-6).all()
    session._rng = np.random.default_rng(0)
    drawn = draw_pushes(12, np.random.default_rng(0))
    assert session._choose(sight)[0] == drawn[session.policy.best(drawn, sight)]


def test_what_follows_a_push_is_a_line_through_what_followed(plus, make_env):
    session = PushSession(plus, make_env(), range(2))
    session.remember(session.episode())
    occlusion = torch.rand(80)
    session._followed = [torch.stack([occlusion, -3 - 5 * occlusion], dim=1)]
    found = session.fit()
    assert found["at_once"] == pytest.approx(-3, abs=1e-4)
    assert found["by_occlusion"] == pytest.approx(5, abs=1e-4)


def test_pushes_are_learnt_in_heaps_only(plus, make_parts, tmp_path):
    parts = replace(make_parts(), env=object())
    with pytest.raises(MechSearchError, match="learnt in heaps, not in a object"):
        learn_pushes(plus, parts, tmp_path)
    assert not any(tmp_path.iterdir())
