"""A hand-made heap: a green bar on a block, and episodes that push it about."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.objects.model import ObjectModel

MakeEvaluation = Callable[..., Evaluation]


def box(name: str, size: tuple[float, float, float], colour: tuple[int, int, int]) -> ObjectModel:
    mesh = trimesh.creation.box(size)
    vertices = np.asarray(mesh.vertices, np.float64)
    faces = np.asarray(mesh.faces, np.int32)
    texels = np.tile(np.array(colour, np.uint8), (len(faces), 1, 1))
    return ObjectModel(
        name, "block", vertices, faces, texels, (vertices,), 0.1, np.eye(3) * 1e-4, 0.5, 0.0, name
    )


@pytest.fixture(scope="session")
def models() -> dict[str, ObjectModel]:
    boxes = [
        box("lid", (0.12, 0.12, 0.02), (200, 60, 50)),
        box("block", (0.06, 0.06, 0.06), (70, 80, 190)),
        box("bar", (0.1, 0.03, 0.03), (230, 200, 60)),
    ]
    return {model.name: model for model in boxes}


def episode(seed: int, policy: str, gain: float, length: int = 8) -> EpisodeRecord:
    """The lid slides off the bar along x, by the more the greater the gain."""
    rng = np.random.default_rng(seed)
    slide = np.linspace(0, gain, length + 1)
    poses = np.zeros((length + 1, 3, 7))
    poses[..., 3] = 1
    poses[:, 0, :3] = np.stack([0.03 + 0.15 * slide, 0 * slide, 0 * slide + 0.045], axis=1)
    poses[:, 1, :3] = (-0.12, 0.1, 0.03)
    poses[:, 2, :3] = (0, 0, 0.015)
    ee = np.stack([-0.25 + 0.3 * slide, 0.05 * np.sin(6 * slide), 0 * slide + 0.04], axis=1)
    occlusions = np.clip(0.8 - slide, 0, 1)
    uncovered = bool(occlusions[-1] <= 0.02)
    return EpisodeRecord(
        heap_seed=seed,
        count=(5, 10, 15)[seed % 3],
        condition="single",
        policy=policy,
        objects=("lid", "block", "bar"),
        target=2,
        actions=rng.uniform(-1, 1, (length, 3)).astype(np.float32),
        ee_positions=ee,
        occlusions=occlusions,
        poses=poses,
        reward_terms={
            "visibility": -2.5 * np.diff(occlusions) + rng.normal(0, 0.05, length),
            "idleness": np.full(length, -0.5),
        },
        clutter_moved=0.5 * 0.15 * np.diff(slide),
        target_moved=np.zeros(length),
        end="uncovered" if uncovered else "action limit",
        action_limit=50,
    )


@pytest.fixture(scope="session")
def make_evaluation() -> MakeEvaluation:
    def make(name: str, gain: float, heaps: int = 12, **header: object) -> Evaluation:
        rng = np.random.default_rng(round(gain * 100))
        episodes = [
            episode(seed, name, max(0.0, gain + rng.normal(0, 0.1))) for seed in range(heaps)
        ]
        values = {"heap_set": "abc", "object_set": "household", "seed": 0, "training_actions": 0}
        return Evaluation(values | header, tuple(episodes))

    return make
