"""What the learner aims at, against references written out plainly."""

from copy import deepcopy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.actor_critic.behaviour import Behaviour
from mechsearch.actor_critic.learner import Learner, LearnerConfig, alpha_divergence
from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.actor_critic.replay import Replay

ACTOR = {"ee_position": (3,)}
CRITIC = {"ee_position": (3,), "target_offset": (3,)}
GAMMA, SCALE = 0.9, 0.1

seeds = st.integers(0, 2**32 - 1)
episodes = st.lists(st.tuples(st.integers(1, 5), st.booleans()), min_size=1, max_size=6)


class Everything:
    """A generator that draws each row once."""

    def choice(self, rows, size):
        return rows


@pytest.fixture(scope="module")
def agent():
    """A learner whose targets are far from zero and from its networks."""
    torch.manual_seed(0)
    network = NetworkConfig(hidden=(16, 16))
    config = LearnerConfig(gamma=GAMMA, network=network, symmetry=False)
    learner = Learner(ACTOR, CRITIC, config, 0)
    for part in (learner.actor, learner.critic, learner.actor_target, learner.critic_target):
        torch.nn.init.normal_(part.output.weight)
    return learner


def observation(rng):
    return {key: rng.normal(size=3).astype(np.float32) for key in CRITIC}


def played(lengths, seed, capacity=1000):
    """Return a replay of episodes, and the same as plain lists."""
    rng = np.random.default_rng(seed)
    replay, rows = Replay(CRITIC, dict.fromkeys(CRITIC, np.float32), capacity), []
    for number, (length, terminated) in enumerate(lengths):
        for step in range(length):
            obs, action = observation(rng), rng.uniform(-1, 1, 3).astype(np.float32)
            reward, last = float(rng.normal()), step == length - 1
            discount = 0.0 if last and terminated else GAMMA
            replay.add(obs, action, reward, discount)
            rows.append((number, obs, action, reward, discount))
        obs = observation(rng)
        replay.end(obs)
        rows.append((number, obs, None, 0.0, 0.0))
    return replay, rows


@settings(deadline=None, max_examples=60)
@given(episodes, seeds, st.integers(2, 20))
def test_a_ring_holds_the_last_rows_of_a_plain_list(lengths, seed, capacity):
    replay, rows = played(lengths, seed, capacity)
    kept = rows[-capacity:]
    expected = [(now, after) for now, after in pairwise(kept) if now[2] is not None]
    assert len(replay) == len(expected)
    if not expected:
        return
    batch = replay.sample(0, Everything())
    order = {row[1]["ee_position"].tobytes(): i for i, (row, _) in enumerate(expected)}
    places = [order[obs.tobytes()] for obs in batch.obs["ee_position"]]
    assert sorted(places) == list(range(len(expected)))
    for i, place in enumerate(places):
        (_, obs, action, reward, discount), (_, later, _, _, _) = expected[place]
        for key in CRITIC:
            np.testing.assert_array_equal(batch.obs[key][i], obs[key])
            np.testing.assert_array_equal(batch.next_obs[key][i], later[key])
        np.testing.assert_array_equal(batch.action[i], action)
        assert (batch.reward[i], batch.discount[i]) == (np.float32(reward), np.float32(discount))


@settings(deadline=None, max_examples=40)
@given(episodes, seeds)
def test_targets_bootstrap_after_truncations_and_never_after_terminations(agent, lengths, seed):
    replay, rows = played(lengths, seed)
    batch = agent._tensors(replay.sample(0, Everything()))
    found = iter(agent.bellman_target(batch).numpy())
    for start, (episode, _, action, _, _) in enumerate(rows):
        if action is None:
            continue
        expected, discount = SCALE * rows[start][3], rows[start][4]
        assert rows[start + 1][0] == episode
        if discount:
            after = {key: torch.as_tensor(value)[None] for key, value in rows[start + 1][1].items()}
            with torch.no_grad():
                expected += discount * float(agent.critic_target(after, agent.actor_target(after)))
        assert next(found) == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert next(found, None) is None


@given(seeds, st.integers(1, 12), st.integers(1, 9), st.floats(0.05, 2), st.floats(0.5, 20))
def test_the_critics_loss_is_its_formula_summed_term_by_term(seed, copies, size, alpha, tau):
    errors = np.random.default_rng(seed).normal(size=(copies, size))
    expected = 0.0
    for column in errors.T:
        evidence = sum(np.exp(-0.5 * alpha * tau * error**2) for error in column) / copies
        expected -= np.log(evidence) / alpha / size
    found = alpha_divergence(torch.as_tensor(errors), alpha, tau)
    assert found.item() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("tau", [0.01, 0.3, 1.0])
def test_each_target_moves_by_its_share_tau(agent, tau):
    moving = deepcopy(agent)
    moving.config = replace(agent.config, tau=tau, actor_tau=tau / 2)
    moving.updates = 1000
    moving.update_target()
    for name, share in (("actor", tau / 2), ("critic", tau)):
        old, new = getattr(agent, f"{name}_target"), getattr(agent, name)
        moved = getattr(moving, f"{name}_target")
        for a, b, c in zip(old.parameters(), new.parameters(), moved.parameters(), strict=True):
            torch.testing.assert_close(c, (1 - share) * a + share * b)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_symmetry_is_applied_only_where_it_is_asked_for(agent, seed):
    replay, _ = played([(4, True)], seed)
    plain = replay.sample(0, Everything())
    batch = agent._tensors(plain)
    np.testing.assert_array_equal(batch.action.numpy(), plain.action)
    for key in CRITIC:
        np.testing.assert_array_equal(batch.obs[key].numpy(), plain.obs[key])
        np.testing.assert_array_equal(batch.next_obs[key].numpy(), plain.next_obs[key])


@settings(deadline=None, max_examples=25)
@given(seeds, st.sampled_from([0.0, 1e6, np.nan, np.inf]))
def test_the_actors_bits_do_not_depend_on_what_only_the_critic_sees(agent, seed, other):
    obs = observation(np.random.default_rng(seed))
    changed = {**obs, "target_offset": np.full(3, other, np.float32)}
    for policy in (ActorPolicy(agent.actor), Behaviour(agent, 0)):
        assert policy.act(obs).tobytes() == policy.act(changed).tobytes()
    different = {**obs, "ee_position": obs["ee_position"] + 1}
    assert policy.act(obs).tobytes() != policy.act(different).tobytes()
