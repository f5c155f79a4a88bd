import numpy as np
import pytest

from mechsearch.train.demonstrations import Demonstration, DemonstrationStore, evenly_spread
from mechsearch.train.samples import Samples
from mechsearch.types import MechSearchError

KEYS = ("depth", "ee_position")


def demonstration(number, count=3):
    samples = [
        (
            {
                "depth": np.full((1, 2, 2), number, np.float16),
                "ee_position": np.full(3, step, np.float32),
            },
            np.full(3, 0.1 * step, np.float32),
        )
        for step in range(count)
    ]
    return Demonstration.of(samples, KEYS, 24, count, -1.5)


@pytest.fixture
def store(tmp_path):
    store = DemonstrationStore(tmp_path / "demonstrations")
    store.open({"heap_set": "abc"})
    for i in range(4):
        store.write(f"{i:06d}", demonstration(i))
    return store


def test_demonstrations_come_back(store):
    found = store.read("000002")
    expected = demonstration(2)
    for key in KEYS:
        np.testing.assert_array_equal(found.obs[key], expected.obs[key])
        assert found.obs[key].dtype == expected.obs[key].dtype
    np.testing.assert_array_equal(found.action, expected.action)
    assert (found.simulated_actions, found.executed_actions) == (24, 3)
    assert found.episode_return == -1.5


def test_a_limit_is_spread_over_the_store(store):
    assert [d.obs["depth"][0, 0, 0, 0] for d in store.read_all(limit=2)] == [0, 2]
    assert len(store.read_all()) == 4
    assert evenly_spread(10, 5) == [0, 2, 4, 6, 8]
    assert evenly_spread(3, 0) == []


def test_a_store_of_other_heaps_is_refused(store):
    store.open({"heap_set": "abc"})
    with pytest.raises(MechSearchError, match="heap_set 'abc'; expected 'other'"):
        store.open({"heap_set": "other"})


def test_a_damaged_missing_or_absent_demonstration_is_named(store, tmp_path):
    path = store.path / "000001.npz"
    content = bytearray(path.read_bytes())
    content[100] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(MechSearchError, match=r"000001.npz is damaged"):
        store.read_all()
    with pytest.raises(MechSearchError, match="no demonstration at"):
        store.read("nine")
    with pytest.raises(MechSearchError, match="manifest"):
        DemonstrationStore(tmp_path / "empty").read_all()


def test_more_demonstrations_than_stored_are_refused(store):
    with pytest.raises(MechSearchError, match="holds 4 demonstrations; expected at least 9"):
        store.read_all(limit=9)


def test_actions_outside_the_box_are_refused():
    with pytest.raises(MechSearchError, match="not in"):
        Demonstration({}, np.full((2, 3), 1.5, np.float32), 1, 2, 0.0)
    with pytest.raises(MechSearchError, match="'depth' of 1"):
        Demonstration({"depth": np.zeros((1, 2))}, np.zeros((2, 3), np.float32), 1, 2, 0.0)
    with pytest.raises(MechSearchError, match="at least one action"):
        Demonstration.of([], KEYS, 0, 0, 0.0)


def test_samples_keep_observation_and_action_together():
    samples = Samples([demonstration(0), demonstration(1, count=5)], KEYS)
    samples.add([demonstration(2, count=2)])
    assert len(samples) == 10
    obs, action = samples.draw(64, np.random.default_rng(0))
    np.testing.assert_allclose(action, 0.1 * obs["ee_position"], rtol=1e-6)
    assert set(obs["depth"][:, 0, 0, 0].tolist()) == {0, 1, 2}
    assert samples.shapes == {"depth": (1, 2, 2), "ee_position": (3,)}
