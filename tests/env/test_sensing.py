"""The sensor as part of the task: what policies see is wrong, and nothing else is."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from mechsearch.camera import mounted, preset
from mechsearch.env import (
    Decision,
    HeapEnv,
    HeapEnvConfig,
    RetrieveConfig,
    RetrieveEnv,
    TaskConfig,
    task_from_json,
)
from mechsearch.env.scene import HeapScene
from mechsearch.evaluation.policies import policy_named
from mechsearch.evaluation.rollout import (
    evaluate,
    other_inputs,
    record_differences,
    replay_all,
    run_episode,
)
from mechsearch.heaps.dataset import embedded_file, open_heaps
from mechsearch.observe.observation import MOST_HOLES
from mechsearch.observe.sensor import SENSORS, Sensor
from mechsearch.pushes.chooser import PushChooser
from mechsearch.types import GRASP_KEYS, PRIVILEGED_KEYS, MechSearchError

LATER = ("mounted", "sensor", "segmenter")
FIXED = {"heap": 0, "fixed_start": True}
WRONG = [
    name for name, sensor in SENSORS.items() if isinstance(sensor, Sensor) and name != "perfect"
]
ACTIONS = np.array([[1, 0, 0], [0, 1, -0.5], [-1, 0.3, 0], [0, 0, 1]], np.float32)


def episode(env, seed=0, options=None):
    """Return what is seen and what happens in four actions."""
    seen, truth = [env.reset(seed=seed, options=options)[0]], []
    for action in ACTIONS:
        obs, reward, *_, info = env.step(action)
        seen.append(obs)
        truth.append((reward, info["occlusion"], env.state.poses.tobytes()))
    return seen, truth


def as_bytes(observations):
    return [b"".join(obs[key].tobytes() for key in sorted(obs)) for obs in observations]


def make(covered, boxes, sensor, **more):
    return HeapEnv([covered], boxes, HeapEnvConfig(sensor=sensor, privileged=True, **more))


@pytest.mark.parametrize("sensor", WRONG)
def test_only_what_is_seen_is_wrong(covered, boxes, sensor):
    perfect, true = episode(make(covered, boxes, "perfect"), options=FIXED)
    env = make(covered, boxes, sensor)
    wrong, also = episode(env, options=FIXED)
    assert also == true
    for right, obs in zip(perfect, wrong, strict=True):
        assert env.observation_space.contains(obs)
        assert (obs["depth"] > 0).all()
        assert (obs["depth"] != right["depth"]).any()
        assert np.abs(obs["ee_position"] - right["ee_position"]).max() > 1e-5
        for key in PRIVILEGED_KEYS:
            np.testing.assert_array_equal(obs[key], right[key])
    # The calibration's error is one for all of an episode.
    errors = [o["ee_position"] - r["ee_position"] for o, r in zip(wrong, perfect, strict=True)]
    np.testing.assert_allclose(errors, errors[:1] * 5, atol=1e-6)


@pytest.mark.parametrize("sensor", WRONG)
def test_an_episode_is_seen_again_bit_by_bit_also_from_a_snapshot(covered, boxes, sensor):
    env, other = (make(covered, boxes, sensor) for _ in range(2))
    seen, _ = episode(env, seed=5)
    assert as_bytes(episode(other, seed=5)[0]) == as_bytes(seen)
    assert as_bytes(episode(other, seed=6)[0]) != as_bytes(seen)
    env.reset(seed=5)
    for action in ACTIONS[:2]:
        env.step(action)
    snapshot = env.snapshot()
    later = [other.restore(snapshot), *(other.step(action)[0] for action in ACTIONS[2:])]
    assert as_bytes(later) == as_bytes(seen[2:])


def test_a_mixture_goes_on_from_a_snapshot_with_the_sensor_of_the_episode(covered, boxes):
    env, other = (make(covered, boxes, "mixed") for _ in range(2))
    for number in range(8):
        env.reset(seed=0 if number == 0 else None)
        env.step(ACTIONS[0])
        snapshot = env.snapshot()
        seen = [env.step(action)[0] for action in ACTIONS[1:]]
        other.restore(snapshot)
        assert as_bytes([other.step(action)[0] for action in ACTIONS[1:]]) == as_bytes(seen)


def test_a_perfect_episode_draws_nothing_and_saves_nothing_more(covered, boxes):
    env, noisy = make(covered, boxes, "perfect"), make(covered, boxes, "stereo")
    for one in (env, noisy):
        one.reset(seed=3)
    assert env.state.ee_position.tobytes() == noisy.state.ee_position.tobytes()
    assert set(noisy.snapshot()) - set(env.snapshot()) == {"episode"}
    with pytest.raises(MechSearchError, match="a snapshot without episode"):
        noisy.restore(env.snapshot())


@pytest.mark.parametrize("sensor", WRONG)
def test_retrieval_sees_through_the_sensor_too(covered, boxes, sensor):
    seen = []
    for name in ("perfect", sensor, sensor):
        env = RetrieveEnv([covered], boxes, RetrieveConfig(sensor=name))
        obs, _ = env.reset(options=FIXED)
        seen.append({key: obs[key] for key in GRASP_KEYS})
        assert env.observation_space.contains(obs)
        *_, info = env.step(Decision.push([1, 0, 0]).vector())
        assert info["occlusion"] == 0.75
    perfect, first, again = seen
    for key in GRASP_KEYS:
        np.testing.assert_array_equal(first[key], again[key])
        assert (first[key] != perfect[key]).any()
    assert (first["grasp_depth"] > 0).all()
    assert np.abs(first["grasp_depth"] - perfect["grasp_depth"]).mean() < 0.03
    both = (first["segments"] == 1) & (perfect["segments"] == 1)
    assert both.sum() > 0.2 * (perfect["segments"] == 1).sum()


def test_a_camera_that_is_not_where_it_is_believed_to_be_shifts_the_image(covered, boxes):
    """The cube's top, by the believed camera, is off by what the camera is."""
    env = make(covered, boxes, "harsh")
    env.reset(options=FIXED)
    scene, camera = env._scene, preset("overhead", 512)
    true = scene._sensing.camera(camera)
    frame = scene.renderer.frame(true, scene.poses)
    points = camera.back_project(frame.depth)[frame.modal(1)]
    expected = true.back_project(frame.depth)[frame.modal(1)]
    off = np.linalg.norm((points - expected).mean(axis=0))
    assert 0.001 < off < 0.06
    assert np.abs(expected.mean(axis=0) - [0.025, 0, 0.08]).max() < 0.003


