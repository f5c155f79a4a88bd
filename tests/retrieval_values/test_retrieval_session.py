"""Learning to retrieve: what an episode teaches, and runs that are stopped and go on."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mechsearch.algorithm import RunConfig, TrainingSetup
from mechsearch.cli import main
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrievalTask, RetrieveConfig, TaskConfig
from mechsearch.env.trial import Rollout
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.rollout import evaluate
from mechsearch.files import read_lines
from mechsearch.heaps.dataset import embedded_file
from mechsearch.retrieval import grasper as room
from mechsearch.retrieval_values import algorithm as session_room
from mechsearch.retrieval_values.algorithm import (
    RetrievalValues,
    RetrievalValuesSession,
    load_options,
)
from mechsearch.retrieval_values.policy import RetrievePolicyConfig
from mechsearch.retrieval_values.value import RetrievalValueConfig
from mechsearch.training.config import load_config, run_config
from mechsearch.training.loop import learn
from mechsearch.training.run import train
from mechsearch.training.run_directory import load_policy
from mechsearch.types import RETRIEVAL_KEYS, MechSearchError
from tests.retrieval.middle_planner import MiddlePlanner

HEAPS = embedded_file("single")


@pytest.fixture(scope="module", autouse=True)
def _by_middle():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room, "GraspPlanner", MiddlePlanner)
        yield


@pytest.fixture(scope="module")
def config():
    return run_config("retrieve").changed(
        actions=12,
        evaluate_every=4,
        checkpoint_every=4,
        networks=2,
        tries=2,
        value=RetrievalValueConfig(filters=4, hidden=(16, 8), batch=16, epochs=2),
        policy=RetrievePolicyConfig(pushes=4, removals=2),
        max_actions=20,
        max_grasps=2,
    )


@pytest.fixture(scope="module")
def make_parts(covered, boxes, config):
    def make():
        def evaluate(policy):
            policy.reset(np.random.default_rng(0))
            return {"networks": float(len(getattr(policy, "policy", policy).networks))}

        task = RetrieveConfig.of_task(config.task, RETRIEVAL_KEYS, privileged=True)
        env = RetrieveEnv([covered, replace(covered, seed=5)], boxes, task)
        return TrainingSetup(env, range(2), {}, {"validation": evaluate})

    return make


@pytest.fixture(scope="module")
def whole(config, make_parts, tmp_path_factory):
    """A run that was never interrupted, and its last scores."""
    run = tmp_path_factory.mktemp("retrieve") / "whole"
    return run, learn(config, make_parts(), run)


def lines(run, kind):
    return [record for record in read_lines(run / "metrics.jsonl") if record["kind"] == kind]


def files(run):
    """Return everything in a run directory but what TensorBoard stamps with the time."""
    kept = (path for path in run.rglob("*") if path.is_file() and path.parent.name != "tensorboard")
    return {str(path.relative_to(run)): path.read_bytes() for path in kept}


def test_a_run_executes_its_decisions_counts_trials_apart_and_fits_as_it_goes(config, whole):
    run, scores = whole
    assert scores == {"networks": 2.0}
    episodes, fits = lines(run, "episode"), lines(run, "fit")
    done = sum(e["pushes"] + e["grasps"] + e["removals"] for e in episodes)
    assert episodes[-1]["executed"] >= max(done, 12)
    assert [fit["step"] for fit in fits] == [4, 8, 12]
    assert fits[-1]["simulated"] > fits[-1]["executed"]
    assert {e["end"] for e in episodes} <= {"retrieved", "budget", "lost"}
    assert all(e["retrieved"] == (e["end"] == "retrieved") for e in episodes)
    # Until the first fit all is explored.
    assert episodes[0]["explored"] > 0
    loaded = load_policy(run)
    assert loaded.training_actions == episodes[-1]["executed"]
    assert loaded.policy.networks[0].config == config.algorithm.value


def test_all_that_was_tried_is_kept_and_fitted(whole):
    run, _ = whole
    kept = [load_options(file) for file in sorted((run / "options").iterdir())]
    assert len(kept) == len(lines(run, "episode"))
    assert sum(len(samples) for samples in kept) == lines(run, "fit")[-1]["options"] > 0
    for samples in kept:
        assert ((samples.chance >= 0) & (samples.chance <= 1)).all()
        assert (samples.clutter >= 0).all()
        # Decisions in order, each of at most two pushes and two removals.
        assert (torch.diff(samples.decision) >= 0).all()
        assert not len(samples) or torch.bincount(samples.decision).max() <= 4


def test_a_run_that_was_killed_goes_on_as_if_it_never_had_been(config, whole, make_parts, tmp_path):
    class Killed(Exception):  # noqa: N818
        pass

    def kill(label, done, total):
        if done >= 7:
            raise Killed

    with pytest.raises(Killed):
        learn(config, make_parts(), tmp_path, progress=kill)
    assert files(tmp_path) != files(whole[0])
    learn(config, make_parts(), tmp_path, resume=True)
    assert files(tmp_path) == files(whole[0])


def test_a_run_that_is_made_longer_is_the_run_that_was_longer_from_the_start(
    config, whole, make_parts, tmp_path
):
    learn(config.changed(actions=8), make_parts(), tmp_path)
    learn(config, make_parts(), tmp_path, resume=True)
    assert files(tmp_path) == files(whole[0])


def test_an_episode_that_was_damaged_is_named_when_a_run_goes_on(
    config, whole, make_parts, tmp_path
):
    shutil.copytree(whole[0], tmp_path / "run")
    file = tmp_path / "run" / "options" / "000000.safetensors"
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(MechSearchError, match=r"options/000000.safetensors is damaged"):
        learn(config.changed(actions=16), make_parts(), tmp_path / "run", resume=True)


def begun(config, parts):
    """Return a session at its beginning, whose episodes are not written."""
    return RetrievalValuesSession(config, parts, Path("nowhere"))


def test_an_option_comes_to_the_chance_of_the_best_grasp_after_it(config, make_parts):
    """Without the lid, the cube's grasp in the middle works: half its 0.6, and half of 1."""
    session = begun(config, make_parts())
    samples, _ = session.episode()
    removals = samples.numbers[:, 4] == 0
    assert removals.any()
    assert samples.chance[removals].max() == pytest.approx((0.6 + 1) / 2)
    np.testing.assert_allclose(samples.clutter[removals], 0, atol=1e-3)


