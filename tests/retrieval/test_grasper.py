"""Grasps that could be made, and the memory of those that failed."""

from dataclasses import replace

import numpy as np
import pytest

from mechsearch.grippers import RatedGrasps
from mechsearch.retrieval import grasper as room
from mechsearch.retrieval.grasper import Candidate, Grasper
from mechsearch.types import MechSearchError
from tests.retrieval.middle_planner import MiddlePlanner, segments_of

TARGET, BESIDE = (1, (240, 272), (240, 272), 0.74), (2, (240, 272), (272, 300), 0.7)


@pytest.fixture
def grasper(monkeypatch):
    monkeypatch.setattr(room, "GraspPlanner", MiddlePlanner)
    made = Grasper()
    made.equip(("jaws-85", "suction"))
    made.reset(np.random.default_rng(0))
    return made


def seen(grasper, *boxes, segment=1):
    return grasper.view(segments_of(*boxes), segment)


def chances(grasper, view):
    """Return what the middle grasps of both grippers, and those beside them, promise."""
    found, x = grasper.candidates(view), grasper.middle(view)[0]
    assert [c.quality for c in found] == sorted((c.quality for c in found), reverse=True)
    return {
        (c.gripper, bool(abs(c.pose[0] - x) < 0.01), bool(c.pose[3] == 1.0)): c.quality
        for c in found
    }


def test_grasps_of_all_grippers_come_best_first(grasper):
    found = grasper.candidates(seen(grasper, TARGET))
    assert [c.quality for c in found] == [0.6, 0.6, 0.5, 0.5, 0.4, 0.4]
    assert {c.gripper for c in found} == {0, 1}


def test_a_grasp_like_one_that_failed_is_thought_less_of_wherever_the_target_went(grasper):
    before = seen(grasper, TARGET)
    grasper.remember(before, grasper.candidates(before)[0])
    moved = seen(grasper, (1, (200, 232), (300, 332), 0.70))
    # All odds of the gripper that failed, 3/2, 1 and 2/3, are 0.6 times as high: 0.9, 0.6 and 0.4.
    # The same grasp, also the other way round, counts half besides; not the one 2 cm beside it.
    assert chances(grasper, moved) == pytest.approx({
        (0, True, True): 0.9 / 1.9 / 2, (0, True, False): 0.6 / 1.6 / 2,
        (0, False, True): 0.4 / 1.4,
        (1, True, True): 0.6, (1, True, False): 0.5, (1, False, True): 0.4,
    })  # fmt: skip


def test_a_grasp_that_closes_otherwise_has_not_failed(grasper):
    view = seen(grasper, TARGET)
    failed = grasper.candidates(view)[0]
    turned = replace(failed, pose=np.array([*failed.pose[:3], np.sqrt(0.5), 0, 0, np.sqrt(0.5)]))
    grasper.remember(view, turned)
    assert chances(grasper, view)[0, True, True] == pytest.approx(0.9 / 1.9)


def test_the_memory_is_of_the_target_alone_and_of_the_episode(grasper):
    view = seen(grasper, TARGET, BESIDE)
    grasper.remember(view, grasper.candidates(view)[0])
    assert grasper.candidates(view)[0].gripper == 1
    assert grasper.candidates(view, remembering=False)[0].quality == 0.6
    grasper.reset(np.random.default_rng(0))
    assert grasper.candidates(view)[0].gripper == 0


def test_a_hidden_target_is_grasped_blindly_where_it_was_seen_last(grasper):
    hidden = seen(grasper, BESIDE)
    assert grasper.candidates(hidden) == []
    np.testing.assert_allclose(grasper.middle(hidden), [0, 0, 0.03])
    there = grasper.middle(seen(grasper, (1, (200, 220), (300, 340), 0.7)))
    # Columns run along x and rows against y: 0.8 - 0.7 m high, at the ray of the middle pixel.
    np.testing.assert_allclose(there, [64 * 0.7 / 552.5, 46 * 0.7 / 552.5, 0.1], atol=1e-6)
    blind = [grasper.blind(hidden) for _ in range(2)]
    for each in blind:
        np.testing.assert_allclose(each.pose[:3], [*there[:2], there[2] - 0.02], atol=1e-9)
        assert each.pose[4] == each.pose[5] == each.quality == 0.0
    assert blind[0].pose[3] != blind[1].pose[3]
    grasper.middle(seen(grasper, (1, (200, 220), (300, 340), 0.799)))
    assert grasper.blind(hidden).pose[2] == 0.01


def test_the_generator_alone_decides_what_is_drawn(grasper):
    hidden, poses = seen(grasper, BESIDE), []
    for seed in (3, 3, 4):
        grasper.reset(np.random.default_rng(seed))
        poses.append(grasper.blind(hidden).pose.tolist())
    assert poses[0] == poses[1] != poses[2]


def test_no_grasp_out_of_reach_is_a_candidate(grasper, monkeypatch):
    good, far = [0.3, 0, 0.1, 1, 0, 0, 0], [0.41, 0, 0.1, 1, 0, 0, 0]
    high, lying = [0, 0, 0.26, 1, 0, 0, 0], [0, 0, 0.1, np.sqrt(0.5), np.sqrt(0.5), 0, 0]
    rated = RatedGrasps(np.array([far, high, lying, good]), np.array([0.9, 0.8, 0.7, 0.6]))
    monkeypatch.setattr(MiddlePlanner, "plan", lambda *_: rated)
    found = grasper.candidates(seen(grasper, TARGET))
    assert [(c.gripper, c.pose.tolist()) for c in found] == [(0, good), (1, good)]


def test_without_grippers_or_with_unknown_ones_nothing_is_planned(grasper):
    with pytest.raises(MechSearchError, match="call equip before the first episode"):
        Grasper().candidates(seen(grasper, TARGET))
    with pytest.raises(MechSearchError, match="unknown gripper 'claw'; choose one of jaws-56"):
        Grasper().equip(("claw",))
    # What was there before is kept.
    with pytest.raises(MechSearchError, match="unknown gripper"):
        grasper.equip(("jaws-85", "claw"))
    assert grasper.grippers == ("jaws-85", "suction")
    assert isinstance(grasper.candidates(seen(grasper, TARGET))[0], Candidate)