@pytest.mark.parametrize("sensor", WRONG)
def test_images_keep_far_fewer_holes_than_are_refused(sensor):
    env = HeapEnv(*_heaps(), HeapEnvConfig(sensor=sensor))
    for heap in range(4):
        env.reset(options={"heap": heap, "fixed_start": True})
        scene = env._scene
        for camera in (preset("overhead"), preset("tilted")):
            depth, *_ = scene.sense(camera, 0, scene.poses, None, lambda frame: frame.modal(0))
            assert (depth == 0).mean() < MOST_HOLES / 2


def _heaps():
    heap_set, objects = open_heaps(embedded_file("single"), "household")
    return heap_set.heaps[:4], objects


def test_an_evaluation_keeps_its_sensor_and_is_verified(tmp_path):
    task = TaskConfig(sensor="stereo", max_actions=3)
    evaluation = evaluate("teacher-spiral", limit=2, task=task)
    assert evaluation.header["env"]["sensor"] == "stereo"
    assert "sensor perfect -> stereo" in evaluation.header["task_differs"]
    assert all(check.passed for check in replay_all(evaluation, embedded_file("single")))


def test_what_earlier_versions_wrote_was_seen_perfectly():
    task = json.loads(json.dumps(asdict(TaskConfig())))
    earlier = {name: value for name, value in task.items() if name not in LATER}
    assert task_from_json(TaskConfig, earlier) == TaskConfig()
    assert other_inputs({"env": earlier}, {"env": task}) == ()
    assert other_inputs({"env": earlier}, {"env": {**task, "sensor": "harsh"}}) == ("env",)
    with pytest.raises(MechSearchError, match="unknown sensor 'x'; choose one of perfect, stereo"):
        TaskConfig(sensor="x")


