from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.heaps.dataset import embedded_heaps
from mechsearch.objects.household.object_set import household
from mechsearch.sim.scene import PhysicsConfig, Pusher
from mechsearch.sim.travel import Outlines, clear_steps, free_travel
from mechsearch.sim.world import AWAKE, World

EVERYTHING = replace(AWAKE, clearance=float("inf"), stops_when_still=False)
"""Physics that leaves nothing out."""


@pytest.fixture(scope="module")
def heaps():
    """Worlds of some embedded heaps of 15 objects, by physics."""
    chosen = [heap for heap in embedded_heaps("single").heaps if heap.count == 15][:4]
    models = household().models

    def make(config=None):
        worlds = []
        for heap in chosen:
            world = World([models[n] for n in heap.objects], pusher=Pusher(), config=config)
            world.reset(heap.poses, np.array([0.25, 0.02, 0.04]))
            worlds.append(world)
        return worlds

    return make


def sweep(world, actions=14):
    """Push straight through the heap; yield after each action."""
    for _ in range(actions):
        world.push(world.pusher_position + np.array([-0.045, 0.0, 0.0]))
        yield


def test_the_free_answer_is_the_engines_own(boxes):
    pusher, config = Pusher(), PhysicsConfig()
    world = World([boxes.models["cube"]], pusher=pusher, config=EVERYTHING)
    world.reset(np.array([[0.3, 0.3, 0.03, 1, 0, 0, 0]]), np.array([-0.2, 0.1, 0.1]))
    world.push(np.array([-0.17, 0.12, 0.09]))
    expected = np.array([-0.2, 0.1, 0.1]) + free_travel(pusher, config).position[-1] * np.array(
        [0.03, 0.02, -0.01]
    )
    np.testing.assert_allclose(world.pusher_position, expected, atol=1e-9)


def test_the_servo_arrives_within_a_third_of_a_millimetre():
    answer = free_travel(Pusher(), PhysicsConfig())
    assert abs(answer.position[-1] - 1) * 0.05 < 3e-4
    assert answer.set_point[PhysicsConfig().action_steps] == pytest.approx(1)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-0.2, 0.2)] * 3, *[st.floats(0.005, 0.1)] * 3), max_size=5),
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.tuples(*[st.floats(-0.05, 0.05)] * 3),
)
def test_no_box_is_nearer_than_the_clearance_up_to_the_step_that_is_returned(boxes, start, command):
    low = np.array([b[:3] for b in boxes]).reshape(-1, 3)
    high = low + np.array([b[3:] for b in boxes]).reshape(-1, 3)
    pusher, clearance = Pusher(), 0.005
    path = np.array(start) + np.linspace(0, 1, 12)[:, None] * np.array(command)

    def near(tip):
        beside = np.maximum(np.maximum(low[:, :2] - tip[:2], tip[:2] - high[:, :2]), 0)
        level = (tip[2] < high[:, 2] + clearance) & (tip[2] + pusher.length > low[:, 2] - clearance)
        return bool((level & (np.hypot(*beside.T) < pusher.radius + clearance)).any())

    last = clear_steps(path, (low, high), pusher.outline[0], clearance)
    assert not any(near(tip) for tip in path[1 : last + 1])
    if last < len(path) - 1:
        assert near(path[last]) or near(path[last + 1])


def test_boxes_hold_all_points_of_their_parts_wherever_they_lie(boxes):
    models = list(boxes.models.values())
    outlines, rng = Outlines([model.parts for model in models]), np.random.default_rng(0)
    for _ in range(3):
        poses = rng.normal(size=(len(models), 7))
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        low, high = outlines.boxes(poses)
        world = World(models)
        world.reset(poses)
        row = 0
        for model, pose in zip(models, poses, strict=True):
            for part in model.parts:
                points = [_moved(pose, point) for point in part]
                np.testing.assert_allclose(low[row], np.min(points, axis=0), atol=1e-12)
                np.testing.assert_allclose(high[row], np.max(points, axis=0), atol=1e-12)
                row += 1


def _moved(pose, point):
    w, axis = pose[3], pose[4:]
    twice = 2 * np.cross(axis, point)
    return pose[:3] + point + w * twice + np.cross(axis, twice)


def test_an_action_from_a_snapshot_is_exact_although_islands_sleep(heaps):
    for world, other in zip(heaps(), heaps(), strict=True):
        for _ in sweep(world):
            snapshot, tip = world.snapshot(), world.pusher_position
            break
        for _ in sweep(other, 3):
            pass
        other.restore(snapshot)
        for _ in range(6):
            tip = tip + np.array([-0.045, 0.0, 0.0])
            world.push(tip)
            other.push(tip)
            np.testing.assert_array_equal(world.snapshot(), other.snapshot())
            other.restore(world.snapshot())


def test_bodies_overlap_by_less_than_2_mm_while_pushed_and_1_mm_at_rest(heaps):
    pushed, resting = [], []
    for world in heaps(replace(PhysicsConfig(), sleep_speed=0.0)):
        world.step(100)
        resting.append(world.penetrations())
        for _ in sweep(world):
            pushed.append(world.penetrations())
    assert np.percentile(np.concatenate(resting), 99.9) < 1e-3
    assert np.percentile(np.concatenate(pushed), 99.9) < 2e-3


def test_what_is_left_out_does_not_move_what_nothing_touches(heaps):
    for world in heaps():
        before = world.poses
        world.place_pusher(np.array([0.25, 0.25, 0.2]))
        world.push(np.array([0.25, 0.22, 0.2]))
        np.testing.assert_array_equal(world.poses, before)


def test_leaving_out_what_lies_still_moves_a_pushed_cube_as_before(boxes):
    ends = []
    for config in (PhysicsConfig(), EVERYTHING):
        world = World([boxes.models["cube"]], pusher=Pusher(), config=config)
        world.reset(np.array([[0, 0, 0.03, 1, 0, 0, 0]]), np.array([-0.14, 0.004, 0.03]))
        for _ in range(4):
            world.push(world.pusher_position + np.array([0.05, 0, 0]))
        ends.append(world.poses[0])
    assert ends[0][0] > 0.05
    np.testing.assert_allclose(ends[0][:3], ends[1][:3], atol=4e-3)
