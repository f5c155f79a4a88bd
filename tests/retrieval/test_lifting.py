from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.evaluation.episodes import CEILING_METRICS, HIGHER_IS_BETTER
from mechsearch.grasp.network import ready
from mechsearch.grasp.quality_network import QualityNetwork, save_quality_network
from mechsearch.grippers import GRIPPERS
from mechsearch.heaps.dataset import embedded_heaps
from mechsearch.pictures.grasps import lift_strip
from mechsearch.retrieval.lifting import (
    LIFT_STATES,
    CeilingConfig,
    LiftPlan,
    Reach,
    Robot,
    ceiling_rows,
    film_target,
    lift_targets,
    reach_of,
)
from mechsearch.sim.gripper_world import GripperWorld
from mechsearch.types import MechSearchError, Outcome

CONFIG = CeilingConfig(rated=3, geometric=20)


@pytest.fixture(scope="module")
def networks(tmp_path_factory):
    folder, files = tmp_path_factory.mktemp("networks"), {}
    for name in GRIPPERS:
        torch.manual_seed(0)
        files[name] = folder / f"{name}.safetensors"
        save_quality_network(files[name], ready(QualityNetwork(name)), {})
    return files


@pytest.fixture(scope="module")
def heaps():
    return embedded_heaps("single").held_out[:3]


@pytest.fixture(scope="module")
def lifted(heaps, networks):
    robot = Robot(("jaws-85",), (networks["jaws-85"],))
    plan = LiftPlan("household", robot, repeats=1)
    return plan, lift_targets(heaps, plan)


def test_both_grasps_of_a_target_are_tried_in_every_state(heaps, lifted):
    _, found = lifted
    assert {lifts.state for lifts in found} == set(LIFT_STATES)
    assert sum(lifts.state == "dropped" for lifts in found) == len(heaps)
    for lifts in found:
        heap = next(heap for heap in heaps if heap.seed == lifts.heap)
        assert heap.target in lifts.present
        assert (len(lifts.present) == 1) == (lifts.state == "alone")
        assert (lifts.chosen is None) == (lifts.grasp is None) == np.isnan(lifts.quality)
        if lifts.state == "dropped":
            np.testing.assert_array_equal(lifts.poses, heap.poses)
    tried = [lifts.chosen for lifts in found if lifts.chosen]
    assert tried
    assert all(len(result.repeats) == 1 for result in tried)


def test_lifts_do_not_depend_on_workers_or_other_states(heaps, lifted):
    plan, found = lifted
    again = lift_targets(heaps, replace(plan, states=("pushed",)), workers=2)
    pushed = [lifts for lifts in found if lifts.state == "pushed"]
    assert [(a.quality, a.chosen, a.drawn) for a in again] == [
        (p.quality, p.chosen, p.drawn) for p in pushed
    ]


@pytest.mark.parametrize("name", ["jaws-85", "suction"])
def test_a_chosen_grasp_is_filmed(heaps, networks, name):
    plan = LiftPlan("household", Robot((name,), (networks[name],)), ("alone",))
    found = [lifts for lifts in lift_targets(heaps, plan) if lifts.chosen]
    lifts = found[0]
    heap = next(heap for heap in heaps if heap.seed == lifts.heap)
    film, models, place = film_target(heap, plan, lifts)
    assert models[place].name == heap.objects[heap.target]
    strip = lift_strip(film, models, GRIPPERS[name], place, "alone", size=60)
    assert strip.width > 60


def test_several_grippers_reach_at_least_what_one_does(heaps, networks):
    def reach(*names):
        robot = Robot(names, tuple(networks[name] for name in names))
        return reach_of(heaps, "household", robot, CONFIG)

    one, both = reach("jaws-56"), reach("jaws-56", "suction")
    assert all(b.retrievable >= a.retrievable for a, b in zip(one, both, strict=True))
    assert any(each.retrievable for each in both)


def test_no_grasp_whose_physics_fails_counts(heaps, networks, monkeypatch):
    monkeypatch.setattr(GripperWorld, "try_grasp", lambda *_, **__: Outcome.FAILURE)
    robot = Robot(("jaws-56",), (networks["jaws-56"],))
    assert reach_of(heaps[:1], "household", robot, CONFIG) == [Reach(0, False)]


def test_a_ceiling_is_entered_by_its_grippers():
    found = [Reach(1, True), Reach(4, True), Reach(0, True), Reach(0, False)]
    rows = ceiling_rows("retrieval", "single", Robot(("jaws-85", "suction")), 0, found)
    assert {row.variant for row in rows} == {"ceiling-jaws-85-suction"}
    assert {row.metric: row.mean for row in rows} == {
        "retrieved_within_1": 0.25, "retrieved_within_3": 0.25, "retrieved_within_5": 0.5,
        "retrievable": 0.75,
    }  # fmt: skip
    assert all(HIGHER_IS_BETTER[name] for name in CEILING_METRICS)


def test_what_cannot_be_tried_is_refused(networks):
    with pytest.raises(MechSearchError, match="choose one of jaws-56, jaws-85, suction"):
        Robot(("tongs",))
    with pytest.raises(MechSearchError, match="1 networks for 2 grippers"):
        Robot(("jaws-85", "suction"), (networks["suction"],))
    with pytest.raises(MechSearchError, match="choose some of dropped, pushed, alone"):
        LiftPlan("household", Robot(("suction",)), ("removed",))
    with pytest.raises(MechSearchError, match="expected 0 or more"):
        LiftPlan("household", Robot(("suction",)), repeats=-1)
    with pytest.raises(MechSearchError, match="expected at least 1 and 0"):
        CeilingConfig(rated=0)
