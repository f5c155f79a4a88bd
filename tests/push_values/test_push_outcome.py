from dataclasses import replace

import numpy as np

from mechsearch.env.trial import Rollout
from mechsearch.push_values.episodes import outcome_of
from mechsearch.push_values.value import PushOutcome


def test_a_pushs_outcome_is_its_reward_without_idleness_and_nothing_if_it_was_cut_off():
    terms, some = {"idleness": -1.0, "uncovering": 3.0}, [np.zeros(3, np.float32)] * 2
    lost = Rollout({}, some, 2.0, terms, 0.1, "lost", 1.0)
    assert outcome_of(lost) == PushOutcome(3.0, 2, False, 1.0, 0.1)
    over = outcome_of(replace(lost, end="uncovered", occlusion=0.01))
    assert over == PushOutcome(3.0, 2, True, 0.01, 0.1)
    assert outcome_of(replace(lost, end=None)) is not None
    for end in ("action limit", "failure: unstable"):
        assert outcome_of(replace(lost, end=end)) is None
    assert outcome_of(Rollout({})) is None
