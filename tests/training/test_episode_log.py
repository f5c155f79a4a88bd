import numpy as np
import pytest

from mechsearch.actor_critic.episode_log import EpisodeLog
from mechsearch.files import read_lines
from mechsearch.files.tensors import Archive
from mechsearch.training.log import RunLog

INFO = {"end": "uncovered", "occlusion": 0.01, "reward_terms": {"visible": 1.0, "idle": -0.5}}


def played(rewards, gamma=0.5):
    log = EpisodeLog(3, ("actor", "straight"), gamma)
    for i, reward in enumerate(rewards):
        action = np.array([1.0, 0.0, 0.0]) if i else np.zeros(3)
        log.add(i % 2, 10.0 + i, action, reward, INFO)
    return log


def test_the_return_that_followed_is_discounted_by_hand():
    found = played([1.0, 2.0, 4.0]).summary(True, INFO)
    # 1 + 2/2 + 4/4 = 3, 2 + 4/2 = 4 and 4.
    assert found["return_start"] == 3.0
    assert found["return_followed"] == pytest.approx((3 + 4 + 4) / 3)
    assert found["return"] == 7.0
    assert found["q"] == 11.0
    assert found["q_start"] == 10.0


def test_the_critic_values_what_a_truncation_cut_off():
    found = played([1.0, 2.0]).summary(False, INFO)
    # The last Q is 11: 2 + 11/2 = 7.5, then 1 + 7.5/2 = 4.75.
    assert found["return_start"] == 4.75


def test_choices_terms_saturation_and_updates_are_told():
    log = played([1.0, 2.0, 4.0])
    log.add_update({"critic_loss": 1.0})
    log.add_update({"critic_loss": 3.0})
    found = log.summary(True, INFO)
    assert found["chosen_actor"] == pytest.approx(2 / 3)
    assert found["chosen_straight"] == pytest.approx(1 / 3)
    assert found["term_visible"] == 3.0
    assert found["saturated"] == pytest.approx(2 / 9)
    assert found["update_critic_loss"] == 2.0


def test_a_reopened_log_drops_what_will_come_again(tmp_path):
    log = RunLog(tmp_path)
    for step in (1, 2):
        log.write("episode", step, {"return": step / 3, "end": "lost"})
    size = log.size
    log.write("episode", 3, {"return": 1.0, "end": "lost"})
    log.close()
    before = (tmp_path / "metrics.jsonl").read_bytes().splitlines()
    (tmp_path / "metrics.jsonl").open("a").write('{"step": 4, "torn')
    RunLog(tmp_path, Archive("checkpoint", {}, {"step": 2, "logged": size})).close()
    assert (tmp_path / "metrics.jsonl").read_bytes().splitlines() == before[:2]
    assert [r["step"] for r in read_lines(tmp_path / "metrics.jsonl")] == [1, 2]
