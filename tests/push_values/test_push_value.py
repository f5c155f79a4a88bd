from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.push_values.value import (
    Continuation,
    PushOutcome,
    PushSamples,
    PushValue,
    PushValueConfig,
    fit_pushes,
    targets,
)
from mechsearch.pushes.push import NUMBERS, PATCH, PushViews
from mechsearch.types import MechSearchError


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads cost more than networks this small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


SMALL = PushValueConfig(filters=4, hidden=(32, 16), batch=32, epochs=25, dropout=0.0, rate=1e-2)


def samples(count, seed=0, straight=1.0):
    """Pushes with nothing to see, but one number decides what comes of them."""
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=(count, NUMBERS)).astype(np.float32)
    numbers[:, 8] = straight
    views = PushViews(
        np.zeros((count, *PATCH), np.float16), numbers, np.full(count, 10, np.float32)
    )
    good = numbers[:, 1] > 0
    outcomes = [PushOutcome(4.0 if g else -4.0, 10, bool(g), 0.0 if g else 0.8, 0.0) for g in good]
    return PushSamples.of(views, outcomes), good


def test_targets_are_reward_less_moved_clutter_success_occlusion_and_surplus_actions():
    views = PushViews(
        np.zeros((1, *PATCH), np.float16), np.zeros((1, NUMBERS), np.float32),
        np.array([8], np.float32),
    )  # fmt: skip
    found = targets(
        PushSamples.of(views, [PushOutcome(2.5, 13, True, 0.1, 0.05)]),
        PushValueConfig(gentleness=30),
    )
    np.testing.assert_allclose(found, [[(2.5 - 30 * 0.05) / 5, 1.0, 0.1, (13 - 8) / 5]], rtol=1e-6)


def test_a_push_is_worth_its_reward_its_time_and_what_follows_if_the_target_stays_covered():
    network = PushValue(SMALL)

    def says(*_):
        # 3 of reward, uncovered with probability 1/4, occlusion 0.5, 2 actions more than planned.
        return torch.tensor([[3 / 5, -np.log(3), 0.5, 2 / 5]], dtype=torch.float32)

    network.forward = says
    nothing = torch.zeros(1)
    value = network.value(nothing, nothing, torch.tensor([8.0]), Continuation(-6.0, 4.0), 0.5)
    assert value.item() == pytest.approx(3 - 0.5 * 10 + 0.75 * (-6 - 4 * 0.5))


def test_what_decides_is_learnt_and_holds_for_new_pushes():
    torch.manual_seed(0)
    network = PushValue(SMALL)
    fit_pushes(network, samples(600)[0], seed=0)
    fresh, good = samples(200, seed=1)
    with torch.inference_mode():
        value = network.value(
            fresh.patches, fresh.numbers, fresh.planned, Continuation(), 0.5
        ).numpy()
    assert np.mean((value > value.mean()) == good) > 0.9
    assert value[good].mean() == pytest.approx(4 - 5, abs=1.0)
    assert value[~good].mean() == pytest.approx(-4 - 5 - 6 - 6 * 0.8, abs=1.5)


def test_a_picture_that_decides_is_read():
    data, good = samples(600)
    data.numbers[:] = 0
    data.numbers[:, 8] = 1
    data.patches[torch.from_numpy(good), 0, 8:24, 20:28] = 1.0
    torch.manual_seed(0)
    network = PushValue(SMALL)
    fit_pushes(network, data, seed=0)
    with torch.inference_mode():
        value = network.value(data.patches, data.numbers, data.planned, Continuation(), 0.5).numpy()
    assert np.mean((value > value.mean()) == good) > 0.95


def test_the_same_seed_fits_the_same_bits_and_another_others():
    weights = []
    for seed in (3, 3, 4):
        torch.manual_seed(0)
        network = PushValue(replace(SMALL, epochs=2, dropout=0.3))
        fit_pushes(network, samples(64)[0], seed)
        weights.append(torch.cat([p.flatten() for p in network.parameters()]))
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_left_and_right_of_straight_pushes_are_judged_alike_after_a_fit():
    """Only pushes with the obstacle on the left were seen."""
    data, _ = samples(400)
    data.numbers[:] = 0
    data.numbers[:, 8] = 1
    bad = torch.arange(400) % 2 == 0
    data.patches[bad, 0, 20:30, 8:24] = 1.0
    data.outcomes[:, 0] = torch.where(bad, -5.0, 5.0)
    torch.manual_seed(0)
    network = PushValue(SMALL)
    fit_pushes(network, data, seed=0)
    left, right = data.patches[:1], data.patches[:1].flip(-2)
    with torch.inference_mode():
        judged = [
            network.value(p, data.numbers[:1], data.planned[:1], Continuation(), 0.5)
            for p in (left, right)
        ]
        clear = network.value(0 * left, data.numbers[:1], data.planned[:1], Continuation(), 0.5)
    assert judged[1].item() == pytest.approx(judged[0].item(), abs=2.0)
    assert clear.item() > judged[1].item() + 4


def test_samples_of_several_episodes_join_in_order():
    first, second = samples(3, 0)[0], samples(2, 1)[0]
    joined = PushSamples.joined([first, second])
    assert len(joined) == 5
    assert torch.equal(joined.numbers[3:], second.numbers)
    assert torch.equal(joined.outcomes[:3], first.outcomes)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"dropout": 1.0}, "dropout is 1.0"), ({"batch": 0}, "batch is 0"), ({"rate": 0.0}, "rate")],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(MechSearchError, match=message):
        PushValueConfig(**wrong)
