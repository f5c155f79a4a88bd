"""Hand-computed rewards (paper, section III-A)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.env.reward import (
    RewardConfig,
    clutter_movement,
    idleness,
    reward_of,
    terms,
    uncovering_gain,
)
from mechsearch.types import MechSearchError

CONFIG = RewardConfig()
unit = st.floats(0, 1)


def test_halving_the_occlusion_earns_half_of_two_and_a_half():
    reward = terms(0.6, 0.3, np.array([0.04, 0.0]), 0.0, False, 0.02, CONFIG)
    assert reward["uncovering"] == pytest.approx(1.25)
    assert reward["clutter_movement"] == 0.0
    assert sum(reward.values()) == pytest.approx(1.25 - 0.5)


def test_moving_clutter_without_uncovering_costs_75_a_mean_metre():
    reward = terms(0.5, 0.5, np.array([0.02, 0.0, 0.01, 0.0]), 0.0, False, 0.02, CONFIG)
    assert reward["clutter_movement"] == pytest.approx(-75 / 4 * 0.03)


def test_a_gain_of_five_percent_excuses_and_a_smaller_one_does_not():
    moved = np.array([0.02])
    assert terms(0.4, 0.38, moved, 0.0, False, 0.02, CONFIG)["clutter_movement"] == 0.0
    assert terms(0.4, 0.381, moved, 0.0, False, 0.02, CONFIG)["clutter_movement"] == pytest.approx(
        -1.5
    )


def test_limits_are_where_the_rules_say():
    assert clutter_movement(CONFIG.gain_that_excuses, np.array([0.02]), CONFIG) == 0.0
    option = RewardConfig(idle_when="nothing moved")
    assert idleness(option.still, option) == -0.5
    assert idleness(np.nextafter(option.still, 1), option) == 0.0


def test_moving_the_target_is_never_excused():
    reward = terms(0.4, 0.0, np.array([0.0]), 0.03, False, 0.02, CONFIG)
    assert reward["target_movement"] == pytest.approx(-2.25)
    assert reward["uncovering"] == pytest.approx(2.5)


def test_leaving_the_workspace_costs_half_a_point():
    assert terms(0.4, 0.4, np.zeros(2), 0.0, True, 0.02, CONFIG)["workspace"] == -0.5
    assert terms(0.4, 0.4, np.zeros(2), 0.0, False, 0.02, CONFIG)["workspace"] == 0.0


def test_idleness_may_be_charged_only_when_nothing_moved():
    option = RewardConfig(idle_when="nothing moved")
    assert terms(0.4, 0.4, np.array([0.01]), 0.0, False, 0.02, option)["idleness"] == 0.0
    assert terms(0.4, 0.4, np.array([0.0005]), 0.0, False, 0.02, option)["idleness"] == -0.5
    assert terms(0.4, 0.4, np.array([0.01]), 0.0, False, 0.02, CONFIG)["idleness"] == -0.5


def test_the_gain_is_relative_above_the_least_occlusion_and_clipped():
    assert uncovering_gain(0.5, 0.4, 0.02) == pytest.approx(0.2)
    assert uncovering_gain(0.01, 0.0, 0.02) == pytest.approx(0.5)
    assert uncovering_gain(0.02, 1.0, 0.02) == -1.0


@given(unit, unit, st.lists(st.floats(0, 0.1), min_size=1, max_size=14), st.floats(0, 0.1))
def test_no_penalty_is_ever_positive_and_the_gain_is_bounded(before, after, clutter, target):
    reward = terms(before, after, np.array(clutter), target, True, 0.02, CONFIG)
    gained = reward.pop("uncovering")
    assert all(p <= 0 for p in reward.values())
    assert -2.5 <= gained <= 2.5


@given(unit, unit)
def test_uncovering_and_covering_again_never_pays(before, between):
    there = uncovering_gain(before, between, 0.02)
    back = uncovering_gain(between, before, 0.02)
    assert there + back <= 1e-9


def test_an_unknown_idleness_rule_is_named():
    with pytest.raises(MechSearchError, match="sometimes"):
        RewardConfig(idle_when="sometimes")


def test_a_target_in_full_view_is_divided_by_nothing_where_only_full_view_counts():
    assert uncovering_gain(0.0, 0.0, 0.0) == 0.0
    assert uncovering_gain(0.0, 0.1, 0.0) == -1.0


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("movement", float("nan"), "reward.movement is nan; expected a finite number"),
        ("workspace", float("inf"), "reward.workspace is inf; expected a finite number"),
        ("function", "mine", "'mine'; expected 'paper' or package.module:function"),
    ],
)
def test_what_is_no_weight_or_function_is_named(field, value, message):
    with pytest.raises(MechSearchError, match=message):
        RewardConfig(**{field: value})


def sparse(before, after, clutter, target, leaves, uncovered_at, config):
    """Return terms in whatever order, as whatever numbers."""
    named = {"seen": np.float32(after <= uncovered_at), "left": int(leaves)}
    return named if after < before else dict(reversed(named.items()))


def moody(before, after, *others):
    """Return terms whose names change."""
    return {"fell" if after < before else "rose": 1.0}


def later_endless(before, after, *others):
    """Return an infinite reward, but not at once."""
    return {"reward": float("inf") if after < before else 1}


RETURNS = {
    "number": 3,
    "empty": {},
    "endless": {"first": 1.0, "second": float("inf")},
    "unnamed": {"first": 1.0, 3: 1.0},
    "textual": {"first": "1"},
}


def __getattr__(name):
    if name not in RETURNS:
        raise AttributeError(name)
    return lambda *args: RETURNS[name]


def test_the_papers_reward_is_what_a_configuration_names_by_default():
    assert reward_of(CONFIG) == (
        terms,
        ("uncovering", "clutter_movement", "target_movement", "workspace", "idleness"),
    )


def test_a_reward_of_ones_own_gives_plain_numbers_in_one_order():
    config = RewardConfig(function=f"{__name__}:sparse")
    reward, names = reward_of(config)
    assert names == ("left", "seen")
    for after, seen in ((0.1, 0.0), (0.01, 1.0)):
        found = reward(0.5, after, np.zeros(1), 0.0, True, 0.02, config)
        assert list(found.items()) == [("left", 1.0), ("seen", seen)]
        assert all(type(value) is float for value in found.values())


@pytest.mark.parametrize("name", RETURNS)
def test_what_is_no_reward_is_refused_at_once(name):
    with pytest.raises(MechSearchError, match=f":{name}' returned .*; expected a mapping of names"):
        reward_of(RewardConfig(function=f"{__name__}:{name}"))
    with pytest.raises(MechSearchError, match="has no function or class 'absent'"):
        reward_of(RewardConfig(function=f"{__name__}:absent"))


def test_what_is_no_reward_later_is_refused_then():
    for name, message in (
        ("later_endless", "returned {'reward': inf}"),
        ("moody", "fell; expected rose after"),
    ):
        config = RewardConfig(function=f"{__name__}:{name}")
        reward, _ = reward_of(config)
        assert reward(0.5, 0.6, np.zeros(1), 0.0, False, 0.02, config)
        with pytest.raises(MechSearchError, match=message):
            reward(0.5, 0.4, np.zeros(1), 0.0, False, 0.02, config)
