import errno
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from mechsearch.algorithm import TrainingSetup
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.files import (
    read_lines,
)
from mechsearch.files import (
    tensors as weights,
)
from mechsearch.findings.experiment import read_run
from mechsearch.push_values.algorithm import PushValuesSession
from mechsearch.push_values.episodes import load_episode
from mechsearch.push_values.value import PushValueConfig
from mechsearch.pushes.push import draw_pushes
from mechsearch.report.figures import draw_training
from mechsearch.training.config import run_config
from mechsearch.training.loop import learn
from mechsearch.training.run_directory import load_policy
from mechsearch.types import MechSearchError


@pytest.fixture(scope="module")
def plus():
    return run_config("plus").changed(
        actions=60,
        evaluate_every=20,
        checkpoint_every=20,
        networks=2,
        tries=3,
        candidates=12,
        value=PushValueConfig(filters=4, hidden=(16, 8), batch=16, epochs=2),
    )


@pytest.fixture(scope="module")
def make_env(covered, boxes):
    def make():
        config = HeapEnvConfig(privileged=True, max_actions=20)
        return HeapEnv([covered, replace(covered, seed=5)], boxes, config)

    return make


@pytest.fixture(scope="module")
def make_parts(make_env):
    def make():
        def evaluate(policy):
            policy.reset(np.random.default_rng(0))
            return {"networks": float(len(getattr(policy, "policy", policy).networks))}

        return TrainingSetup(make_env(), range(2), {}, {"validation": evaluate})

    return make


@pytest.fixture(scope="module")
def whole(plus, make_parts, tmp_path_factory):
    """A run that was never interrupted, and its last scores."""
    run = tmp_path_factory.mktemp("plus") / "whole"
    return run, learn(plus, make_parts(), run)


def begun(config, make_env):
    """Return a session at its beginning, whose episodes are not written."""
    return PushValuesSession(config, TrainingSetup(make_env(), range(2), {}, {}), Path("nowhere"))


def lines(run, kind):
    return [record for record in read_lines(run / "metrics.jsonl") if record["kind"] == kind]


def test_a_run_executes_its_actions_counts_trials_apart_and_fits_as_it_goes(plus, whole):
    run, scores = whole
    assert scores == {"networks": 2.0}
    episodes, fits = lines(run, "episode"), lines(run, "fit")
    assert 60 <= episodes[-1]["executed"] < 80
    assert episodes[-1]["executed"] == sum(record["actions"] for record in episodes)
    assert [fit["step"] for fit in fits] == [20, 40, 60]
    assert fits[-1]["simulated"] > fits[-1]["executed"]
    assert all(record["return"] <= -0.5 * record["actions"] + 25 for record in episodes)
    loaded = load_policy(run)
    assert loaded.training_actions == episodes[-1]["executed"]
    assert loaded.policy.networks[0].config == plus.algorithm.value


def test_everything_seen_is_kept_and_fitted(whole):
    run, _ = whole
    kept = [load_episode(file) for file in sorted((run / "pushes").iterdir())]
    assert [e.summary["pushes"] for e in kept] == [r["pushes"] for r in lines(run, "episode")]
    assert sum(len(e.samples) for e in kept) == lines(run, "fit")[-1]["pushes"]


def test_the_log_has_whatever_a_report_draws_of_it(whole):
    run = read_run(whole[0])
    figure = draw_training(run)
    assert [bool(ax.lines) for ax in figure.axes] == [True] * 6
    assert run.records["validation"]


def files(run):
    """Return everything in a run directory but what TensorBoard stamps with the time."""
    kept = (path for path in run.rglob("*") if path.is_file() and path.parent.name != "tensorboard")
    return {str(path.relative_to(run)): path.read_bytes() for path in kept}


def test_a_run_that_was_killed_goes_on_as_if_it_never_had_been(plus, whole, make_parts, tmp_path):
    class Killed(Exception):  # noqa: N818
        pass

    def kill(label, done, total):
        if done >= 30:
            raise Killed

    with pytest.raises(Killed):
        learn(plus, make_parts(), tmp_path, progress=kill)
    learn(plus, make_parts(), tmp_path, resume=True)
    assert files(tmp_path) == files(whole[0])


def test_a_run_is_the_same_bytes_whatever_the_number_of_processes(
    plus, whole, make_parts, tmp_path
):
    learn(plus, TrainingSetup(make_parts().env, range(2), {}, {}, 2), tmp_path)
    two, one = files(tmp_path), files(whole[0])
    for name in ("actor.safetensors", *(name for name in one if name.startswith("pushes/"))):
        assert two[name] == one[name]


def test_a_disk_that_is_full_is_told_by_the_episodes_file_and_costs_nothing(
    plus, whole, make_parts, tmp_path, monkeypatch
):
    def full(tensors, path, header):
        if path.parent.name == "pushes" and path.name.startswith(".000002."):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        save_file(tensors, path, header)

    with monkeypatch.context() as disk:
        disk.setattr(weights, "save_file", full)
        with pytest.raises(MechSearchError, match=r"cannot write .*pushes/000002.*free some space"):
            learn(plus, make_parts(), tmp_path)
    assert not list(tmp_path.rglob("*.partial*"))
    learn(plus, make_parts(), tmp_path, resume=True)
    assert files(tmp_path) == files(whole[0])


def test_a_run_that_is_made_longer_is_the_run_that_was_longer_from_the_start(
    plus, whole, make_parts, tmp_path
):
    learn(plus.changed(actions=40), make_parts(), tmp_path)
    assert [fit["step"] for fit in lines(tmp_path, "fit")] == [20, 40]
    learn(plus, make_parts(), tmp_path, resume=True)
    assert files(tmp_path) == files(whole[0])


