"""Films of retrieval: carried out again phase by phase, or told by the record."""

from dataclasses import asdict, replace

import mujoco
import numpy as np
import pytest

from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrieveConfig
from mechsearch.evaluation.episodes import in_words
from mechsearch.evaluation.rollout import run_episode
from mechsearch.geometry import transform_from_pose
from mechsearch.grippers import gripper_named
from mechsearch.pictures.film import (
    OUT_OF_SIGHT,
    Film,
    FilmConfig,
    Hands,
    film_of,
    filmstrip,
    recorded,
)
from mechsearch.pictures.replay import replayed
from mechsearch.sim.arm import UR5E
from mechsearch.sim.arm_gripper_world import ArmGripperWorld

DOWN = (1.0, 0.0, 0.0, 0.0)
TASK = RetrieveConfig(keys=("ee_position",), grippers=("jaws-85", "suction"))
HEADER = {"env": asdict(TASK)}
DECISIONS = (
    Decision.push([0, 0, 1]), Decision.push([0, 0, 1]), Decision.grasp([0.025, 0, 0.07, *DOWN]),
    Decision.remove([0.025, 0, 0.08, *DOWN], 1), Decision.grasp([0, 0, 0.03, *DOWN]),
)  # fmt: skip


class Told:
    keys = ("ee_position",)

    def reset(self, rng):
        self._decisions = iter(DECISIONS)

    def act(self, obs):
        return next(self._decisions).vector()


@pytest.fixture(scope="module")
def record(covered, boxes):
    return run_episode(Told(), RetrieveEnv([covered], boxes, TASK), 0)


@pytest.fixture(scope="module")
def moments(record, boxes):
    return replayed(HEADER, record, boxes.models)


def described(moments):
    """Return what is said in turn."""
    words = [moment.words for moment in moments]
    return [word for i, word in enumerate(words) if words[:i][-1:] != [word]]


def test_every_phase_is_named_with_the_gripper_and_what_came_of_it(record, moments):
    assert record.retrieval.outcomes[2:] == ("wrong object", "success", "success")
    first, second = "grasp 1, jaws-85: ", "removal 1, suction: "
    assert described(moments) == [
        "start: 75% hidden", "push 1: 75% hidden", "push 2: 75% hidden",
        *(first + phase for phase in ("descend", "close", "lift", "wrong object")),
        *(first + phase for phase in ("put back", "let go", "leave", "75% hidden")),
        *(second + phase for phase in ("descend", "seal", "lift", "success", "0% hidden")),
        *(f"grasp 2, jaws-85: {phase}" for phase in ("descend", "close", "lift", "shake")),
        "grasp 2, jaws-85: success, retrieved",
    ]  # fmt: skip
    assert in_words(record) == (
        "75% hidden at the start; 2 pushes, 1 removal (success), 2 grasps (wrong object, success)"
    )


def test_the_jaws_close_on_what_they_lift_and_the_other_gripper_is_out_of_sight(record, moments):
    def parts(words):
        return next(moment for moment in reversed(moments) if moment.words.endswith(words)).parts

    opened, closed = parts("jaws-85: descend"), parts("success, retrieved")
    gap = [np.linalg.norm(p[1, :3] - p[2, :3]) for p in (opened, closed)]
    # An open finger's middle is its own half thickness beyond the opening.
    np.testing.assert_allclose(gap, [0.085 + 0.008, 0.06 + 0.008], atol=2e-3)
    assert (closed[3:, 2] > 10).all()
    cup = parts("suction: success")
    assert (cup[:3, 2] > 10).all()
    assert (cup[3:, 2] < 1).all()
    # The target hangs between the fingers.
    held = moments[-1].poses[record.target, :3]
    np.testing.assert_allclose(held[:2], closed[1:3, :2].mean(axis=0), atol=0.01)
    assert held[2] > record.poses[0, record.target, 2] + 0.1


