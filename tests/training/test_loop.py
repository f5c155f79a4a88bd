import errno
import os
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from mechsearch.actor_critic.algorithm import ActorCriticSession
from mechsearch.actor_critic.guidance import Guidance
from mechsearch.files import read_lines
from mechsearch.files.tensors import load_archive, save_archive
from mechsearch.training.loop import learn
from mechsearch.training.run_directory import load_policy
from mechsearch.types import ACTOR_KEYS, MechSearchError


def lines(directory, kind=None):
    return [r for r in read_lines(directory / "metrics.jsonl") if kind in (None, r["kind"])]


@pytest.fixture(scope="module")
def whole(config, make_parts, tmp_path_factory):
    """A finished run: its directory, last scores, and what it told of its progress."""
    directory, told = tmp_path_factory.mktemp("runs") / "whole", []
    parts = make_parts()
    scores = learn(config, parts, directory, progress=lambda *call: told.append(call))
    return directory, scores, told


def test_a_run_writes_all_its_files(whole):
    run, scores, _ = whole
    assert {p.name for p in run.iterdir()} == {
        "config.json", "metrics.jsonl", "speed.jsonl", "tensorboard",
        "checkpoints", "actors", "actor.safetensors",
    }  # fmt: skip
    assert [r["step"] for r in lines(run, "validation")] == [50, 100, 120]
    assert lines(run, "validation")[-1]["reward"] == scores["reward"]
    assert load_policy(run).training_actions == 120
    assert len(list((run / "checkpoints").iterdir())) == 2
    assert not list(run.rglob("*.partial*"))


def test_an_episode_line_tells_terms_choices_beliefs_and_updates(whole):
    last = lines(whole[0], "episode")[-1]
    assert last["term_near"] + last["term_idle"] == pytest.approx(last["return"])
    shares = [last[f"chosen_{name}"] for name in ("actor", "straight", "zigzag")]
    assert sum(shares) == pytest.approx(1)
    assert {"q", "return_followed", "saturated", "update_critic_loss", "update_q"} <= set(last)


def test_the_same_seed_gives_the_same_bytes(whole, config, make_parts, tmp_path):
    learn(config, make_parts(), tmp_path)
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors")


def test_who_finishes_first_changes_nothing(whole, config, make_parts, reach_env, tmp_path):
    """The world and the networks race in two threads; here the world is slow now and then."""

    class SlowEnv(reach_env):
        def step(self, action):
            time.sleep(0.02 * (self.total % 3 == 0))
            return super().step(action)

    learn(config, make_parts(SlowEnv()), tmp_path)
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors")


def test_the_collector_stops_at_an_episodes_end_and_goes_on_where_it_was(config, make_parts):
    session = ActorCriticSession(config, make_parts())
    first = session.collector.collect(3)
    again = session.collector.collect(100)
    episode = first + again
    assert len(first) == 3
    assert [done.over for done in episode] == [False] * (len(episode) - 1) + [True]
    for before, after in pairwise(episode):
        assert after.obs is before.after
    assert session.collector.collect(1)[0].obs is not episode[-1].after


def test_another_seed_gives_another_run(whole, config, make_parts, tmp_path):
    learn(config.changed(seed=1, actions=30), make_parts(), tmp_path)
    first, other = (next(read_lines(run / "metrics.jsonl")) for run in (whole[0], tmp_path))
    assert first != other


@pytest.mark.parametrize("actions", [3, 47, 50, 118])
def test_a_run_made_longer_is_the_run_that_was_never_stopped(
    actions, whole, config, make_parts, tmp_path
):
    """In the middle of an episode and of a block, at an evaluation, before the first update."""
    learn(config.changed(actions=actions), make_parts(), tmp_path)
    learn(config, make_parts(), tmp_path, resume=True)
    # The shorter run looked at itself once more, at its end; that line is not of the longer run.
    last = "checkpoints/" + last_checkpoint(whole[0])
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors", last)


def test_a_run_may_be_made_longer_action_by_action(config, make_parts, tmp_path):
    config = config.changed(actions=34, noise=replace(config.algorithm.noise, correlation=0.7))
    learn(config, make_parts(), tmp_path / "whole")
    for actions in range(18, 35):
        longer = config.changed(actions=actions)
        learn(longer, make_parts(), tmp_path / "longer", resume=actions > 18)
    assert_same_files(tmp_path / "longer", tmp_path / "whole", "metrics.jsonl", "actor.safetensors")


