import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.actor_critic.behaviour import Behaviour
from mechsearch.actor_critic.learner import (
    Learner,
    LearnerConfig,
    TensorBatch,
    alpha_divergence,
    straying,
)
from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.actor_critic.replay import Replay
from mechsearch.types import MechSearchError

ACTOR = {"ee_position": (3,)}
CRITIC = {"ee_position": (3,), "target_offset": (3,)}
SMALL = NetworkConfig(hidden=(32, 32))
DIRECTIONS = NetworkConfig(hidden=(32, 32), directions=True)
FULL = NetworkConfig()


def learner(seed=0, actor=ACTOR, **changes):
    torch.manual_seed(seed)
    settings = {"samples": 7, "batch": 32, "network": SMALL, "symmetry": False, **changes}
    return Learner(actor, CRITIC, LearnerConfig(**settings), seed)


def batch(size=16, reward=0.0, discount=0.9, taught=False):
    generator = torch.Generator().manual_seed(0)

    def rand():
        return torch.rand(size, 3, generator=generator)

    obs = {"ee_position": rand(), "target_offset": rand()}
    after = {"ee_position": rand(), "target_offset": rand()}
    full = torch.full((size,), reward), torch.full((size,), discount)
    taught = torch.full((size,), taught)
    return TensorBatch(obs, rand() * 2 - 1, *full, after, taught)


def bandit(rows=400):
    """A world of one action: the reward is highest at the action (0.5, -0.5, 0)."""
    rng = np.random.default_rng(0)
    shapes = {"ee_position": (3,), "target_offset": (3,)}
    replay = Replay(shapes, dict.fromkeys(shapes, np.float32), 2 * rows)
    for _ in range(rows):
        action = rng.uniform(-1, 1, 3).astype(np.float32)
        reward = -10 * float(np.sum((action - [0.5, -0.5, 0.0]) ** 2))
        obs = {key: np.zeros(3, np.float32) for key in shapes}
        replay.add(obs, action, reward, 0.0)
        replay.end(obs)
    return replay


def test_alpha_divergence_matches_hand_computed_numbers():
    errors = torch.tensor([[1.0], [3.0]])
    # -(1/0.5) * log((exp(-0.25 * 2 * 1) + exp(-0.25 * 2 * 9)) / 2)
    expected = -2 * math.log((math.exp(-0.5) + math.exp(-4.5)) / 2)
    assert alpha_divergence(errors, 0.5, 2.0).item() == pytest.approx(expected, rel=1e-6)


def test_a_small_alpha_is_the_mean_squared_error():
    errors = torch.randn(20, 8, generator=torch.Generator().manual_seed(0))
    squared = 0.5 * 10 * errors.square().mean()
    assert alpha_divergence(errors, 1e-5, 10.0).item() == pytest.approx(squared.item(), rel=1e-2)


def test_the_bellman_target_is_reward_plus_discounted_target_value():
    agent, data = learner(), batch(reward=-2.0, discount=0.5)
    for network in (agent.actor, agent.critic):
        torch.nn.init.normal_(network.output.weight)  # the targets must be what is asked
    q = agent.critic_target(data.next_obs, agent.actor_target(data.next_obs))
    torch.testing.assert_close(agent.bellman_target(data), -2.0 + 0.5 * q)


def test_after_a_termination_the_target_is_the_reward():
    target = learner().bellman_target(batch(reward=-3.0, discount=0.0))
    torch.testing.assert_close(target, torch.full_like(target, -3.0))


def test_targets_move_by_the_share_tau():
    agent = learner(tau=0.25, actor_tau=0.5)
    for network, target, tau in (
        (agent.critic, agent.critic_target, 0.25),
        (agent.actor, agent.actor_target, 0.5),
    ):
        before = [p.clone() for p in target.parameters()]
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter)
        agent.updates = 1000
        agent.update_target()
        for old, new, found in zip(before, network.parameters(), target.parameters(), strict=True):
            torch.testing.assert_close(found, (1 - tau) * old + tau * new)


def test_the_actor_that_is_evaluated_begins_as_the_mean_of_all_actors():
    agent = learner(actor_tau=0.1)
    bias, seen = agent.actor.output.bias.detach(), []
    for value in (3.0, 5.0, -1.0):
        bias.fill_(value)
        agent.update_target()
        seen.append(value)
        found = agent.actor_target.output.bias
        torch.testing.assert_close(found, torch.full((3,), float(np.mean(seen))))


