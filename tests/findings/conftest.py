"""Hand-made episodes in which a lid slides off a cube."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.env.decision import Decision
from mechsearch.evaluation.episodes import (
    EpisodeRecord,
    Evaluation,
    GraspRecord,
    RetrievalRecord,
    save_episodes,
)
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


GRASP = Decision.grasp([0, 0, 0.03, 1, 0, 0, 0])


def grasping(record: EpisodeRecord, *outcomes: str, pushes: int = 1) -> EpisodeRecord:
    """Return the episode as one of retrieval: pushes, and grasps that come to these outcomes."""
    decisions = [Decision.push([0, 0, 1])] * pushes + [GRASP] * len(outcomes)
    length, retrieved = len(decisions), outcomes[-1:] == ("success",)
    moved = record.clutter_moved[:length]
    held = tuple((record.target,) if outcome == "success" else () for outcome in outcomes)
    return replace(
        record,
        actions=np.array([decision.vector() for decision in decisions]),
        ee_positions=record.ee_positions[: length + 1],
        occlusions=record.occlusions[: length + 1],
        poses=record.poses[: length + 1],
        clutter_moved=moved,
        target_moved=record.target_moved[:length],
        reward_terms={"retrieved": np.eye(length)[-1] * retrieved, "clutter_movement": -moved},
        end="retrieved" if retrieved else "budget",
        retrieval=RetrievalRecord(("",) * pushes + outcomes, ((),) * pushes + held),
    )


@pytest.fixture(scope="session")
def make_retrieval(make_evaluation) -> MakeEvaluation:
    """Makes evaluations in which every second episode takes some attempts more, or fails."""

    def make(name: str, *outcomes: str, **header: object) -> Evaluation:
        evaluation = make_evaluation(name, 0.5, goal="retrieve", **header)
        env = {"grippers": ["jaws-85"]}
        episodes = tuple(
            grasping(record, *(outcomes if i % 2 else ("success",)))
            for i, record in enumerate(evaluation.episodes)
        )
        return Evaluation({**evaluation.header, "env": env}, episodes)

    return make


@pytest.fixture(scope="session")
def retrievals(make_retrieval, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of evaluations of retrieval."""
    folder = tmp_path_factory.mktemp("retrievals")
    slipping = "slipped", "slipped", "blocked", "slipped"
    for name, outcomes in {"persistent": ("missed", "success"), "weak": slipping}.items():
        save_episodes(folder / f"{name}.npz", make_retrieval(name, *outcomes))
    return folder


@pytest.fixture(scope="session")
def evaluations(make_evaluation) -> dict[str, Evaluation]:
    trained = {"trained": True, "training_seed": 0, "training_actions": 3000}
    gains = {"teacher-straight": 0.75, "teacher-spiral": 0.9, "random": 0.3, "idle": 0.0}
    return {"method": make_evaluation("method", 0.7, **trained)} | {
        name: make_evaluation(name, gain) for name, gain in gains.items()
    }


@pytest.fixture(scope="session")
def loose(evaluations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of evaluations that no plan ties together."""
    folder = tmp_path_factory.mktemp("loose")
    for name, evaluation in evaluations.items():
        save_episodes(folder / f"{name}.npz", evaluation)
    return folder


GRASPED = ("method", "ddpg")
"""Variants whose curves have graspability too, as a sweep makes them unless told otherwise."""

LEARNT = ("method", "plus", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input")

GAINS = {
    "single": {
        "method": 0.9,
        "plus": 0.2,
        "ddpg": 0.3,
        "no-teachers": 0.4,
        "no-asymmetry": 0.5,
        "no-pose-input": 0.9,
        "teacher-straight": 1.0,
        "teacher-zigzag": 1.05,
        "teacher-spiral": 1.1,
        "random": 0.3,
        "idle": 0.0,
    }
}
GAINS["dual"] = GAINS["single"] | {"method": 0.75, "no-pose-input": 0.4}


@pytest.fixture(scope="session")
def write_sweep(make_evaluation) -> Callable[..., Path]:
    """Writes a folder as a sweep does, of which the truth is known: how far the lid slides."""

    def write(
        folder: Path,
        gains: Mapping[str, Mapping[str, float]] = GAINS,
        seeds: int = 3,
        heaps: int = 30,
        grasps: bool = True,
    ) -> Path:
        plan = {"conditions": list(gains), "variants": list(LEARNT), "seeds": [*range(seeds)]}
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "sweep.json").write_text(json.dumps(plan))
        for condition, policies in gains.items():
            for name, gain in policies.items():
                for seed in range(seeds if name in LEARNT else 1):
                    _write_trial(folder / condition, name, gain + 0.01 * seed, seed, heaps, grasps)
        return folder

    def _write_trial(
        folder: Path, name: str, gain: float, seed: int, heaps: int, grasps: bool
    ) -> None:
        trained = name in LEARNT
        header = {"condition": folder.name}
        if trained:
            header |= {"trained": True, "training_seed": seed, "training_actions": 8000}
            _write_run(folder / "runs" / f"{name}-seed{seed}", name, gain, seed, grasps)
        evaluation = make_evaluation(name, gain, heaps, **header)
        episodes = tuple(
            replace(
                record,
                condition=folder.name,
                grasp=GraspRecord(0.1, 0.1 + 0.5 * record.clutter_moved.sum(), 0.9, "", "success")
                if grasps
                else None,
            )
            for record in evaluation.episodes
        )
        label = f"{name}-seed{seed}-8000" if trained else name
        save_episodes(
            folder / "evaluations" / f"{label}.npz", replace(evaluation, episodes=episodes)
        )

    def _write_run(folder: Path, name: str, gain: float, seed: int, grasps: bool) -> None:
        folder.mkdir(parents=True)
        (folder / "config.json").write_text(json.dumps({"name": name, "seed": seed}))
        lines = []
        for step in (0, 4000, 8000):
            score = {"reward": gain * step / 8000, "visibility_change": gain * step / 10000}
            score |= {"episode_actions": 50 - gain * step / 1000}
            if grasps and name in GRASPED:
                score |= {"graspability_change": gain * step / 20_000}
            lines.append({"step": step, "kind": "held_out", **score})
        if name == "plus":
            lines.append(
                {"step": 8000, "kind": "fit", "executed": 8000, "simulated": 90_000 + seed}
            )
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (folder / "metrics.jsonl").write_text(text)

    return write


@pytest.fixture(scope="session")
def sweep(write_sweep, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sweep(tmp_path_factory.mktemp("sweep") / "all")
