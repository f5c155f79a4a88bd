import numpy as np
import pytest

from mechsearch.actor_critic.exploration import Noise, NoiseConfig
from mechsearch.types import MechSearchError


def drawn(correlation, count=4000):
    noise, rng = Noise(NoiseConfig(0.1, correlation)), np.random.default_rng(0)
    return np.array([noise.added(np.zeros(3, np.float32), rng) for _ in range(count)])


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_noise_has_the_asked_spread_and_correlation(correlation):
    x = drawn(correlation)[:, 0]
    assert x.std() == pytest.approx(0.1, abs=0.01)
    assert np.corrcoef(x[1:], x[:-1])[0, 1] == pytest.approx(correlation, abs=0.05)


def test_noise_stays_in_the_unit_box():
    noise = Noise(NoiseConfig(5.0))
    assert np.abs(noise.added(np.ones(3, np.float32), np.random.default_rng(0))).max() <= 1


def test_a_new_episode_forgets_the_last_noise():
    noise = Noise(NoiseConfig(0.1, 0.99))
    noise.added(np.zeros(3, np.float32), np.random.default_rng(0))
    noise.reset()
    fresh = Noise(NoiseConfig(0.1, 0.99))
    zero = np.zeros(3, np.float32)
    again, first = (n.added(zero, np.random.default_rng(1)) for n in (noise, fresh))
    np.testing.assert_array_equal(again, first)


def test_impossible_noise_is_refused():
    with pytest.raises(MechSearchError, match="correlation"):
        NoiseConfig(correlation=1.0)
