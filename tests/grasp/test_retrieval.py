import numpy as np
import pytest

from mechsearch.geometry import yaw_quaternion
from mechsearch.grasp.retrieval import LiftTask, lift_all, lift_grasps, on_table
from mechsearch.objects.catalog import load_object_set
from mechsearch.pictures.lift import lift_strip
from mechsearch.sim.lift import LiftFrame, LiftWorld, Outcome
from mechsearch.types import MechSearchError


def at(x, y, z, yaw=0.0):
    return np.array([x, y, z, *yaw_quaternion(yaw)])


@pytest.fixture
def task():
    """A golf-ball-sized sphere alone; grasps over its centre, at its rim, and beside it."""
    models = load_object_set("household").models
    name = min(models, key=lambda key: float(np.ptp(models[key].vertices, axis=0).max()))
    low = float(models[name].vertices[:, 2].min())
    poses = np.array([at(0.1, 0, -low)])
    grasps = np.stack([at(0.1, 0, -low), at(0.2, 0, -low)])
    return LiftTask("household", (name,), poses, 0, grasps, repeats=6, seed=1)


def test_outcomes_do_not_depend_on_the_number_of_workers(task):
    alone = list(lift_all([task, task]))
    assert alone[0] == alone[1]
    assert list(lift_all([task, task], workers=2)) == alone


def test_a_grasp_on_air_always_misses_and_its_probability_is_zero(task):
    (_, air), *_ = lift_all([task])
    assert air.planned is Outcome.MISSED
    assert set(air.repeats) == {Outcome.MISSED}
    assert air.probability == 0.0


def test_perturbations_make_a_tight_grasp_uncertain(boxes):
    cube = boxes.models["cube"]
    grasps = at(0, 0, 0.045)[None]
    task = LiftTask("boxes", ("cube",), np.array([at(0, 0, 0.03)]), 0, grasps, repeats=12)
    tight = lift_grasps([cube], task)[0]
    small = boxes.models["small0"]
    easy = LiftTask("boxes", ("s",), np.array([at(0, 0, 0.015)]), 0, at(0, 0, 0.018)[None], 12)
    assert tight.probability < 0.5 < lift_grasps([small], easy)[0].probability


def test_a_lost_target_is_missed_and_lost_clutter_is_out_of_the_way(boxes):
    models = [boxes.models["small0"], boxes.models["lid"]]
    poses = np.array([at(0, 0, 0.015), at(0.9, 0, -0.7)])
    assert on_table(poses, 0) == ([0], 0)
    assert on_table(poses, 1) == ([0], None)
    grasps = at(0, 0, 0.018)[None]
    kept = lift_grasps(models, LiftTask("boxes", ("s", "l"), poses, 0, grasps, 0))[0]
    lost = lift_grasps(models, LiftTask("boxes", ("s", "l"), poses, 1, grasps, 2))[0]
    assert (kept.planned, kept.probability) == (Outcome.SUCCESS, 1.0)
    assert (lost.planned, lost.probability) == (Outcome.MISSED, 0.0)


def test_a_film_shows_every_phase_of_a_lift(boxes):
    models = [boxes.models["small0"]]
    world = LiftWorld(models)
    film: list[LiftFrame] = []
    world.lift(np.array([at(0, 0, 0.015)]), 0, at(0, 0, 0.018), film=film)
    assert list(dict.fromkeys(frame.phase for frame in film)) == [
        "descend", "close", "lift", "shake",
    ]  # fmt: skip
    strip = lift_strip(film, models, world.gripper, 0, "a cube", count=6, size=64)
    assert strip.width == 6 * 64
    green = np.asarray(strip).astype(int)
    assert ((green[..., 1] - green[..., 0] > 40).sum(axis=0) > 0).any()
    with pytest.raises(MechSearchError, match="no frames"):
        lift_strip([], models, world.gripper, 0, "")
