import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.actor_critic.replay import Replay, require_memory
from mechsearch.types import MechSearchError

GAMMA = 0.9


def frame(episode, step):
    """Identifiable data: the observation says which episode and step it is."""
    return {"depth": np.full((1, 2, 2), step, np.float16), "who": np.array([episode, step])}


def empty(capacity=1000):
    shapes = {"depth": (1, 2, 2), "who": (2,)}
    return Replay(shapes, {"depth": np.float16, "who": np.int64}, capacity)


def play(replay, episode, length, terminated):
    for step in range(length):
        last = step == length - 1
        action = np.array([episode, step, 0], np.float32)
        discount = 0.0 if last and terminated else GAMMA
        guided = (episode + step) % 3 == 0
        replay.add(frame(episode, step), action, 10 * episode + step, discount, guided)
    replay.end(frame(episode, length))


def test_a_transition_is_a_row_and_its_next_observation_the_next_row():
    replay = empty()
    play(replay, 1, 5, terminated=True)
    play(replay, 2, 3, terminated=False)
    batch = replay.sample(500, np.random.default_rng(0))
    assert len(replay) == 8
    np.testing.assert_array_equal(batch.next_obs["who"], batch.obs["who"] + [0, 1])
    np.testing.assert_array_equal(batch.obs["who"], batch.action[:, :2])
    np.testing.assert_array_equal(batch.reward, batch.obs["who"] @ [10, 1])


def test_what_teachers_did_is_taught_once_its_episode_is_over():
    replay = empty()
    play(replay, 1, 5, terminated=True)
    play(replay, 2, 3, terminated=False)
    replay.add(frame(3, 0), np.zeros(3, np.float32), 0.0, GAMMA, guided=True)
    replay.add(frame(3, 1), np.zeros(3, np.float32), 0.0, GAMMA, guided=True)
    batch = replay.sample(300, np.random.default_rng(0))
    guided = batch.obs["who"].sum(1) % 3 == 0
    np.testing.assert_array_equal(batch.taught, guided & (batch.obs["who"][:, 0] < 3))


def lesson(replay, number, rewards, whole=True):
    for step, reward in enumerate(rewards):
        replay.add(frame(number, step), np.zeros(3, np.float32), reward, GAMMA, guided=True)
    replay.end(frame(number, len(rewards)), whole)


def test_an_episode_of_one_action_is_taught_too():
    replay = empty()
    lesson(replay, 0, [-3])
    assert replay.sample(10, np.random.default_rng(0)).taught.all()


@pytest.mark.parametrize("capacity", [1000, 12])
def test_nothing_is_taught_from_the_episodes_of_lowest_return(capacity):
    shapes = {"depth": (1, 2, 2), "who": (2,)}
    replay = Replay(shapes, {"depth": np.float16, "who": np.int64}, capacity, worst=0.5)
    lesson(replay, 0, [-9, -9])
    lesson(replay, 1, [-1, -1])
    lesson(replay, 2, [-5, -5])
    lesson(replay, 3, [-2, -1])
    lesson(replay, 4, [0], whole=False)  # cut off by a failure: nobody knows how it went
    again = Replay(shapes, {"depth": np.float16, "who": np.int64}, capacity, worst=0.5)
    again.restore(replay.state())
    for kept in (replay, again):
        batch = kept.sample(300, np.random.default_rng(0))
        assert set(batch.obs["who"][batch.taught, 0]) == {1, 3}
        assert set(batch.obs["who"][~batch.taught, 0]) >= {2, 4}


def test_termination_cuts_the_bootstrap_and_truncation_does_not():
    replay = empty()
    play(replay, 1, 3, terminated=True)
    play(replay, 2, 3, terminated=False)
    batch = replay.sample(300, np.random.default_rng(0))
    ends = (batch.obs["who"] == [1, 2]).all(1)
    assert ends.any()
    np.testing.assert_allclose(batch.discount, np.where(ends, 0, GAMMA), rtol=1e-6)


def test_a_transition_waits_for_its_next_observation():
    replay = empty()
    replay.add(frame(0, 0), np.zeros(3, np.float32), 1.0, GAMMA)
    assert len(replay) == 0
    replay.add(frame(0, 1), np.zeros(3, np.float32), 1.0, GAMMA)
    assert len(replay) == 1


def test_a_failed_transition_is_left_out_and_the_one_before_it_kept():
    replay = empty()
    replay.add(frame(0, 0), np.zeros(3, np.float32), 1.0, GAMMA)
    replay.end(frame(0, 1))
    play(replay, 1, 2, terminated=True)
    seen = {tuple(who) for who in replay.sample(200, np.random.default_rng(0)).obs["who"]}
    assert seen == {(0, 0), (1, 0), (1, 1)}


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=1, max_size=12),
    st.integers(2, 20),
)
def test_transitions_match_a_replay_written_out(episodes, capacity):
    replay, written = empty(capacity), {}
    for number, (length, terminated) in enumerate(episodes):
        play(replay, number, length, terminated)
        written[number] = (length, terminated)
    if not len(replay):
        return
    batch = replay.sample(64, np.random.default_rng(0))
    for i, (episode, step) in enumerate(batch.obs["who"]):
        length, terminated = written[episode]
        cut = terminated and step + 1 == length
        assert batch.reward[i] == 10 * episode + step
        assert batch.discount[i] == pytest.approx(0 if cut else GAMMA)
        assert tuple(batch.next_obs["who"][i]) == (episode, step + 1)


def test_a_full_ring_forgets_the_oldest():
    replay = empty(capacity=8)
    for episode in range(5):
        play(replay, episode, 3, terminated=True)
    seen = set(replay.sample(300, np.random.default_rng(0)).obs["who"][:, 0])
    assert seen == {3, 4}


@pytest.mark.parametrize("episodes", [1, 5])
def test_state_restores_exactly(episodes):
    replay, again = empty(capacity=9), empty(capacity=9)
    for episode in range(episodes):
        play(replay, episode, 3, terminated=True)
    again.restore({key: value.copy() for key, value in replay.state().items()})
    for stored in (replay, again):
        play(stored, 9, 2, terminated=False)
    a, b = (stored.sample(50, np.random.default_rng(3)) for stored in (replay, again))
    np.testing.assert_array_equal(a.obs["who"], b.obs["who"])
    np.testing.assert_array_equal(a.reward, b.reward)


def test_a_short_run_stores_only_used_rows():
    replay = empty()
    play(replay, 0, 3, terminated=True)
    assert len(replay.state()["action"]) == 4


def test_after_an_episode_nothing_waits_for_its_next_observation():
    replay = empty()
    play(replay, 0, 3, terminated=True)
    assert replay.state()["place"].tolist() == [4, -1, 0]


def test_state_of_other_observations_is_refused():
    other = Replay({"depth": (1, 4, 4), "who": (2,)}, {"depth": "f2", "who": "i8"}, 10)
    replay = empty()
    play(replay, 0, 3, terminated=True)
    with pytest.raises(MechSearchError, match="depth"):
        other.restore(replay.state())
    with pytest.raises(MechSearchError, match="expected"):
        other.restore({"action": np.zeros(3)})


def test_an_empty_replay_and_an_endless_one_are_refused():
    with pytest.raises(MechSearchError, match="no complete transition"):
        empty().sample(1, np.random.default_rng(0))
    with pytest.raises(MechSearchError, match="GB"):
        require_memory(10**18, "a replay")
    with pytest.raises(MechSearchError, match="at least 2"):
        empty(1)
