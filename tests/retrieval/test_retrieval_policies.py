"""What lies on a target, and the baselines of retrieval."""

import numpy as np
import pytest

from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrieveConfig
from mechsearch.evaluation.policies import RETRIEVAL, check_view, make_policy
from mechsearch.evaluation.rollout import evaluate, run_episode
from mechsearch.retrieval import grasper as room
from mechsearch.retrieval.grasper import occluders
from mechsearch.retrieval.policies import ClearThenGrasp, GraspOnly, UncoverThenGrasp
from mechsearch.types import GRASP, OCCLUSION_KEY, PUSH, REMOVE, RETRIEVAL_KEYS, MechSearchError
from tests.retrieval.middle_planner import MiddlePlanner, segments_of

TARGET = (1, (240, 280), (240, 280), 0.75)
LID = (2, (240, 280), (281, 300), 0.70)
UPPER = (3, (210, 239), (240, 280), 0.65)
LEVEL = (4, (281, 300), (240, 280), 0.748)
APART = (5, (240, 280), (190, 230), 0.60)
UNDER = (6, (240, 280), (225, 239), 0.77)


def found(*boxes):
    scene = segments_of(*boxes)
    return [o.segment for o in occluders(scene["grasp_depth"], scene["segments"])]


def test_what_touches_the_target_in_the_image_and_is_above_it_lies_on_it():
    assert found(TARGET, LID, UPPER, LEVEL) == [3, 2]
    assert found(TARGET, LEVEL, UNDER) == []
    assert found(TARGET, APART) == []
    assert found(LID, UPPER) == []


def test_the_target_at_the_images_edge_is_looked_at_no_further():
    assert found((1, (0, 20), (0, 20), 0.75), (2, (0, 20), (20, 30), 0.7)) == [2]


def test_it_is_the_targets_height_where_they_touch_that_counts():
    """The target's far end is high, its near end low."""
    far_end = (1, (240, 280), (200, 239), 0.65)
    assert found(far_end, TARGET, LID) == [2]
    near_end = (1, (240, 280), (270, 280), 0.65)
    assert found(TARGET, near_end, LID) == []


@pytest.fixture
def by_middle(monkeypatch):
    monkeypatch.setattr(room, "GraspPlanner", MiddlePlanner)


def decisions(policy, heap, objects, **settings):
    """Return the decisions of an episode, and its record."""
    keys = (*RETRIEVAL_KEYS, OCCLUSION_KEY)
    env = RetrieveEnv([heap], objects, RetrieveConfig(keys=keys, **settings))
    policy.equip(env.config.grippers)
    record = run_episode(policy, env, 0)
    return [Decision.of(action) for action in record.actions], record


def test_what_covers_the_target_is_put_aside_and_then_it_is_grasped(by_middle, covered, boxes):
    done, record = decisions(ClearThenGrasp(), covered, boxes)
    assert [d.kind for d in done] == [REMOVE, GRASP]
    assert record.end == "retrieved"
    # The lid, and not what stands apart.
    assert record.retrieval.held == ((1,), (0,))


def test_without_removals_left_it_grasps(by_middle, covered, boxes):
    done, record = decisions(ClearThenGrasp(), covered, boxes, max_removals=0, max_grasps=2)
    assert [d.kind for d in done] == [GRASP, GRASP]
    assert record.end in ("budget", "retrieved")


def test_who_only_grasps_tries_another_way_after_a_failure(by_middle, covered, boxes):
    done, record = decisions(GraspOnly(), covered, boxes, max_grasps=2)
    assert [d.kind for d in done] == [GRASP, GRASP]
    assert record.end == "budget"
    assert np.linalg.norm(np.subtract(done[0].numbers[:3], done[1].numbers[:3])) > 0.012


@pytest.mark.parametrize(("uncovered_at", "pushes"), [(0.8, 0), (0.0, 3)])
def test_pushes_come_before_grasps_until_the_target_is_uncovered_or_none_is_left(
    by_middle, covered, boxes, uncovered_at, pushes
):
    policy = UncoverThenGrasp("uncover", uncovered_at)
    done, _ = decisions(policy, covered, boxes, max_actions=3, max_grasps=1)
    assert [d.kind for d in done] == [PUSH] * pushes + [GRASP]


def test_who_pushes_is_bound_to_the_camera_of_its_training():
    with pytest.raises(MechSearchError, match="sees through the overhead camera at 64 px"):
        check_view(UncoverThenGrasp(), {}, RetrieveConfig(camera="tilted"), "it")


BASELINES = [name for name in RETRIEVAL if name != "retrieve-oracle"]


@pytest.mark.parametrize("name", BASELINES)
def test_a_baseline_makes_its_own_kinds_of_decisions_alike_every_time(name):
    """With the shipped network, whatever its numbers."""
    first, second = (evaluate(name, limit=2) for _ in range(2))
    assert first.header["env"]["grippers"] == ["jaws-85"]
    assert first.header["env"]["keys"] == list(make_policy(name).keys)
    for one, other in zip(first.episodes, second.episodes, strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_array_equal(one.poses, other.poses)
        assert one.end in ("retrieved", "budget", "lost")
        kinds = {Decision.of(action).kind for action in one.actions}
        assert kinds <= {GRASP} | {
            "clear-then-grasp": {REMOVE}, "grasp-only": set()
        }.get(name, {PUSH})  # fmt: skip