def test_straying_is_one_less_the_mean_cosine_to_what_teachers_did():
    action = torch.tensor([[1.0, 0, 0], [1, 0, 0], [0, 0.2, 0], [0, 0, -1]])
    recorded = torch.tensor([[0.5, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]])
    everyone, some = torch.ones(4, dtype=torch.bool), torch.tensor([True, True, False, False])
    one = torch.tensor([False, False, True, False])
    assert straying(action, recorded, everyone).item() == pytest.approx((0 + 1 + 2 + 0) / 4)
    assert straying(action, recorded, some).item() == pytest.approx(0.5)
    assert straying(action, recorded, one).item() == pytest.approx(2)
    lengths = straying(action, recorded, everyone, lengths=True)
    assert lengths.item() == pytest.approx((0.25 + 1 + 2.64 + 0) / 4)
    assert straying(action, recorded, ~everyone).item() == 0


def test_teachers_that_disagree_do_not_shorten_what_is_learnt_from_them():
    # Two thirds go right, a third goes left: squared distances would teach a third of a step.
    agent = learner(imitation=100.0, network=DIRECTIONS, actor_rate=1e-2)
    data = batch(size=30, taught=True)
    left = (torch.arange(30) % 3 == 0).float()[:, None]
    data = replace(data, action=torch.tensor([[1.0, 0.0, 0.0]]) * (1 - 2 * left))
    alike = {key: torch.ones_like(value) for key, value in data.obs.items()}
    for _ in range(100):
        agent.update_actor(replace(data, obs=alike))
    action = agent.actor(alike)[0].detach()
    torch.testing.assert_close(action, torch.tensor([1.0, 0.0, 0.0]), atol=0.1, rtol=0)


def test_lengths_are_learnt_beside_directions():
    network = NetworkConfig(hidden=(32, 32), directions=True, lengths=True)
    agent = learner(imitation=100.0, network=network, actor_rate=1e-2)
    # Two thirds go right, a third left, all by 0.6 of a step: the mean of all is a third of that.
    sides = torch.tensor([0.6, 0.6, -0.6]).repeat(10)
    data = replace(batch(size=30, taught=True), action=torch.eye(3)[:1] * sides[:, None])
    alike = {key: torch.ones_like(value) for key, value in data.obs.items()}
    for _ in range(150):
        agent.update_actor(replace(data, obs=alike))
    action = agent.actor(alike)[0].detach()
    torch.testing.assert_close(action, torch.tensor([0.6, 0.0, 0.0]), atol=0.1, rtol=0)


@pytest.mark.parametrize("mirrors", [False, True])
def test_batches_are_mirrored_only_where_that_is_wanted(mirrors, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "mechsearch.actor_critic.learner.transform",
        lambda keys, symmetry: (drawn.append(symmetry), dict(keys))[1],
    )
    agent, replay = learner(symmetry=True, mirrors=mirrors), bandit(40)
    for _ in range(40):
        agent.update(replay, np.random.default_rng(0))
    assert {symmetry.mirrors for symmetry in drawn} == ({False, True} if mirrors else {False})
    assert len(set(drawn)) == (8 if mirrors else 4)


def test_what_no_teacher_did_is_not_imitated():
    data, changed = batch(), batch()
    changed = replace(changed, action=-changed.action)
    found = [learner(imitation=100.0).update_actor(d) for d in (data, changed)]
    assert found[0] == found[1]
    assert found[0]["strays"] == 0


def test_the_actor_update_leaves_the_critic_alone_and_the_critic_update_the_actor():
    agent, data = learner(), batch()
    critic, actor = agent.critic.state_dict(), agent.actor.state_dict()
    critic, actor = ({k: v.clone() for k, v in s.items()} for s in (critic, actor))
    agent.update_actor(data)
    assert all(torch.equal(v, critic[k]) for k, v in agent.critic.state_dict().items())
    actor_after = {k: v.clone() for k, v in agent.actor.state_dict().items()}
    assert not all(torch.equal(v, actor[k]) for k, v in actor_after.items())
    agent.update_critic(data)
    assert all(torch.equal(v, actor_after[k]) for k, v in agent.actor.state_dict().items())
    assert not all(torch.equal(v, critic[k]) for k, v in agent.critic.state_dict().items())


@pytest.mark.parametrize("dropout", [0.0, 0.1])
def test_the_actor_finds_the_action_of_highest_reward(dropout):
    agent, replay = learner(dropout=dropout, actor_rate=1e-3, network=FULL), bandit()
    rng = np.random.default_rng(0)
    for _ in range(250):
        metrics = agent.update(replay, rng)
    action = Behaviour(agent, 0).act({"ee_position": np.zeros(3, np.float32)})
    np.testing.assert_allclose(action, [0.5, -0.5, 0.0], atol=0.25)
    assert metrics["bellman_error"] < 3.0
    assert metrics["saturated"] == 0.0


