import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mechsearch.evaluation.episodes import load_episodes, measure, save_episodes
from mechsearch.findings.experiment import ordered, read_experiment
from mechsearch.types import MechSearchError


@pytest.fixture
def copied(sweep: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sweep, tmp_path / "copy"))


def test_a_sweep_is_read_by_condition_policy_and_seed(sweep: Path) -> None:
    experiment = read_experiment(sweep)
    assert list(experiment.conditions) == ["single", "dual"]
    single = experiment.conditions["single"]
    assert [one.seed for one in single.policies["method"]] == [0, 1, 2]
    assert single.teachers == ["teacher-spiral", "teacher-straight", "teacher-zigzag"]
    assert single.counts == [5, 10, 15]
    assert [run.seed for run in single.runs["ddpg"]] == [0, 1, 2]
    assert experiment.missing == []


def test_values_lie_by_seed_and_heap(sweep: Path) -> None:
    single = read_experiment(sweep).conditions["single"]
    (values,) = single.matrices(["method"], "reward")
    assert values.shape == (3, 30)
    recorded = load_episodes(sweep / "single" / "evaluations" / "method-seed1-8000.npz").episodes
    by_heap = {record.heap_seed: measure(record)["reward"] for record in recorded}
    np.testing.assert_array_equal(values[1], [by_heap[heap] for heap in sorted(by_heap)])


def test_policies_are_compared_on_the_heaps_that_all_ran_on(copied: Path) -> None:
    file = copied / "single" / "evaluations" / "idle.npz"
    whole = load_episodes(file)
    save_episodes(file, type(whole)(whole.header, whole.episodes[10:25]))
    single = read_experiment(copied).conditions["single"]
    method, idle = single.matrices(["method", "idle"], "reward")
    assert method.shape == (3, 15)
    assert idle.shape == (1, 15)
    np.testing.assert_array_equal(method, single.matrices(["method"], "reward")[0][:, 10:25])
    assert single.matrices(["method"], "reward", 10)[0].shape == (3, 10)


def test_of_two_lengths_of_training_the_longer_counts(copied: Path) -> None:
    file = copied / "single" / "evaluations" / "method-seed0-8000.npz"
    whole = load_episodes(file)
    shorter = dict(whole.header) | {"training_actions": 500}
    save_episodes(file.with_name("method-seed0-500.npz"), type(whole)(shorter, whole.episodes))
    scored = read_experiment(copied).conditions["single"].policies["method"]
    assert [one.actions for one in scored] == [8000, 8000, 8000]


def test_what_was_planned_and_not_scored_is_named(copied: Path) -> None:
    (copied / "dual" / "evaluations" / "ddpg-seed2-8000.npz").unlink()
    assert read_experiment(copied).missing == ["dual: ddpg-seed2"]


def test_policies_have_a_fixed_order() -> None:
    names = ["idle", "mine", "teacher-zigzag", "look-ahead", "ddpg", "method"]
    assert ordered(names) == ["method", "ddpg", "mine", "teacher-zigzag", "look-ahead", "idle"]


def test_a_damaged_file_is_refused(copied: Path) -> None:
    file = copied / "dual" / "evaluations" / "random.npz"
    file.write_bytes(file.read_bytes()[:900])
    with pytest.raises(MechSearchError, match=r"random\.npz is damaged"):
        read_experiment(copied)


@pytest.mark.parametrize(
    ("fact", "value", "message"),
    [
        ("condition", "dual", r"idle\.npz is of dual heaps; this folder is for single"),
        ("heap_set", "other", r"heap_set abc and .* has other|heap_set other and .* has abc"),
        ("split", "train", "expected the same in one condition"),
    ],
)
def test_episodes_that_belong_elsewhere_are_refused(
    copied: Path, fact: str, value: str, message: str
) -> None:
    file = copied / "single" / "evaluations" / "idle.npz"
    whole = load_episodes(file)
    save_episodes(file, type(whole)(dict(whole.header) | {fact: value}, whole.episodes))
    with pytest.raises(MechSearchError, match=message):
        read_experiment(copied)


def test_the_same_policy_twice_is_refused(copied: Path) -> None:
    file = copied / "single" / "evaluations" / "method-seed0-8000.npz"
    shutil.copy(file, file.with_name("copy.npz"))
    with pytest.raises(MechSearchError, match="both method, seed 0, after 8,000 actions"):
        read_experiment(copied)


def test_a_run_in_another_run_s_folder_is_refused(copied: Path) -> None:
    config = copied / "single" / "runs" / "ddpg-seed1" / "config.json"
    config.write_text(json.dumps({"name": "method", "seed": 1}))
    with pytest.raises(MechSearchError, match=r"ddpg-seed1 holds the run method-seed1"):
        read_experiment(copied)


def test_a_run_that_has_only_begun_is_passed_over(copied: Path) -> None:
    (copied / "single" / "runs" / "plus-seed7").mkdir()
    assert len(read_experiment(copied).conditions["single"].runs["plus"]) == 3


def test_a_sweep_without_scores_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(MechSearchError, match="no evaluation"):
        read_experiment(tmp_path)
    (tmp_path / "sweep.json").write_text("[]")
    with pytest.raises(MechSearchError, match="not the plan of a sweep"):
        read_experiment(tmp_path)


def test_no_shared_heap_is_refused(copied: Path) -> None:
    for name, part in (("idle", slice(0, 10)), ("random", slice(10, 20))):
        file = copied / "single" / "evaluations" / f"{name}.npz"
        whole = load_episodes(file)
        save_episodes(file, type(whole)(whole.header, whole.episodes[part]))
    single = read_experiment(copied).conditions["single"]
    with pytest.raises(MechSearchError, match="idle, random share no single heap"):
        single.matrices(["idle", "random"], "reward")