@pytest.mark.parametrize("killed_at", [41, 42, 44, 93])
def test_a_killed_run_resumes_exactly(killed_at, whole, config, make_parts, reach_env, tmp_path):
    class Killed(Exception):  # noqa: N818
        pass

    class DyingEnv(reach_env):
        def step(self, action):
            if self.total == killed_at:
                raise Killed
            return super().step(action)

    with pytest.raises(Killed):
        learn(config, make_parts(DyingEnv()), tmp_path)
    assert last_checkpoint(tmp_path) == f"step-{killed_at - killed_at % 40:08d}.safetensors"
    learn(config, make_parts(), tmp_path, resume=True)
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors")


def test_where_checkpoints_are_written_changes_nothing(whole, config, make_parts, tmp_path):
    learn(config.changed(checkpoint_every=7), make_parts(), tmp_path)
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors")


def test_checkpoints_are_written_on_time_and_at_the_end_and_hold_the_episode(
    config, make_parts, tmp_path
):
    learn(config.changed(actions=47, checkpoint_every=45), make_parts(), tmp_path)
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == ["step-00000045.safetensors", "step-00000047.safetensors"]
    held = [load_archive(tmp_path / "checkpoints" / n, "mechsearch checkpoint") for n in names]
    running = [archive for archive in held if archive.meta["episode"] is not None]
    assert running
    for archive in running:
        assert {"episode/env/ee", "episode/obs/depth"} <= set(archive.tensors)
        assert set(archive.meta["episode"]["teachers"]) == {"straight", "zigzag"}


def test_a_run_is_not_made_shorter(config, make_parts, tmp_path):
    learn(config.changed(actions=30), make_parts(), tmp_path)
    with pytest.raises(MechSearchError, match=r"executed 30 actions already.*at least.*not 29"):
        learn(config.changed(actions=29), make_parts(), tmp_path, resume=True)


def test_a_checkpoint_of_an_earlier_format_is_refused_by_its_number(config, make_parts, tmp_path):
    learn(config.changed(actions=30), make_parts(), tmp_path)
    path = tmp_path / "checkpoints" / last_checkpoint(tmp_path)
    archive = load_archive(path, "mechsearch checkpoint")
    older = {name: value for name, value in archive.meta.items() if name != "checkpoint"}
    save_archive(path, replace(archive, meta=older))
    with pytest.raises(MechSearchError, match=r"checkpoint of format 1.*from format 2.*version"):
        learn(config, make_parts(), tmp_path, resume=True)


