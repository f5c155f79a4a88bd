from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from torch.nn import functional

from mechsearch.actor_critic.networks import Actor, Centroid, Critic, NetworkConfig, Scale
from mechsearch.types import ACTOR_KEYS, MechSearchError

SHAPES = {"depth": (1, 16, 16), "position_image": (3, 16, 16), "ee_position": (3,)}
LOW = {"ee_position": (3,), "target_offset": (3,), "clutter_offsets": (4, 3)}
EXACT = NetworkConfig()


def observations(shapes, batch, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return {key: torch.rand(batch, *shape, generator=generator) for key, shape in shapes.items()}


def test_actions_are_in_the_unit_box_and_small_at_first():
    action = Actor(SHAPES, EXACT)(observations(SHAPES, 5))
    assert action.shape == (5, 3)
    assert action.abs().max() < 0.2


def test_the_action_is_the_tanh_of_what_the_penalty_sees():
    actor, obs = Actor(SHAPES, EXACT), observations(SHAPES, 2)
    torch.testing.assert_close(actor(obs), torch.tanh(actor.raw(obs)))
    assert actor.excess(torch.tensor([[3.0, 0.0, 0.0]])).item() == pytest.approx(3.0)


def test_an_action_as_a_direction_has_full_length_whatever_the_output_is():
    actor = Actor(SHAPES, NetworkConfig(directions=True))
    torch.testing.assert_close(actor(observations(SHAPES, 5)).norm(dim=1), torch.ones(5))
    raw = torch.tensor([[3.0, 0.0, 4.0], [0.03, 0.0, 0.04]])
    torch.testing.assert_close(actor.squash(raw), torch.tensor([[0.6, 0.0, 0.8]]).expand(2, 3))
    assert actor.excess(raw).item() == pytest.approx((4.0**2 + 0.95**2) / 2)
    assert torch.isfinite(actor.squash(torch.zeros(1, 3))).all()


def test_a_direction_with_a_length_is_from_a_fifth_to_all_of_a_step():
    actor = Actor(SHAPES, NetworkConfig(directions=True, lengths=True))
    # The length begins near 1: sigmoid(2) is 0.88.
    lengths = actor(observations(SHAPES, 5)).norm(dim=1)
    torch.testing.assert_close(lengths, torch.full((5,), 0.2 + 0.8 * 0.8808), atol=0.02, rtol=0)
    raw = torch.tensor([[3.0, 0.0, 4.0, -50.0], [3.0, 0.0, 4.0, 50.0], [3.0, 0.0, 4.0, -0.5]])
    along = torch.tensor([[0.6, 0.0, 0.8]])
    torch.testing.assert_close(actor.squash(raw), torch.tensor([[0.2], [1.0], [0.6]]) * along)
    assert actor.excess(raw).item() == pytest.approx(4.0**2)
    with pytest.raises(MechSearchError, match="expected directions"):
        NetworkConfig(lengths=True)


def test_the_centroid_is_the_mean_offset_of_what_is_seen_of_the_target():
    image = torch.zeros(2, 3, 8, 8)
    image[0, :, 2, 3] = torch.tensor([0.1, -0.2, -0.3])
    image[0, :, 2, 4] = torch.tensor([0.2, 0.0, -0.1])
    expected = torch.tensor([[0.15, -0.1, -0.2, (2 / 64) ** 0.5], [0.0, 0.0, 0.0, 0.0]])
    torch.testing.assert_close(Centroid()(image), expected)


def test_a_centroid_is_one_more_head_where_there_is_a_position_image():
    without = NetworkConfig()
    with_it = replace(without, centroid=True)
    assert Actor(SHAPES, with_it).encoder.width == Actor(SHAPES, without).encoder.width + 32
    assert Critic(LOW, with_it, 0.0).encoder.width == Critic(LOW, without, 0.0).encoder.width


def test_the_paper_image_size_gives_two_thousand_features_a_tower():
    shapes = {"depth": (1, 64, 64), "position_image": (3, 64, 64), "ee_position": (3,)}
    assert Actor(shapes, EXACT).encoder.width == 2 * 8 * 8 * 32 + 32


def test_every_observation_key_moves_the_action():
    torch.manual_seed(0)
    actor, obs = Actor(SHAPES, EXACT), observations(SHAPES, 1)
    for key in ACTOR_KEYS:
        changed = {**obs, key: obs[key] + 0.5}
        assert not torch.equal(actor(obs), actor(changed)), key


def test_colour_and_label_replace_the_position_image_by_keys_alone():
    shapes = {"depth": (1, 16, 16), "rgb": (3, 16, 16), "target_label": (7,), "ee_position": (3,)}
    obs = observations(shapes, 2)
    obs["rgb"] = torch.randint(256, (2, 3, 16, 16)).to(torch.uint8)
    assert Actor(shapes, EXACT)(obs).shape == (2, 3)


def test_height_above_the_table_is_scaled_inside_the_network():
    depth = torch.tensor([1.0, 0.9, 0.8], dtype=torch.float16)
    scaled = Actor(SHAPES, EXACT).encoder.heads["depth"][0](depth)
    torch.testing.assert_close(scaled, torch.tensor([0.0, 1.0, 2.0]), atol=0.01, rtol=0)
    torch.testing.assert_close(Scale(0.5, 4.0)(torch.tensor([1.0])), torch.tensor([2.0]))


def test_scales_travel_with_the_weights():
    assert any(name.endswith("gain") for name in Actor(SHAPES, EXACT).state_dict())


def test_a_dropout_sample_equals_the_masked_network_written_out():
    torch.manual_seed(0)
    critic = Critic(LOW, NetworkConfig(layer_norm=False), dropout=0.2)
    obs, action = observations(LOW, 3), torch.rand(3, 3)
    masks = critic.draw_masks(5, 3, torch.Generator().manual_seed(1))
    first, second = critic.trunk.layers
    for k in range(5):
        x = torch.cat([critic.encoder(obs), action], 1)
        x = torch.relu(functional.linear(x, first.weight, first.bias)) * masks[0][k]
        x = torch.relu(functional.linear(x, second.weight, second.bias)) * masks[1][k]
        expected = functional.linear(x, critic.output.weight, critic.output.bias)[:, 0]
        torch.testing.assert_close(critic(obs, action, masks)[k], expected)


def test_dropout_samples_have_the_mean_and_variance_of_all_masks_there_are():
    torch.manual_seed(0)
    critic = Critic(LOW, NetworkConfig(hidden=(4, 3), output_bound=1.0), dropout=0.5)
    obs, action = observations(LOW, 1), torch.rand(1, 3)
    patterns = torch.tensor(list(product((0.0, 2.0), repeat=7)))
    every = critic(obs, action, [patterns[:, None, :4], patterns[:, None, 4:]]).double()
    masks = critic.draw_masks(20_000, 1, torch.Generator().manual_seed(0))
    drawn = critic(obs, action, masks).double()
    assert every.std() > 0.1
    assert drawn.mean().item() == pytest.approx(every.mean().item(), abs=0.03 * every.std().item())
    assert drawn.var().item() == pytest.approx(every.var(correction=0).item(), rel=0.05)


def test_masks_keep_the_asked_share_and_the_mean():
    critic = Critic(LOW, EXACT, dropout=0.25)
    mask = critic.draw_masks(50, 64, torch.Generator().manual_seed(0))[0]
    assert (mask > 0).float().mean() == pytest.approx(0.75, abs=0.002)
    assert mask.mean() == pytest.approx(1.0, abs=0.003)
    assert np.corrcoef(mask[0, 0], mask[0, 1])[0, 1] == pytest.approx(0, abs=0.25)


def test_every_eighth_unit_is_kept_as_often_as_the_others():
    critic = Critic(LOW, EXACT, dropout=0.5)
    mask = critic.draw_masks(100, 64, torch.Generator().manual_seed(0))[0]
    shares = (mask > 0).float().mean((0, 1)).reshape(-1, 8).mean(0)
    torch.testing.assert_close(shares, torch.full((8,), 0.5), atol=0.01, rtol=0)


def test_the_symmetric_critic_reads_images_by_keys_alone():
    critic = Critic(SHAPES, EXACT, dropout=0.0)
    assert critic(observations(SHAPES, 2), torch.zeros(2, 3)).shape == (2,)


@pytest.mark.parametrize("wrong", [{"kernels": (3, 3)}, {"hidden": ()}, {"filters": 0}])
def test_contradictory_sizes_are_refused(wrong):
    with pytest.raises(MechSearchError):
        NetworkConfig(**wrong)


def test_images_too_small_for_the_towers_are_refused():
    with pytest.raises(MechSearchError, match="too small"):
        Actor({"depth": (1, 2, 2)}, EXACT)


def test_a_dropout_of_everything_is_refused():
    with pytest.raises(MechSearchError, match="share"):
        Critic(LOW, EXACT, dropout=1.0)
