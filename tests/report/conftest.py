"""Hand-made episodes in which a lid slides off a cube."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.objects.model import ObjectModel

MakeEvaluation = Callable[..., Evaluation]


@pytest.fixture(scope="session")
def models(boxes) -> Mapping[str, ObjectModel]:
    return boxes.models


def episode(seed: int, policy: str, gain: float, length: int = 8) -> EpisodeRecord:
    """The lid slides off the cube along x, by the more the greater the gain."""
    rng = np.random.default_rng(seed)
    slide = np.linspace(0, gain, length + 1)
    poses = np.zeros((length + 1, 3, 7))
    poses[..., 3] = 1
    poses[:, 0, :3] = np.stack([0.03 + 0.15 * slide, 0 * slide, 0 * slide + 0.07], axis=1)
    poses[:, 1, :3] = (-0.12, 0.1, 0.015)
    poses[:, 2, :3] = (0, 0, 0.03)
    ee = np.stack([-0.25 + 0.3 * slide, 0.05 * np.sin(6 * slide), 0 * slide + 0.04], axis=1)
    occlusions = np.clip(0.8 - slide, 0, 1)
    uncovered = bool(occlusions[-1] <= 0.02)
    return EpisodeRecord(
        heap_seed=seed,
        count=(5, 10, 15)[seed % 3],
        condition="single",
        policy=policy,
        objects=("lid", "small0", "cube"),
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
        values = {
            "name": name,
            "condition": "single",
            "heap_set": "abc",
            "object_set": "boxes",
            "split": "held-out",
            "seed": 0,
            "trained": False,
            "training_seed": None,
            "training_actions": 0,
        }
        return Evaluation(values | header, tuple(episodes))

    return make


@pytest.fixture(scope="session")
def evaluations(make_evaluation) -> dict[str, Evaluation]:
    trained = {"trained": True, "training_seed": 0, "training_actions": 3000}
    gains = {"teacher-straight": 0.75, "teacher-spiral": 0.9, "random": 0.3, "idle": 0.0}
    return {"method": make_evaluation("method", 0.7, **trained)} | {
        name: make_evaluation(name, gain) for name, gain in gains.items()
    }
