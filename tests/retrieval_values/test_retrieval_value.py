"""What options will come to, learnt from what others came to."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.retrieval_values.value import (
    OptionSamples,
    RetrievalValue,
    RetrievalValueConfig,
    fit_options,
    option_loss,
)
from mechsearch.retrieval_values.view import OPTION_NUMBERS, OPTION_PATCH, OptionViews
from mechsearch.types import MechSearchError


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads cost more than networks this small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


SMALL = RetrievalValueConfig(
    filters=4, hidden=(32, 16), batch=32, epochs=25, dropout=0.0, rate=1e-2
)


def decisions(count, seed=0, options=4):
    """Options of decisions that are hopeful or not; a number tells the better ones of each."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(count):
        numbers = rng.normal(0, 0.3, (options, OPTION_NUMBERS)).astype(np.float32)
        hope = rng.uniform(0.1, 0.9)
        chances = np.clip(hope + 0.2 * np.sign(numbers[:, 6]), 0, 1)
        clutter = 0.02 * (numbers[:, 7] > 0)
        views = OptionViews(np.zeros((options, *OPTION_PATCH), np.float16), numbers)
        parts.append(OptionSamples.of(views, chances.tolist(), clutter.tolist()))
    return OptionSamples.joined(parts)


def fitted(samples, config=SMALL, seed=0):
    torch.manual_seed(0)
    network = RetrievalValue(config)
    fit_options(network, samples, seed)
    return network


def test_the_better_option_of_a_decision_is_learnt_and_holds_for_new_ones():
    network, fresh = fitted(decisions(150)), decisions(60, seed=1)
    found = network.predict(fresh.patches, fresh.numbers)
    chosen = found.chance.reshape(60, 4).argmax(dim=1)
    came_to = fresh.chance.reshape(60, 4)
    best = came_to.gather(1, chosen[:, None])[:, 0] >= came_to.max(dim=1).values - 1e-6
    assert best.double().mean() > 0.9
    moved = fresh.clutter > 0
    assert found.clutter_moved[moved].mean() > 0.012 > 0.008 > found.clutter_moved[~moved].mean()


def test_a_picture_that_decides_is_read_and_left_and_right_are_alike():
    samples = decisions(150)
    samples.numbers[:] = 0
    bad = torch.arange(len(samples)) % 2 == 0
    # Whatever lies on the left is in the way; nothing was seen on the right.
    samples.patches[bad, 0, 24:34, 12:28] = 1.0
    samples.chance[:] = torch.where(bad, 0.1, 0.9)
    network = fitted(samples)
    left = samples.patches[:1]
    patches = torch.cat([left, left.flip(-2), 0 * left])
    judged = network.predict(patches, samples.numbers[:3]).chance
    assert judged[0] < 0.3
    assert judged[1] < 0.3
    assert judged[2] > 0.7


def test_the_loss_wants_options_of_one_decision_in_order_before_each_is_right():
    chance, clutter, one = torch.tensor([0.2, 0.8]), torch.zeros(2), torch.zeros(2).long()

    def loss(first, second, within, decision=one):
        out = torch.stack([torch.logit(torch.tensor([first, second])), clutter], dim=1)
        return option_loss(out, chance, clutter, decision, within).item()

    # Both 0.15 too low, but in order; or 0.15 off, towards one another.
    assert loss(0.35, 0.65, within=0.0) < loss(0.05, 0.65, within=0.0)
    assert loss(0.05, 0.65, within=4.0) < loss(0.35, 0.65, within=4.0)
    # Of two decisions there is no order.
    apart = torch.tensor([0, 1])
    assert loss(0.35, 0.65, 4.0, apart) == pytest.approx(loss(0.35, 0.65, 0.0))


def test_moved_clutter_counts_up_to_a_limit():
    out = torch.zeros(1, 2)
    chance, decision = torch.tensor([0.5]), torch.tensor([0])
    moved = [option_loss(out, chance, torch.tensor([m]), decision, 4.0) for m in (0, 0.1, 0.1, 5)]
    assert moved[0] < moved[1] == moved[2] == moved[3]


def test_what_is_predicted_is_a_chance_and_a_way():
    network = RetrievalValue(SMALL)
    network.forward = lambda *_: torch.tensor([[0.0, 2.0], [np.log(3), -1.0]])
    found = network.predict(torch.zeros(2), torch.zeros(2))
    np.testing.assert_allclose(found.chance, [0.5, 0.75], rtol=1e-6)
    np.testing.assert_allclose(found.clutter_moved, [0.04, 0.0], rtol=1e-6)


def test_the_same_seed_fits_the_same_bits_and_another_others():
    config = replace(SMALL, epochs=2, dropout=0.3)
    weights = [
        torch.cat([p.flatten() for p in fitted(decisions(20), config, seed).parameters()])
        for seed in (3, 3, 4)
    ]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_decisions_are_numbered_on_where_episodes_are_joined():
    first, second, nothing = decisions(2), decisions(1, seed=1), OptionSamples.joined([])
    joined = OptionSamples.joined([first, nothing, second])
    assert joined.decision.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert torch.equal(joined.numbers[8:], second.numbers)
    assert len(nothing) == 0
    assert nothing.patches.shape == (0, *OPTION_PATCH)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"dropout": 1.0}, "dropout is 1.0"), ({"batch": 0}, "batch is 0"), ({"rate": 0.0}, "rate")],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(MechSearchError, match=message):
        RetrievalValueConfig(**wrong)
