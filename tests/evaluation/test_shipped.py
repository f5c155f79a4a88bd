import hashlib
import importlib.util

import numpy as np
import pytest

from mechsearch.env.heap_env import make_env
from mechsearch.env.retrieve_env import make_retrieve_env
from mechsearch.evaluation.policies import (
    SHIPPED_POLICIES,
    card,
    config_of_run,
    make_policy,
    shipped_file,
)
from mechsearch.evaluation.rollout import run_episode
from mechsearch.heaps.dataset import embedded_heaps
from mechsearch.types import MechSearchError

needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="trained policies need mechsearch[learn]"
)


@pytest.mark.parametrize("name", SHIPPED_POLICIES)
def test_a_card_is_that_of_the_weights_beside_it(name):
    told = card(name)
    assert told["sha256"] == hashlib.sha256(shipped_file(name).read_bytes()).hexdigest()
    expected = {"uncover": "single+dual"}.get(name, "dual" if "dual" in name else "single")
    assert told["trained_on"]["condition"] == expected
    assert told["scored_on"]["split"] == "held-out"
    assert told["scored_on"]["heaps"] == 300
    mean, low, high = told["scores"]["retrieved_within_5" if "retrieve" in name else "reward"]
    assert low < mean < high
    assert shipped_file(name).stat().st_size < 2.5e6


@needs_torch
@pytest.mark.parametrize("name", SHIPPED_POLICIES)
def test_a_shipped_policy_acts_right_away_on_embedded_heaps(name):
    policy, condition = make_policy(name), card(name)["trained_on"]["condition"].split("+")[0]
    heaps = embedded_heaps(condition).heaps
    held_out = next(i for i, heap in enumerate(heaps) if heap.held_out)
    made = make_retrieve_env if "retrieve" in name else make_env
    record = run_episode(policy, made(condition, split="all"), held_out, name=name)
    assert np.abs(record.actions).max() > 0.5
    assert config_of_run(name)["name"] == name


def test_no_other_policy_is_shipped():
    with pytest.raises(MechSearchError, match="choose one of uncover, retrieve, retrieve-dual"):
        shipped_file("triple")