@pytest.mark.parametrize(
    ("end", "chance"),
    [("retrieved", 1.0), ("lost", 0.0), ("budget", None), ("failure: explosion", None)],
)
def test_what_ended_the_episode_counts_and_what_was_cut_off_or_failed_teaches_nothing(
    config, make_parts, monkeypatch, end, chance
):
    session = begun(config, make_parts())
    obs, _ = session._env.reset(seed=0, options={"heap": 0})
    session.policy.reset(session._rng)
    ended = Rollout({}, [np.zeros(9)], clutter_moved=0.01, end=end)
    monkeypatch.setattr(session_room, "roll_out", lambda *_: ended)
    samples = []
    tried = session._tried(obs, 0, samples)
    assert len(tried) == 3
    expected = [] if chance is None else [pytest.approx(chance)] * 3
    assert samples[0].chance.tolist() == expected


def test_trials_leave_the_episode_where_it_is(config, make_parts):
    session = begun(config, make_parts())
    obs, _ = session._env.reset(seed=0, options={"heap": 0})
    session.policy.reset(session._rng)
    before = {name: value.tobytes() for name, value in session._env.snapshot().items()}
    assert session._tried(obs, 0, [])
    assert {n: v.tobytes() for n, v in session._env.snapshot().items()} == before


def test_after_a_fit_the_policy_decides_and_the_best_pushes_are_tried(config, make_parts):
    session = begun(config.changed(explore=0.0, ranked=1.0), make_parts())
    session._samples.append(session.episode()[0])
    session.fit()
    assert session.episode()[1]["explored"] == 0
    obs, _ = session._env.reset(seed=1, options={"heap": 0})
    session.policy.reset(session._rng)
    view = session.policy.grasper.view(obs)
    options = session.policy.options(obs, view)
    worth = np.arange(len(options), dtype=np.float64)
    # All removals, and of the pushes the last two.
    assert session._choose(options, worth) == [options[0], options[-1], options[-2]]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"tries": 9, "policy": RetrievePolicyConfig(pushes=8)}, "tries is 9, but 8 pushes"),
        ({"explore": 1.5}, "explore is 1.5"),
        ({"networks": 0}, "networks is 0"),
    ],
)
def test_options_out_of_range_are_refused(wrong, message):
    with pytest.raises(MechSearchError, match=message):
        RetrievalValues(**wrong)


