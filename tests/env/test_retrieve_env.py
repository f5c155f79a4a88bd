"""Retrieval as an environment: what decisions come to, how episodes end, what is seen."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mechsearch.env.decision import Decision
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrievalReward, RetrieveConfig
from mechsearch.env.trial import from_start, imageless
from mechsearch.sim.gripper_world import Attempt, GripperWorld
from mechsearch.sim.scene import Pusher
from mechsearch.types import PRIVILEGED_KEYS, RETRIEVAL_KEYS, TEACHER_KEYS, MechSearchError, Outcome

FIXED = {"heap": 0, "fixed_start": True}
DOWN = (1.0, 0.0, 0.0, 0.0)
ON_CUBE, ON_LID, ON_SMALL = (0, 0, 0.03, *DOWN), (0.025, 0, 0.07, *DOWN), (0.15, 0.1, 0.015, *DOWN)
BLIND = RetrieveConfig(keys=("ee_position", "grasps_left"))


@pytest.fixture
def env(covered, boxes):
    env = RetrieveEnv([covered], boxes, BLIND)
    env.reset(options=FIXED)
    return env


def decide(env, *decisions):
    """Return what is said of each decision."""
    return [env.step(decision.vector())[4] for decision in decisions]


def everything(env):
    return b"".join(value.tobytes() for _, value in sorted(env.snapshot().items()))


def test_clutter_is_put_aside_and_the_target_retrieved(env):
    start = env.state.poses
    first, second, third = decide(
        env, Decision.remove(ON_SMALL), Decision.remove(ON_LID), Decision.grasp(ON_CUBE)
    )
    assert [info["held"] for info in (first, second, third)] == [(2,), (1,), (0,)]
    assert [info["outcome"] for info in (first, second, third)] == ["success"] * 3
    assert (first["occlusion"], second["occlusion"]) == (0.75, 0.0)
    # What is lifted off has not moved the clutter.
    assert first["clutter_moved"] == second["clutter_moved"] == 0.0
    assert (second["end"], third["end"], third["retrieved"]) == (None, "retrieved", True)
    assert (third["pushes"], third["grasps"], third["removals"]) == (0, 1, 2)
    away = env.state.poses - start
    np.testing.assert_allclose(away[:, 0], 1.0, atol=1e-3)
    with pytest.raises(MechSearchError, match="the episode is over"):
        decide(env, Decision.grasp(ON_CUBE))


def test_a_wrong_object_is_put_back_and_counted(env):
    start = env.state.poses
    (info,) = decide(env, Decision.grasp(ON_SMALL))
    assert (info["outcome"], info["held"], info["wrong_objects"]) == ("wrong object", (2,), 1)
    assert info["end"] is None
    assert np.abs(env.state.poses - start).max() < 1e-3


def test_two_objects_are_put_back_by_a_removal_too(env, monkeypatch):
    monkeypatch.setattr(
        GripperWorld, "attempt", held_by(GripperWorld.attempt, Outcome.TWO_OBJECTS, (0, 1))
    )
    (info,) = decide(env, Decision.remove(ON_LID))
    assert (info["outcome"], info["end"], info["wrong_objects"]) == ("two objects", None, 0)
    assert np.abs(env.state.poses[:, 0]).max() < 0.4


def test_the_target_alone_counts_as_retrieved_by_a_removal_too(env):
    decide(env, Decision.remove(ON_LID))
    (info,) = decide(env, Decision.remove(ON_CUBE))
    assert (info["end"], info["held"]) == ("retrieved", (0,))


def held_by(attempt, outcome, held):
    """Return an attempt that says otherwise what came up."""

    def changed(*args, **kwargs):
        attempt(*args, **kwargs)
        return Attempt(outcome, held)

    return changed


def test_failed_physics_ends_the_episode_by_name_without_success_or_reward(env, monkeypatch):
    start = env.state.poses
    with monkeypatch.context() as broken:
        failed = held_by(GripperWorld.attempt, Outcome.FAILURE, (0,))
        broken.setattr(GripperWorld, "attempt", failed)
        broken.setattr(GripperWorld, "failure", lambda world: "explosion")
        _, reward, terminated, truncated, info = env.step(Decision.grasp(ON_LID).vector())
    assert (info["end"], info["failure"]) == ("failure: explosion", "explosion")
    assert (info["retrieved"], reward, terminated, truncated) == (False, 0.0, False, True)
    np.testing.assert_array_equal(env.state.poses, start)
    # The same world goes on soundly afterwards.
    env.reset(options=FIXED)
    assert decide(env, Decision.remove(ON_LID))[0]["held"] == (1,)


def test_pushes_move_the_tip_and_cost_what_moves(covered, boxes):
    weights = RetrievalReward(retrieved=1.0, action=0.25, movement=2.0)
    env = RetrieveEnv([covered], boxes, replace(BLIND, retrieval=weights))
    obs, _ = env.reset(options=FIXED)
    after, reward, _, _, info = env.step(Decision.push([0, 0, 1]).vector())
    np.testing.assert_allclose(after["ee_position"] - obs["ee_position"], [0, 0, 0.05], atol=1e-6)
    assert (info["outcome"], info["held"], reward) == ("", (), -0.25)
    env.world.place_pusher([0.09, 0.1, 0.01])
    total = [env.step(Decision.push([1, 0, 0]).vector()) for _ in range(2)][1]
    info = total[4]
    assert info["clutter_moved"] > 0.005
    assert total[1] == pytest.approx(-0.25 - 2.0 * info["clutter_moved"])
    assert total[1] == sum(info["reward_terms"].values())


def test_the_last_grasp_and_a_decision_of_a_kind_that_is_used_up_end_the_episode(covered, boxes):
    env = RetrieveEnv([covered], boxes, replace(BLIND, max_actions=1, max_grasps=2, max_removals=0))
    obs, _ = env.reset(options=FIXED)
    assert obs["grasps_left"].tolist() == [2]
    infos = decide(env, Decision.grasp(ON_SMALL), Decision.grasp(ON_SMALL))
    assert [info["end"] for info in infos] == [None, "budget"]
    for used_up in (Decision.push([0, 0, 1]), Decision.remove(ON_SMALL)):
        env.reset(options=FIXED)
        decide(env, Decision.push([0, 0, 1]))
        before = env.state
        (info,) = decide(env, used_up)
        assert (info["end"], info["outcome"], info["pushes"]) == ("budget", "used up", 1)
        np.testing.assert_array_equal(env.state.ee_position, before.ee_position)


def test_a_target_off_the_table_is_lost(env):
    env.world.place(0, [0.45, 0, 0.1, *DOWN])
    env.world.place_pusher([0.2, 0.1, 0.01])
    (info,) = decide(env, Decision.push([-1, 0, 0]))
    assert (info["end"], info["occlusion"]) == ("lost", 1.0)


def test_a_snapshot_goes_on_bit_by_bit_in_any_copy(env):
    decide(env, Decision.grasp(ON_SMALL), Decision.remove(ON_LID))
    snapshot = env.snapshot()
    rest = [Decision.push([-1, -1, -1]), Decision.grasp(ON_SMALL), Decision.grasp(ON_CUBE)]
    infos, state = decide(env, *rest), everything(env)
    for copy in (env, imageless(env), RetrieveEnv(env.heaps, env.objects, BLIND)):
        copy.restore(snapshot)
        assert decide(copy, *rest) == infos
        assert everything(copy) == state
    twin = imageless(env)
    assert set(twin.restore(from_start(snapshot))) == set(TEACHER_KEYS)
    assert decide(twin, Decision.grasp(ON_CUBE))[0]["grasps"] == 1


def test_perturbed_grasps_repeat_themselves_and_differ_from_one_another(covered, boxes):
    env = RetrieveEnv([covered], boxes, replace(BLIND, perturbed=True))
    ends = []
    for _ in range(2):
        env.reset(options=FIXED)
        decide(env, Decision.grasp(ON_SMALL), Decision.grasp(ON_SMALL))
        ends.append(everything(env))
    assert ends[0] == ends[1]
    exact = RetrieveEnv([covered], boxes, BLIND)
    exact.reset(options=FIXED)
    decide(exact, Decision.grasp(ON_SMALL), Decision.grasp(ON_SMALL))
    assert everything(exact) != ends[0]


def test_what_is_seen_is_what_is_asked_for_and_nothing_privileged(covered, boxes):
    env = RetrieveEnv([covered], boxes)
    obs, _ = env.reset(options=FIXED)
    assert tuple(obs) == RETRIEVAL_KEYS
    assert not set(obs) & set(PRIVILEGED_KEYS)
    assert env.observation_space.contains(obs)
    segments, depth = obs["segments"], obs["grasp_depth"]
    assert set(np.unique(segments)) == {0, 1, 2, 3}
    # The lid's upper side is 8 cm high, the small cube's 3 cm, and what is free of the cube's 6 cm.
    heights = {n: 0.8 - np.median(depth[segments == n]) for n in range(4)}
    assert sorted(heights.values()) == pytest.approx([0.0, 0.03, 0.06, 0.08], abs=1e-5)
    assert heights[1] == pytest.approx(0.06, abs=1e-5)
    env.step(Decision.remove(ON_LID).vector())
    obs, *_ = env.step(Decision.push([0, 0, -1]).vector())
    assert set(np.unique(obs["segments"])) == {0, 1, 2}
    assert [obs[key].item() for key in RETRIEVAL_KEYS[-3:]] == [49, 8, 7]


def test_the_robot_is_out_of_the_way_whenever_a_camera_looks(covered, boxes):
    env = RetrieveEnv([covered], boxes, render_mode="rgb_array")
    before, _ = env.reset(options=FIXED)
    env.world.place_pusher([-0.1, 0.1, 0.1])
    after, *_ = env.step(Decision.push([0, 0, 0]).vector())
    for key in ("depth", "grasp_depth"):
        np.testing.assert_array_equal(before[key], after[key])
    assert env.render().shape == (256, 256, 3)


def test_a_film_has_the_frames_of_a_grasp(env):
    env.film = []
    decide(env, Decision.grasp(ON_SMALL))
    phases = dict.fromkeys(frame.phase for frame in env.film)
    assert {"descend", "close", "lift", "lower", "open"} <= set(phases)


@pytest.mark.parametrize(
    ("decision", "message"),
    [
        (Decision.grasp((0.5, 0, 0.03, *DOWN)), r"\(0.500, 0.000, 0.030\) m.*out of reach.*0.4 m"),
        (Decision.remove((0, 0, 0.3, *DOWN)), "a removal at.*height up to 0.25 m"),
        (Decision.grasp((0, 0, 0.03, 0, 1, 0, 0)), "tilted by 180 degrees.*up to 60 degrees"),
        (Decision.grasp(ON_CUBE, 1), "gripper 1 does not exist; choose 0 to 0 of jaws-85"),
    ],
)
def test_what_no_gripper_can_reach_is_refused_and_nothing_is_spent(env, decision, message):
    with pytest.raises(MechSearchError, match=message):
        env.step(decision.vector())
    assert decide(env, Decision.push([0, 0, 1]))[0]["grasps"] == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grippers": ("jaws-12",)}, "unknown gripper 'jaws-12'; choose one of jaws-56, jaws-85"),
        ({"grippers": ()}, "grippers are none; expected one or more"),
        ({"grippers": ("suction", "suction")}, "no two alike"),
        ({"max_grasps": 0}, "max_grasps is 0; expected at least 1"),
        ({"max_removals": -1}, "max_removals is -1; expected at least 0"),
        ({"max_actions": 0}, "max_actions is 0"),
        ({"pusher": Pusher(radius=0.02)}, "in retrieval the first of the grippers pushes"),
    ],
)
def test_a_task_that_cannot_be_is_refused(settings, message):
    with pytest.raises(MechSearchError, match=message):
        RetrieveConfig(**settings)


def test_unknown_keys_are_answered_with_all_choices(covered, boxes):
    with pytest.raises(MechSearchError, match=r"'smell'.*depth.*grasp_depth.*removals_left"):
        RetrieveEnv([covered], boxes, RetrieveConfig(keys=("smell",)))
    with pytest.raises(MechSearchError, match="unknown observation key 'segments'"):
        HeapEnv([covered], boxes, HeapEnvConfig(keys=("segments",)))
    with pytest.raises(MechSearchError, match=r"retrieval\.action is nan"):
        RetrievalReward(action=float("nan"))


@pytest.mark.parametrize("name", ["Retrieve", "RetrieveDual"])
@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_checker_passes_on_both_ids(name):
    env = gymnasium.make(
        f"mechsearch/{name}-v0", disable_env_checker=True, render_mode="rgb_array"
    ).unwrapped
    check_env(env)
