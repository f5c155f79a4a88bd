import numpy as np
import pytest

from mechsearch.geometry import yaw_quaternion
from mechsearch.grasp.graspability import Graspability, on_table
from mechsearch.grippers import Gripper
from mechsearch.objects.catalog import load_object_set
from mechsearch.pictures.grasps import lift_strip
from mechsearch.retrieval.assessment import (
    GraspAssessment,
    GraspTask,
    LiftResult,
    assess_all,
    film_lift,
    lift_grasps,
    summarise,
)
from mechsearch.types import MechSearchError, Outcome


def at(x, y, z, yaw=0.0):
    return np.array([x, y, z, *yaw_quaternion(yaw)])


@pytest.fixture(scope="module")
def sphere():
    """A golf-ball-sized sphere of the household, and how high its centre lies."""
    models = load_object_set("household").models
    name = min(models, key=lambda key: float(np.ptp(models[key].vertices, axis=0).max()))
    return models[name], -float(models[name].vertices[:, 2].min())


def test_outcomes_do_not_depend_on_the_number_of_workers(sphere):
    model, height = sphere
    task = GraspTask(
        "household", (model.name,), np.array([at(0.1, 0, height)]), 0, drawn=2, repeats=6, seed=1
    )
    alone = [found.lifts for found in assess_all([task, task])]
    assert alone[0] == alone[1]
    assert [found.lifts for found in assess_all([task, task], workers=2)] == alone


def test_a_grasp_on_air_always_misses_and_its_probability_is_zero(sphere):
    model, height = sphere
    place, aside = at(0.1, 0, height), at(0.2, 0, height)
    _, air = lift_grasps([model], place[None], 0, [place, aside], repeats=6, seed=1)
    assert air.planned is Outcome.MISSED
    assert set(air.repeats) == {Outcome.MISSED}
    assert air.probability == 0.0


def test_perturbations_make_a_tight_grasp_uncertain(boxes):
    cube, small = boxes.models["cube"], boxes.models["small0"]
    (tight,) = lift_grasps([cube], np.array([at(0, 0, 0.03)]), 0, [at(0, 0, 0.045)], 12)
    (easy,) = lift_grasps([small], np.array([at(0, 0, 0.015)]), 0, [at(0, 0, 0.018)], 12)
    assert tight.probability < 0.5 < easy.probability


def test_a_lost_target_is_missed_and_lost_clutter_is_out_of_the_way(boxes):
    models = [boxes.models["small0"], boxes.models["lid"]]
    poses = np.array([at(0, 0, 0.015), at(0.9, 0, -0.7)])
    assert on_table(poses, 0) == ([0], 0)
    assert on_table(poses, 1) == ([0], None)
    (kept,) = lift_grasps(models, poses, 0, [at(0, 0, 0.018)])
    (lost,) = lift_grasps(models, poses, 1, [at(0, 0, 0.018)], 2)
    assert (kept.planned, kept.probability) == (Outcome.SUCCESS, 1.0)
    assert (lost.planned, lost.probability) == (Outcome.MISSED, 0.0)


def test_targets_without_a_grasp_count_as_not_retrieved():
    won = GraspAssessment(
        Graspability(0.8, visible=9), Graspability(1.0), np.array([0.9]),
        (LiftResult(Outcome.SUCCESS, (Outcome.SUCCESS, Outcome.SLIPPED)),),
    )  # fmt: skip
    hidden = GraspAssessment(Graspability(), Graspability(0.5), np.empty(0), ())
    means = summarise([won, hidden])
    assert (means.graspability, means.ceiling, means.hidden) == (0.4, 0.75, 1)
    assert (means.retrieved, means.probability) == (0.5, 0.25)
    assert means.outcomes == {"success": 1, "slipped": 1}


def test_a_film_shows_every_phase_of_a_lift(boxes):
    models = [boxes.models["small0"]]
    gripper = Gripper()
    _, film = film_lift(models, np.array([at(0, 0, 0.015)]), 0, at(0, 0, 0.018), gripper)
    assert list(dict.fromkeys(frame.phase for frame in film)) == [
        "descend", "close", "lift", "shake",
    ]  # fmt: skip
    strip = lift_strip(film, models, gripper, 0, "a cube", count=6, size=64)
    assert strip.width == 6 * 64
    green = np.asarray(strip).astype(int)
    assert ((green[..., 1] - green[..., 0] > 40).sum(axis=0) > 0).any()
    with pytest.raises(MechSearchError, match="no frames"):
        lift_strip([], models, gripper, 0, "")