ASIDE = "35 0.9 320x240"


def test_what_is_mounted_aside_sees_the_heap_in_the_view_of_the_policy(covered, boxes):
    """What both views see is the same to a few millimetres, and all that is true is the same."""
    above, true = episode(make(covered, boxes, "perfect"), options=FIXED)
    aside, also = episode(make(covered, boxes, "perfect", mounted=ASIDE), options=FIXED)
    assert also == true
    for right, obs in zip(above, aside, strict=True):
        off = np.abs(obs["depth"].astype(float) - right["depth"])
        assert (obs["depth"] > 0).all()
        assert off.max() > 0
        assert (off < 0.003).mean() > 0.9
        for key in (*PRIVILEGED_KEYS, "ee_position"):
            np.testing.assert_array_equal(obs[key], right[key])
        both = (obs["position_image"] != 0) & (right["position_image"] != 0)
        assert both.any()
        # The cube stands half under a slab, whose other side is seen from here.
        apart = np.abs(obs["position_image"].astype(float) - right["position_image"])[both]
        assert np.median(apart) < 0.01


@pytest.mark.parametrize("sensor", WRONG)
def test_a_mounted_sensor_sees_an_episode_again_also_from_a_snapshot(covered, boxes, sensor):
    env, other = (make(covered, boxes, sensor, mounted=ASIDE) for _ in range(2))
    seen, _ = episode(env, seed=5)
    env.reset(seed=5)
    env.step(ACTIONS[0])
    later = [other.restore(env.snapshot()), *(other.step(action)[0] for action in ACTIONS[1:])]
    assert as_bytes(later) == as_bytes(seen[1:])


@pytest.mark.parametrize("sensor", WRONG)
def test_images_from_a_mounted_sensor_keep_fewer_holes_than_are_refused(sensor):
    # A time-of-flight camera measures nothing that is nearer than half a metre.
    distance = 0.7 if sensor == "time-of-flight" else 0.6
    env = HeapEnv(*_heaps(), HeapEnvConfig(sensor=sensor, mounted=f"50 {distance} 640x480"))
    for heap in range(2):
        env.reset(options={"heap": heap, "fixed_start": True})
        scene = env._scene
        depth, *_ = scene.sense(preset("overhead"), 0, scene.poses, None, lambda f: f.modal(0))
        assert (depth == 0).mean() < MOST_HOLES


def test_the_table_tells_most_of_a_mounted_cameras_error(covered, boxes):
    env = make(covered, boxes, "harsh", mounted="35 0.9 640x480")
    env.reset(options=FIXED)
    scene, believed = env._scene, mounted("35 0.9 640x480", "overhead")
    real = scene._sensing.camera(believed)
    frame = scene.renderer.frame(real, scene.poses)
    expected = believed.back_project(frame.depth)[frame.modal(1)].mean(axis=0)
    true = real.back_project(frame.depth)[frame.modal(1)].mean(axis=0)
    view = preset("overhead", 256)
    depth, mask, _ = scene.sense(view, 0, scene.poses, None, lambda f: f.modal(1))
    seen = view.back_project(depth)[mask & (depth > 0)].mean(axis=0)
    assert np.linalg.norm(seen - true) < 0.5 * np.linalg.norm(expected - true)


def test_what_policies_see_is_held_against_the_table(covered, boxes):
    """Heights, which a sensor's scale and a camera's tilt put out, are those above the table."""
    sees, heights = preset("overhead"), {True: [], False: []}
    env = make(covered, boxes, "stereo")
    for seed in range(8):
        env.reset(seed=seed)
        scene = env._scene
        for level in heights:
            depth, mask, _ = scene.sense(
                sees, 0, scene.poses, None, lambda f: f.modal(1), level=level
            )
            assert mask.dtype == np.bool_
            points = sees.back_project(depth)[depth > 0]
            table = points[np.abs(points[:, 2]) < 0.02, 2]
            heights[level].append(abs(np.median(table)))
    assert max(heights[True]) < 0.0008 < np.mean(heights[False])


