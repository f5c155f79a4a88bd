"""A task turned or mirrored under the overhead camera is the same task, on heaps of real shapes."""

from dataclasses import replace

import numpy as np
import pytest

import mechsearch
from mechsearch.camera import preset
from mechsearch.env.reward import terms
from mechsearch.geometry import quaternion_product, yaw_quaternion
from mechsearch.render.visibility import Body, occlusion

CAMERA = preset("overhead")
HEAPS = (0, 20, 40)


@pytest.fixture(scope="module", params=HEAPS)
def episode(request):
    """Models, target, states and rewards of a teacher's first pushes."""
    env = mechsearch.make_env("single", split="all", privileged=True)
    teacher = mechsearch.make_policy("teacher-zigzag")
    teacher.reset(np.random.default_rng(0))
    obs, _ = env.reset(options={"heap": request.param, "fixed_start": True})
    states, infos = [env.state], []
    for _ in range(12):
        obs, *_, info = env.step(teacher.act(obs))
        states.append(env.state)
        infos.append(info)
        if info["end"]:
            break
    assert infos[-1]["end"] in (None, "uncovered")
    models = [env.objects.models[name] for name in env.heap.objects]
    return models, env.heap.target, states, infos, env.config.reward


def turned(models, poses, quarters):
    """Return the scene turned by quarter turns about the vertical."""
    yaw = yaw_quaternion(quarters * np.pi / 2)
    x, y = poses[:, 0], poses[:, 1]
    places = [(x, y), (-y, x), (-x, -y), (y, -x)][quarters]
    return models, np.column_stack([*places, poses[:, 2], quaternion_product(yaw, poses[:, 3:])])


def mirrored(models, poses):
    """Return the scene seen in a mirror across x: shapes, places and rotations."""
    reflected = [
        replace(m, vertices=m.vertices * [-1, 1, 1], faces=m.faces[:, ::-1].copy()) for m in models
    ]
    # A reflection before and after turns an axis the other way about y and z.
    return reflected, poses * [-1, 1, 1, 1, 1, -1, -1]


def recomputed(scene, episode):
    """Return occlusions and reward terms of states that `scene` transforms."""
    models, target, states, infos, config = episode
    bodies = {}
    occlusions, all_poses = [], []
    for state in states:
        there, poses = scene(models, state.poses)
        if not bodies:
            bodies = [Body(model) for model in there]
        occlusions.append(occlusion(bodies, CAMERA, poses, target))
        all_poses.append(poses)
    rewards = []
    for i, info in enumerate(infos):
        moved = np.linalg.norm(all_poses[i + 1][:, :3] - all_poses[i][:, :3], axis=1)
        leaves = info["reward_terms"]["workspace"] < 0
        clutter = np.delete(moved, target)
        pair = occlusions[i], occlusions[i + 1]
        rewards.append(terms(*pair, clutter, moved[target], leaves, 0.02, config))
    return np.array(occlusions), rewards


def test_the_environments_rewards_are_those_of_its_states(episode):
    occlusions, rewards = recomputed(lambda models, poses: (models, poses), episode)
    _, _, states, infos, _ = episode
    np.testing.assert_array_equal(occlusions, [state.occlusion for state in states])
    assert len(np.unique(occlusions)) > 1
    for found, info in zip(rewards, infos, strict=True):
        assert found == pytest.approx(info["reward_terms"], abs=1e-9)


@pytest.mark.parametrize(
    "scene",
    [
        *(lambda m, p, k=k: turned(m, p, k) for k in (1, 2, 3)),
        mirrored,
        lambda m, p: turned(*mirrored(m, p), 1),
    ],
    ids=["quarter", "half", "three quarters", "mirror", "mirror and quarter"],
)
def test_a_turned_or_mirrored_heap_earns_the_same_rewards(episode, scene):
    straight, rewards = recomputed(lambda models, poses: (models, poses), episode)
    changed, others = recomputed(scene, episode)
    # Rays that graze an edge may fall on either side of it.
    np.testing.assert_allclose(changed, straight, atol=2e-3)
    for i, (one, other) in enumerate(zip(rewards, others, strict=True)):
        slack = 2.5 * 4e-3 / max(straight[i], 0.02)
        assert other.pop("uncovering") == pytest.approx(one.pop("uncovering"), abs=slack)
        assert other == pytest.approx(one, abs=1e-9)