def test_a_log_that_lost_lines_or_bits_is_named(config, make_parts, tmp_path):
    learn(config.changed(actions=60), make_parts(), tmp_path)
    log = tmp_path / "metrics.jsonl"
    content = log.read_bytes()
    log.write_bytes(content[: len(content) // 3])
    with pytest.raises(MechSearchError, match=r"metrics.jsonl .*lines are missing"):
        learn(config, make_parts(), tmp_path, resume=True)
    log.write_bytes(content.replace(b"0.", b"1.", 1))
    with pytest.raises(MechSearchError, match=r"line 1 of .*metrics.jsonl is damaged"):
        learn(config, make_parts(), tmp_path, resume=True)


@pytest.mark.parametrize("written", [3, 9])
def test_a_full_disk_stops_a_run_by_name_and_costs_it_nothing(
    written, whole, config, make_parts, tmp_path, monkeypatch
):
    synced, left = os.fsync, [written]

    def full(handle):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synced(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MechSearchError, match=r"cannot write .*No space left.*free some space"):
        learn(config, make_parts(), tmp_path)
    monkeypatch.undo()
    assert not list(tmp_path.rglob("*.partial*"))
    learn(config, make_parts(), tmp_path, resume=True)
    assert_same_files(tmp_path, whole[0], "metrics.jsonl", "actor.safetensors")


def assert_same_files(run, other, *names):
    for name in names:
        assert (run / name).read_bytes() == (other / name).read_bytes(), name


def last_checkpoint(run):
    return max(path.name for path in (run / "checkpoints").iterdir())


def test_a_failed_simulation_enters_no_replay(config, make_parts, reach_env, tmp_path):
    config = config.changed(actions=60, checkpoint_every=1)
    learn(config, make_parts(reach_env(fail_at=30)), tmp_path / "run")
    path = tmp_path / "run" / "checkpoints" / last_checkpoint(tmp_path / "run")
    archive = load_archive(path, "mechsearch checkpoint")
    assert archive.meta["counts"]["failures"] == 1
    kept = int(archive.tensors["replay/complete"].sum())
    waits_for_its_next = archive.meta["episode"] is not None
    assert kept == archive.meta["counts"]["step"] - 1 - waits_for_its_next
    reward, complete = archive.tensors["replay/reward"], archive.tensors["replay/complete"]
    assert torch.isfinite(reward[complete]).all()


@pytest.mark.parametrize(
    ("imitated", "choices"), [((), {1, 2}), (("zigzag",), {2}), (("straight", "zigzag"), {1, 2})]
)
def test_the_actor_is_drawn_to_the_teachers_that_are_imitated(
    imitated, choices, config, make_parts, monkeypatch
):
    monkeypatch.setattr(Guidance, "choose", lambda self, samples, rng: int(rng.integers(3)))
    session = ActorCriticSession(config.changed(imitated=imitated), make_parts())
    acted = []
    while len(acted) < 60:
        for done in session.collector.collect(4):
            session.store(done)
            acted.append(done.decision.choice)
    assert set(acted) == {0, 1, 2}
    rows = session.replay.guided[session.replay.complete]
    # The last action waits for where it led.
    assert len(rows) >= len(acted) - 1
    assert rows.tolist() == [choice in choices for choice in acted[: len(rows)]]


def test_the_number_of_updates_follows_the_actions(config, make_parts, tmp_path):
    config = config.changed(actions=60, updates_per_action=1.5, evaluate_every=60)
    learn(config, make_parts(), tmp_path / "run")
    path = tmp_path / "run" / "checkpoints" / last_checkpoint(tmp_path / "run")
    counts = load_archive(path, "mechsearch checkpoint").meta["counts"]
    assert counts["updates"] == int(1.5 * (counts["step"] - config.algorithm.warmup))


@pytest.mark.parametrize(
    "changes",
    [
        {"teachers": ()},
        {"critic_keys": ACTOR_KEYS},
        {"noise": {"correlation": 0.8}},
    ],
)
def test_ablations_are_settings_of_the_same_loop(changes, config, make_parts, tmp_path):
    if "noise" in changes:
        changes = {"noise": replace(config.algorithm.noise, **changes["noise"])}
    config = config.changed(actions=40, evaluate_every=40, **changes)
    learn(config, make_parts(teachers=bool(config.algorithm.teachers)), tmp_path / "run")
    assert len(lines(tmp_path / "run", "validation")) == 1


def test_evaluation_is_without_noise_and_teachers(whole, score):
    run, scores, _ = whole
    assert score(load_policy(run)) == scores


def test_teachers_are_handed_their_own_keys_and_chosen_while_the_actor_is_bad(whole):
    records = lines(whole[0], "episode")
    assert np.mean([r["chosen_straight"] + r["chosen_zigzag"] for r in records]) > 0.3


def test_a_directory_with_a_run_is_not_overwritten(config, make_parts, tmp_path):
    learn(config.changed(actions=20), make_parts(), tmp_path)
    before = (tmp_path / "metrics.jsonl").read_bytes()
    with pytest.raises(MechSearchError, match="holds a run already"):
        learn(config, make_parts(), tmp_path)
    with pytest.raises(MechSearchError, match="seed was 0 and is 3"):
        learn(config.changed(seed=3), make_parts(), tmp_path, resume=True)
    assert (tmp_path / "metrics.jsonl").read_bytes() == before


def test_an_environment_without_privileged_keys_is_refused(config, make_parts, reach_env):
    env = reach_env()
    del (space := dict(env.observation_space.spaces))["target_offset"]
    env.observation_space = type(env.observation_space)(space)
    with pytest.raises(MechSearchError, match=r"target_offset.*privileged"):
        ActorCriticSession(config, make_parts(env))


def test_a_damaged_checkpoint_is_named(config, make_parts, tmp_path):
    learn(config.changed(actions=60), make_parts(), tmp_path)
    path = tmp_path / "checkpoints" / last_checkpoint(tmp_path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(bytes(content))
    with pytest.raises(MechSearchError, match=path.name):
        learn(config.changed(actions=200), make_parts(), tmp_path, resume=True)


def test_guided_learning_reaches_the_target(config, make_parts, tmp_path, score):
    class Still:
        keys = ("ee_position",)

        def reset(self, rng):
            pass

        def act(self, obs):
            return np.zeros(3, np.float32)

    config = config.changed(
        actions=300, evaluate_every=300, updates_per_action=1.0, checkpoint_every=1000
    )
    scores = learn(config, make_parts(), tmp_path)
    still = score(Still())
    assert scores["reward"] > 0.6 * still["reward"]
    assert scores["uncovered_rate"] > still["uncovered_rate"] + 0.2


def test_progress_tells_every_action_and_the_last_scores(whole):
    told = whole[2]
    assert list(dict.fromkeys(done for _, done, _ in told)) == list(range(1, 121))
    assert told[0][0] == "method"
    assert told[-1][0].startswith("method, reward -")