def test_colours_are_reprojected_too(covered, boxes):
    env = make(covered, boxes, "perfect", mounted=ASIDE, keys=("rgb", "depth"))
    right = make(covered, boxes, "perfect", keys=("rgb", "depth"))
    seen, expected = (each.reset(options=FIXED)[0]["rgb"] for each in (env, right))
    assert (np.abs(seen.astype(int) - expected).max(axis=0) < 8).mean() > 0.9


def test_a_mounted_evaluation_is_kept_and_verified(tmp_path):
    task = TaskConfig(mounted=ASIDE, max_actions=2)
    evaluation = evaluate("teacher-spiral", limit=1, task=task)
    assert evaluation.header["env"]["mounted"] == ASIDE
    assert f"mounted  -> {ASIDE}" in evaluation.header["task_differs"]
    assert all(check.passed for check in replay_all(evaluation, embedded_file("single")))


def test_retrieval_is_not_seen_from_aside():
    with pytest.raises(MechSearchError, match=r"mounted is '35 0\.9 320x240'; expected nothing"):
        RetrieveConfig(mounted=ASIDE)


def test_an_episode_goes_on_where_most_of_an_image_is_holes_and_not_where_all_is(covered, boxes):
    """The table is out of this camera's range, which no camera of a robot may lose."""
    env = make(covered, boxes, "perfect farthest=0.99")
    env.reset(seed=0)
    depth = env.step(np.zeros(3))[0]["depth"]
    assert 0 < depth.min() <= depth.max() < 0.99
    with pytest.raises(MechSearchError, match="no depth, 0 or not finite, in 100% of its pixels"):
        make(covered, boxes, "perfect farthest=0.5").reset(seed=0)


def test_images_made_on_demand_are_the_same_ones_and_none_of_a_later_state(covered, boxes):
    keys = ("depth", "position_image", "ee_position")
    envs = [make(covered, boxes, "stereo", keys=keys) for _ in range(2)]
    assert not HeapEnv.on_demand
    envs[1].on_demand = True
    for env in envs:
        env.reset(options=FIXED)
    for action in ACTIONS:
        right, late = (env.step(action)[0] for env in envs)
        assert set(late) == set(right)
        assert len(late) == len(right)
        # Not all of these images are read, which changes nothing of the others.
        for key in right if action[2] <= 0 else keys[2:]:
            np.testing.assert_array_equal(late[key], right[key])
    assert set(late.only(keys[1:])) == set(keys[1:])
    part = late.only(keys[1:])
    np.testing.assert_array_equal(part["position_image"], right["position_image"])
    assert dict(part).keys() == set(keys[1:])
    with pytest.raises(KeyError):
        part["depth"]
    envs[1].reset(options=FIXED)
    passed = envs[1].step(ACTIONS[0])[0]
    envs[1].step(ACTIONS[1])
    assert passed["ee_position"].shape == (3,)
    with pytest.raises(MechSearchError, match="read before the next action"):
        passed["depth"]


def test_who_pushes_reads_images_only_where_a_push_is_chosen(monkeypatch):
    """And does the same as on images of every step."""
    heaps, objects = open_heaps(embedded_file("single"))
    looks = []
    sense = HeapScene.sense
    monkeypatch.setattr(HeapScene, "sense", lambda *a, **k: looks.append(1) or sense(*a, **k))
    records, counts = [], []
    policy = policy_named("uncover")
    env = HeapEnv(heaps.heaps, objects, HeapEnvConfig(sensor="stereo", keys=policy.keys))
    for on_demand in (True, False):
        monkeypatch.setattr(PushChooser, "on_demand", on_demand)
        records.append(run_episode(policy, env, heaps.choose("held-out", 1)[0]))
        counts.append(len(looks))
        looks.clear()
    assert not record_differences(*records)
    assert not env.on_demand
    assert counts[1] == len(records[0].actions) + 1
    assert counts[0] < 0.5 * counts[1]