def test_the_record_alone_shows_the_open_gripper_where_it_closed(record, boxes):
    found = recorded(HEADER, record, boxes.models)
    assert described(found)[3:5] == [
        "grasp 1, jaws-85: wrong object",
        "grasp 1, jaws-85: 75% hidden",
    ]
    assert found[-1].words == "grasp 2, jaws-85: success, retrieved"
    places = gripper_named("jaws-85").places + np.array([0, 0, 0.03])
    np.testing.assert_allclose(found[-1].parts[:3, :3], places, atol=1e-12)


def test_where_physics_takes_another_course_the_record_is_drawn(record, boxes):
    poses = record.poses.copy()
    poses[4:, 2, 0] += 0.01
    other = replace(record, poses=poses)
    words = [moment.words for moment in replayed(HEADER, other, boxes.models)]
    assert words == [moment.words for moment in recorded(HEADER, other, boxes.models)]


def shown(film, frames):
    """Return the captions of a filmstrip."""
    words = []
    film.frame = lambda number: words.append(film.moments[number].words) or Film.frame(film, number)
    filmstrip(film, frames)
    return words


def test_a_filmstrip_has_phases_where_there_is_room(record, moments, boxes):
    film = film_of(HEADER, record, boxes.models, FilmConfig(size=16), play=lambda *_: moments)
    outcomes = [
        "start: 75% hidden", "push 2: 75% hidden", "grasp 1, jaws-85: wrong object",
        "removal 1, suction: success", "grasp 2, jaws-85: success, retrieved",
    ]  # fmt: skip
    assert shown(film, 5) == outcomes
    assert shown(film, 7) == [
        *outcomes[:2], "grasp 1, jaws-85: close", *outcomes[2:4], "grasp 2, jaws-85: close",
        outcomes[4],
    ]  # fmt: skip


def test_pushes_have_a_path_and_grasps_a_gripper(record, moments, boxes):
    film = film_of(
        HEADER, record, boxes.models, FilmConfig(size=64, captions=False), True, lambda *_: moments
    )

    def blue(number, until=None):
        red, _, blue = np.moveaxis(np.asarray(film.frame(number, until)).astype(int), -1, 0)
        return int((blue > red + 100).sum())

    assert blue(2) > 0 == blue(film.last)
    assert blue(0) == 0 < blue(0, until=len(record.actions))
    without = Film(record, boxes.models, film.config, moments=moments).frame(film.last)
    assert np.asarray(film.frame(film.last)).tolist() != np.asarray(without).tolist()


def test_all_grippers_are_part_of_the_picture():
    hands = Hands(HEADER)
    assert [model.name for model in hands.models] == ["palm", "finger0", "finger1", "lip", "tube"]
    assert hands.open_at(1, np.array([0, 0, 0.1, *DOWN])).shape == (5, 7)


def test_an_arm_is_in_the_picture_while_it_grasps_where_the_engine_has_it():
    pytest.importorskip("mink")
    hands = Hands({"env": {"grippers": ["jaws-85"], "robot": "ur5e"}})
    world = ArmGripperWorld([], UR5E, pusher=gripper_named("jaws-85"))
    world.reset(np.zeros((0, 7)), np.array([0.1, 0.1, 0.2]))
    assert world.pusher_is_free()
    poses = world.gripper_poses()
    parts = hands.parts(0, poses)
    assert len(parts) == len(hands.models) == len(poses)
    capsules = world._model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    drawn = [
        transform_from_pose(pose)[:3, :3] @ (np.ptp(link.vertices, axis=0) * [0, 0, 0.5]) + pose[:3]
        for link, pose in zip(hands.models[3:], poses[3:], strict=True)
    ]
    np.testing.assert_allclose(drawn, world._data.geom_xpos[capsules], atol=1e-9)
    # Of a record alone only the jaws are known.
    open_ = hands.open_at(0, np.array([0, 0, 0.1, 1, 0, 0, 0.0]))
    assert (open_[3:] == OUT_OF_SIGHT).all()
    assert (open_[:3, 2] < 1).all()