def test_q_samples_are_in_units_of_reward_and_agree_in_the_mean():
    agent, replay = learner(samples=5, network=FULL), bandit()
    rng = np.random.default_rng(0)
    for _ in range(200):
        agent.update(replay, rng)
    obs = {key: np.zeros(3, np.float32) for key in CRITIC}
    actions = np.array([[0.5, -0.5, 0], [-0.5, 0.5, 0.5]], np.float32)
    samples = Behaviour(agent, 0).q_samples(obs, actions)
    assert samples.shape == (5, 2)
    truth = -10 * np.sum((actions - [0.5, -0.5, 0.0]) ** 2, 1)
    np.testing.assert_allclose(samples.mean(0), truth, atol=5)
    assert samples[:, 1].std() > 0


def test_an_ordinary_critic_gives_one_sample():
    agent = learner(dropout=0.0, samples=1)
    obs = {key: np.zeros(3, np.float32) for key in CRITIC}
    assert Behaviour(agent, 0).q_samples(obs, np.zeros((4, 3), np.float32)).shape == (1, 4)


def test_the_saturation_penalty_pulls_the_output_back():
    agent = learner(saturation_penalty=10.0)
    torch.nn.init.constant_(agent.actor.output.bias, 3.0)
    data = batch()
    first = agent.update_actor(data)["output"]
    for _ in range(50):
        last = agent.update_actor(data)["output"]
    assert last < first


def test_the_normalised_actor_loss_does_not_depend_on_the_scale_of_q():
    losses = []
    for factor in (1.0, 100.0):
        agent = learner(dropout=0.0, samples=1)
        torch.nn.init.constant_(agent.critic.output.bias, 1.0)
        with torch.no_grad():
            agent.critic.output.weight.mul_(factor)
            agent.critic.output.bias.mul_(factor)
        losses.append(agent.update_actor(batch())["actor_gradient"])
    assert losses[0] == pytest.approx(losses[1], rel=1e-2)


def test_a_restored_learner_goes_on_exactly():
    replay, whole, parts = bandit(), learner(), learner()
    rng_whole, rng_parts = np.random.default_rng(1), np.random.default_rng(1)
    for _ in range(3):
        whole.update(replay, rng_whole)
        parts.update(replay, rng_parts)
    again = learner(seed=5)
    again.restore({key: value.clone() for key, value in parts.state().items()})
    for _ in range(3):
        assert whole.update(replay, rng_whole) == again.update(replay, rng_parts)
    for key, value in whole.state().items():
        assert torch.equal(value, again.state()[key]), key


def test_a_learner_of_other_shapes_is_refused():
    other = learner(actor={"depth": (1, 16, 16)})
    with pytest.raises(MechSearchError, match="another network"):
        other.restore(learner().state())


def test_an_actor_that_looks_beside_the_critics_step_learns_the_same_bits():
    beside, after = learner(symmetry=True), learner(symmetry=True)
    replay, draws = bandit(), [np.random.default_rng(1) for _ in range(2)]
    with ThreadPoolExecutor(1) as thread:
        for _ in range(20):
            metrics = beside.update(replay, draws[0], thread)
            assert metrics == after.update(replay, draws[1])
    states = beside.state(), after.state()
    assert all(torch.equal(value, states[1][name]) for name, value in states[0].items())


def test_symmetric_training_turns_observation_and_action_together():
    agent, replay = learner(symmetry=True), bandit()
    data = agent._tensors(replay.sample(64, np.random.default_rng(0)))
    # The reward knows the axes, so the turned actions no longer earn what is written beside them;
    # their lengths and heights must be what they were.
    raw = replay.sample(64, np.random.default_rng(0))
    np.testing.assert_allclose(
        data.action.norm(dim=1), np.linalg.norm(raw.action, axis=1), rtol=1e-5
    )
    np.testing.assert_array_equal(data.action[:, 2], raw.action[:, 2])


@pytest.mark.parametrize(
    "wrong",
    [
        {"gamma": 1.5},
        {"tau": 0},
        {"actor_tau": 2},
        {"batch": 0},
        {"dropout": 1.0},
        {"actor_rate": -1},
        {"imitation": -1},
        {"worst": 1.0},
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(MechSearchError, match=next(iter(wrong))):
        LearnerConfig(**wrong)


def test_behaviour_stays_as_it_is_until_it_is_refreshed():
    agent, replay = learner(network=FULL), bandit()
    behaviour, obs = Behaviour(agent, 0), {"ee_position": np.zeros(3, np.float32)}
    before = behaviour.act(obs)
    rng = np.random.default_rng(0)
    for _ in range(20):
        agent.update(replay, rng)
    np.testing.assert_array_equal(behaviour.act(obs), before)
    behaviour.refresh()
    learnt = agent.actor.eval()({"ee_position": torch.zeros(1, 3)})[0].detach().numpy()
    np.testing.assert_allclose(behaviour.act(obs), learnt, atol=1e-6)
    assert not np.array_equal(learnt, before)
