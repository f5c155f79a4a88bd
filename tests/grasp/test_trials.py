from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.grasp.learning.grasp_folder import MANIFEST_FILE, OUTCOMES
from mechsearch.grasp.learning.labelling import (
    TrialConfig,
    Trials,
    label_trials,
    load_grasps,
    load_trials,
)
from mechsearch.grasp.learning.metrics import judge
from mechsearch.grasp.learning.states import STATE_KINDS, states_of
from mechsearch.grasp.learning.training import (
    NETWORK_FILE,
    GraspTrainConfig,
    predict_trials,
    train_quality_network,
)
from mechsearch.grasp.network import ready
from mechsearch.grasp.quality_network import (
    QualityNetwork,
    load_quality_network,
    save_quality_network,
)
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.objects.catalog import load_object_set
from mechsearch.sim.world import drift
from mechsearch.types import MechSearchError, Outcome

CONFIG = TrialConfig(gripper="jaws-56", per_object=2, proposals=30, shard=2)


@pytest.fixture(scope="module")
def heap_set(tmp_path_factory):
    path = tmp_path_factory.mktemp("trials") / "heaps.parquet"
    return generate(GenerateConfig(heaps=6, counts=(4,), seed=5), path)


@pytest.fixture(scope="module")
def tried(heap_set, tmp_path_factory):
    return label_trials(heap_set, "household", CONFIG, tmp_path_factory.mktemp("first")).path


@pytest.fixture(scope="module")
def untaught(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("untaught") / "network.safetensors"
    save_quality_network(path, ready(QualityNetwork("jaws-56")), {})
    return path


def synthetic(count, seed=0):
    """Bars of every direction; a grasp succeeds, mostly, if it closes across its bar."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.arange(32) - 15.5, np.arange(64) - 31.5, indexing="ij")
    turn = rng.uniform(0, np.pi, count)[:, None, None]
    bar = np.abs(np.cos(turn) * u + np.sin(turn) * v) < 7
    won = (np.abs(np.cos(turn[:, 0, 0])) > 0.85) & (rng.random((2, count)) > 0.05)
    outcome = np.where(won, OUTCOMES.index(Outcome.SUCCESS), OUTCOMES.index(Outcome.MISSED))
    return Trials(
        np.where(bar, 0.01, -0.03).astype(np.float16), bar, np.zeros((count, 6), np.float32),
        np.zeros((count, 7)), *outcome.astype(np.uint8), np.full(count, np.nan, np.float32),
        np.zeros(count, np.uint8), np.arange(count) // 20, np.full(count, "bar"),
    )  # fmt: skip


def test_every_kind_of_state_lies_still(heap_set):
    heap = heap_set.train[0]
    models = [load_object_set("household").models[name] for name in heap.objects]
    states = list(states_of(models, heap.poses, np.random.default_rng(0), 1, 2, range(4)))
    assert {STATE_KINDS[state.kind] for state in states} == set(STATE_KINDS)
    np.testing.assert_array_equal(states[0].poses, heap.poses)
    for state in states[1:]:
        there = [models[i] for i in state.present]
        assert drift(there, state.poses[state.present]) < 0.01
        gone = np.setdiff1d(np.arange(len(models)), state.present)
        assert (state.poses[gone, 0] > 5).all()
        if STATE_KINDS[state.kind] == "alone":
            assert len(there) == 1
    pushed = [s.poses for s in states if STATE_KINDS[s.kind] == "pushed"]
    assert all(np.abs(poses - heap.poses)[:, :3].max() > 0.005 for poses in pushed)


def test_trials_tell_what_was_seen_done_and_what_came_of_it(heap_set, tried):
    trials = load_trials(tried)
    assert trials.relative.shape[1:] == (32, 64)
    assert set(trials.heap.tolist()) == {heap.seed for heap in heap_set.train}
    assert {STATE_KINDS[kind] for kind in trials.state} == set(STATE_KINDS)
    assert set(trials.success) <= {0.0, 0.5, 1.0}
    assert 0 < trials.success.mean() < 1
    assert np.isnan(trials.quality).all()
    assert sum(trials.counts.values()) == 2 * len(trials)
    with pytest.raises(MechSearchError, match="holds grasps with"):
        load_grasps(tried)


def test_trials_do_not_depend_on_workers_or_interruption(heap_set, tried, tmp_path):
    class CutOffError(Exception):
        pass

    def cut_off(label, done, total):
        if done == 3:
            raise CutOffError

    with pytest.raises(CutOffError):
        label_trials(heap_set, "household", CONFIG, tmp_path, progress=cut_off)
    assert (tmp_path / "grasps-00000.npz").exists()
    label_trials(heap_set, "household", CONFIG, tmp_path, workers=2)
    assert (tmp_path / MANIFEST_FILE).read_text() == (tried / MANIFEST_FILE).read_text()


def test_a_network_picks_a_share_of_the_grasps_in_the_same_states(
    heap_set, tried, untaught, tmp_path
):
    config = replace(CONFIG, limit=2)
    rated = load_trials(label_trials(heap_set, "household", config, tmp_path, untaught).path)
    picked = ~np.isnan(rated.quality)
    assert 0.3 < picked.mean() < 0.7
    first = load_trials(tried)
    assert set(map(tuple, rated.pose[~picked])) <= set(map(tuple, first.pose))
    with pytest.raises(MechSearchError, match="grasps made from another network"):
        label_trials(heap_set, "household", config, tmp_path)
    with pytest.raises(MechSearchError, match="expected 'jaws-85'"):
        label_trials(heap_set, "household", replace(config, gripper="jaws-85"), tmp_path, untaught)


def test_what_cannot_be_tried_is_refused():
    for wrong in ({"split": "all"}, {"per_object": 0}, {"best": 1.5}, {"gripper": "tongs"},
                  {"per_object": 200}):  # fmt: skip
        with pytest.raises(MechSearchError, match=r"expected|choose"):
            TrialConfig(**wrong)


def test_a_network_learns_from_soft_labels_which_way_to_close(tmp_path):
    config = GraspTrainConfig(epochs=4, batch=32, seed=1)
    history = train_quality_network("jaws-56", synthetic(600), config, tmp_path)
    assert history[-1]["loss"] < history[0]["loss"]
    fresh = synthetic(200, seed=7)
    network = load_quality_network("jaws-56", tmp_path / NETWORK_FILE)
    verdict = judge(predict_trials(network, fresh), fresh.won[:, 0])
    assert verdict.auc > 0.9


def test_grasps_whose_physics_failed_teach_nothing(tmp_path):
    trials, config = synthetic(100), GraspTrainConfig(epochs=1, validation=0.3)
    clean = train_quality_network("jaws-56", trials, config, tmp_path / "clean")
    failed = synthetic(40, seed=3)
    failed.planned[:] = OUTCOMES.index(Outcome.FAILURE)
    both = Trials.concatenated([trials, failed.where(np.arange(40))])
    assert train_quality_network("jaws-56", both, config, tmp_path / "both") == clean
