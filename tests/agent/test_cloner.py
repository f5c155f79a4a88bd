import pytest
import torch

from mechsearch.agent.cloner import Cloner, ClonerConfig, cosine_rate, shifted
from mechsearch.agent.networks import NetworkConfig
from mechsearch.types import MechSearchError

SHAPES = {"depth": (1, 16, 16), "ee_position": (3,)}
SMALL = NetworkConfig(hidden=(32, 32), bfloat16=False)


def cloner(seed=0, **changes):
    torch.manual_seed(seed)
    return Cloner(SHAPES, SMALL, ClonerConfig(**changes), seed)


def batch(size=64, seed=0):
    """The expert moves towards the middle of the workspace: that turns as the scene does."""
    generator = torch.Generator().manual_seed(seed)
    position = torch.rand(size, 3, generator=generator) * 0.5 - 0.25
    depth = torch.ones(size, 1, 16, 16)
    return {"depth": depth, "ee_position": position}, -4 * position


@pytest.mark.parametrize("loss", ["mse", "l1", "huber", "direction"])
def test_the_average_learns_the_experts_actions(loss):
    learner = cloner(loss=loss, average=0.9)
    for i in range(150):
        learner.update(*batch(seed=i))
    error = learner.error(*batch(seed=9999))
    assert error["angle_error"] < 0.3


def test_the_direction_loss_is_one_at_a_right_angle_and_charges_lengths_apart():
    learner = cloner(loss="direction")
    ahead, left = torch.tensor([[1.0, 0, 0]]), torch.tensor([[0, 1.0, 0]])
    assert learner._loss(ahead, left).item() == pytest.approx(1.0)
    assert learner._loss(0.5 * ahead, ahead).item() == pytest.approx(0.5 * 0.5**2)
    assert learner._loss(ahead, ahead).item() == pytest.approx(0.0, abs=1e-6)


def test_the_direction_loss_prefers_either_of_two_ways_to_hesitating_between_them():
    ways = torch.tensor([[0.8, 0.6, 0], [0.8, -0.6, 0]])
    mean, way = ways.mean(0).expand(2, 3), ways[:1].expand(2, 3)
    full = mean / mean.norm(dim=1, keepdim=True)
    direction, squares = cloner(loss="direction"), cloner(loss="mse")
    assert direction._loss(full, ways) < direction._loss(mean, ways)
    assert squares._loss(full, ways) > squares._loss(mean, ways)
    assert squares._loss(way, ways) > squares._loss(mean, ways)


def test_augmentation_turns_action_and_observation_alike():
    learner = cloner(symmetry=True)
    obs, action = batch()
    turned, turned_action = learner._augmented({**obs, "action": action})
    torch.testing.assert_close(turned_action, -4 * turned["ee_position"])
    assert not torch.equal(turned_action, action)


def test_no_augmentation_leaves_samples_alone():
    learner = cloner(symmetry=False)
    obs, action = batch()
    same, same_action = learner._augmented({**obs, "action": action})
    assert torch.equal(same["ee_position"], obs["ee_position"])
    assert torch.equal(same_action, action)


def test_a_shift_moves_images_by_whole_pixels_and_repeats_the_border():
    image = torch.arange(9.0).reshape(1, 1, 3, 3)
    moved = shifted(image, 1, 0)[0, 0]
    assert moved.tolist() == [[0, 1, 2], [0, 1, 2], [3, 4, 5]]
    assert shifted(image, 0, -1)[0, 0, 0].tolist() == [1, 2, 2]
    vector = torch.rand(2, 3)
    assert shifted(vector, 1, 1) is vector


def test_the_rate_falls_from_one_to_its_floor():
    assert cosine_rate(0.0) == pytest.approx(1.0)
    assert cosine_rate(1.0) == pytest.approx(0.02)
    assert cosine_rate(0.5) == pytest.approx(0.51)


def test_a_restored_cloner_goes_on_exactly():
    whole, halves = cloner(), cloner()
    for i in range(3):
        whole.update(*batch(seed=i))
        halves.update(*batch(seed=i))
    again = cloner(seed=8)
    again.restore({key: value.clone() for key, value in halves.state().items()})
    for i in range(3, 6):
        assert whole.update(*batch(seed=i)) == again.update(*batch(seed=i))
    for key, value in whole.state().items():
        assert torch.equal(value, again.state()[key]), key


def test_an_unknown_loss_is_refused():
    with pytest.raises(MechSearchError, match="mse, l1, huber, direction"):
        ClonerConfig(loss="l2")