def test_only_a_task_of_retrieval_is_learnt(config, covered, boxes):
    with pytest.raises(MechSearchError, match=r"RetrievalTask, not in a TaskConfig.* retrieve"):
        RunConfig("retrieve", RetrievalValues(), task=TaskConfig())
    env = HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))
    with pytest.raises(MechSearchError, match="RetrieveEnv, not in a HeapEnv"):
        begun(config, TrainingSetup(env, range(1), {}, {}))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of a robot with a cup too, that grasps twice, not quite where it wants to."""
    out = tmp_path_factory.mktemp("runs") / "run"
    train(
        "retrieve", HEAPS, out, actions=1, validation_heaps=1, tries=1, networks=1,
        value=RetrievalValueConfig(filters=4, hidden=(8, 8), epochs=1),
        policy=RetrievePolicyConfig(pushes=2, removals=1),
        grippers=("jaws-85", "suction"), max_grasps=2, max_removals=3, max_actions=5,
        perturbed=True,
    )  # fmt: skip
    return out


def test_a_run_is_evaluated_in_the_task_that_it_was_trained_in(run):
    kept = load_config(run / "config.json").task
    assert isinstance(kept, RetrievalTask)
    assert (kept.grippers, kept.max_grasps, kept.perturbed) == (("jaws-85", "suction"), 2, True)
    found = evaluate(str(run), HEAPS, limit=1)
    shown = found.header["env"]
    assert shown["grippers"] == ["jaws-85", "suction"]
    assert (shown["max_grasps"], shown["max_removals"], shown["max_actions"]) == (2, 3, 5)
    assert shown["perturbed"] is True
    assert found.header["task_differs"] == []
    assert (found.header["name"], found.header["trained"]) == ("retrieve", True)
    assert found.episodes[0].actions.shape[1] == 9


def test_another_task_is_named(run):
    other = RetrievalTask(grippers=("jaws-85",), max_grasps=2, max_removals=3, max_actions=5)
    found = evaluate(str(run), HEAPS, limit=1, task=other)
    assert found.header["task_differs"] == [
        "grippers ('jaws-85', 'suction') -> ('jaws-85',)", "perturbed True -> False",
    ]  # fmt: skip


def test_a_run_is_evaluated_by_command(run, tmp_path, capsys):
    words = ["evaluate", str(run), "--heaps", str(HEAPS), "--limit", "1", "--workers", "1"]
    main([*words, "--out", str(tmp_path)])
    assert "retrieved" in capsys.readouterr().out
    (file,) = tmp_path.glob("*.npz")
    assert load_episodes(file).header["goal"] == "retrieve"


def test_an_unknown_gripper_is_named_before_anything_is_trained(tmp_path):
    with pytest.raises(MechSearchError, match="unknown gripper 'claw'; choose one of jaws-56"):
        train("retrieve", HEAPS, tmp_path / "run", grippers=("claw",))
    assert not (tmp_path / "run").exists()


def test_a_runs_damaged_weights_are_named(run, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    file = copy / "actor.safetensors"
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(MechSearchError, match=r"actor\.safetensors is damaged"):
        evaluate(str(copy), HEAPS, limit=1)