def test_a_run_that_ended_between_two_fits_goes_on_without_the_fit_at_its_end(
    plus, whole, make_parts, tmp_path
):
    learn(plus.changed(actions=50), make_parts(), tmp_path)
    assert [fit["step"] for fit in lines(tmp_path, "fit")] == [20, 40, 50]
    learn(plus, make_parts(), tmp_path, resume=True)
    for name in ("metrics.jsonl", "actor.safetensors"):
        assert (tmp_path / name).read_bytes() == (whole[0] / name).read_bytes()


def test_an_episode_that_was_damaged_is_named_when_a_run_goes_on(plus, whole, make_parts, tmp_path):
    shutil.copytree(whole[0], tmp_path / "run")
    file = tmp_path / "run" / "pushes" / "000001.safetensors"
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(MechSearchError, match=r"pushes/000001.safetensors is damaged"):
        learn(plus.changed(actions=80), make_parts(), tmp_path / "run", resume=True)


def test_an_episode_over_several_fits_leaves_none_out(plus, make_parts, tmp_path):
    often = plus.changed(actions=12, evaluate_every=4)
    learn(often, make_parts(), tmp_path)
    assert [fit["step"] for fit in lines(tmp_path, "fit")] == [4, 8, 12]
    assert [score["step"] for score in lines(tmp_path, "validation")] == [4, 8, 12]


def test_later_pushes_are_the_policys_best_but_for_a_share(plus, make_env):
    explorer = plus.changed(explore=0.0, ranked=1.0)
    session = begun(explorer, make_env)
    session.remember(session.episodes(0))
    session.fit()
    obs, _ = session.episodes.env.reset(seed=1, options={"heap": 0})
    sight = session.policy.see(obs)
    chosen = session.episodes._choose(sight, np.random.default_rng(2))
    values = session.policy.judge(chosen, sight)
    assert (np.diff(values) <= 1e-6).all()
    drawn = draw_pushes(12, np.random.default_rng(0))
    best = session.episodes._choose(sight, np.random.default_rng(0))[0]
    assert best == drawn[session.policy.best(drawn, sight)]


def test_with_one_try_the_best_push_is_executed_and_a_random_one_now_and_then(plus, make_env):
    def executed(explore):
        session = begun(plus.changed(tries=1, explore=explore), make_env)
        session.remember(session.episodes(0))
        session.fit()
        obs, _ = session.episodes.env.reset(seed=1, options={"heap": 0})
        sight, drawn = session.policy.see(obs), draw_pushes(12, np.random.default_rng(0))
        (chosen,) = session.episodes._choose(sight, np.random.default_rng(0))
        return drawn.index(chosen), session.policy.best(drawn, sight)

    chosen, best = executed(explore=0.0)
    assert chosen == best
    assert executed(explore=1.0)[0] == 0


def test_a_push_that_takes_no_action_is_followed_by_another(plus, make_env, monkeypatch):
    session, first = begun(plus, make_env), []
    begin = session.policy.begin

    def begun_at_its_end(push, sight):
        planned = begin(push, sight)
        if not first:
            first.append(planned)
            planned.act = lambda obs: None
        return planned

    monkeypatch.setattr(session.policy, "begin", begun_at_its_end)
    episode = session.episodes(0)
    assert episode.summary["actions"] > 0
    assert len(episode.followed) <= episode.summary["pushes"]
    # Nothing was learnt of it, but of what was tried beside it.
    assert (episode.samples.outcomes[:, 1] > 0).all()
    assert len(episode.samples) > plus.algorithm.tries


def test_more_tries_than_candidates_are_refused(plus):
    with pytest.raises(MechSearchError, match="tries is 13, but 12 candidates"):
        plus.changed(tries=13)


def test_what_follows_a_push_is_a_line_through_what_followed(plus, make_env):
    session = begun(plus, make_env)
    session.remember(session.episodes(0))
    occlusion = torch.rand(80)
    session._followed = [torch.stack([occlusion, -3 - 5 * occlusion], dim=1)]
    found = session.fit()
    assert found["at_once"] == pytest.approx(-3, abs=1e-4)
    assert found["by_occlusion"] == pytest.approx(5, abs=1e-4)


def test_pushes_are_learnt_in_heaps_only(plus, make_parts, tmp_path):
    parts = replace(make_parts(), env=object())
    with pytest.raises(MechSearchError, match="learnt in heaps, not in a object"):
        learn(plus, parts, tmp_path)
    assert not any(tmp_path.iterdir())


def test_decisions_are_learnt_from_as_other_sensors_see_them(plus, make_env):
    """Each push a second time, with the same outcome and way, and another image."""
    alone, both = (
        begun(plus.changed(also=also), make_env).episodes(0) for also in ((), ("stereo",))
    )
    assert alone.summary == both.summary
    np.testing.assert_array_equal(alone.followed, both.followed)
    count, own = len(alone.samples), both.samples
    assert count < len(own) <= 2 * count
    outcomes = [tuple(row) for row in own.outcomes.tolist()]
    assert set(outcomes) == {tuple(row) for row in alone.samples.outcomes.tolist()}
    tries = plus.algorithm.tries
    first, again = slice(0, tries), slice(tries, 2 * tries)
    assert outcomes[first] == outcomes[again]
    assert (own.patches[first] != own.patches[again]).any()
    # Heights are off by what the sensor is, and ways by little.
    assert (own.numbers[first] - own.numbers[again]).abs().max() < 1
    with pytest.raises(MechSearchError, match="unknown sensor 'eyes'; choose one of perfect"):
        plus.changed(also=("eyes",))
