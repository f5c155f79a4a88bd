"""Trained policies of any algorithm: written by a run, read by `evaluate` and `show`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.algorithm import Algorithm
from mechsearch.env.task import TaskConfig
from mechsearch.evaluation.policies import goal_of
from mechsearch.evaluation.rollout import Equipped
from mechsearch.files import POLICY_FILE
from mechsearch.files.tensors import Archive, kind_of, load_archive, save_archive
from mechsearch.training.algorithms import make_algorithm, name_of
from mechsearch.types import Array, MechSearchError, Observation, Policy

POLICY_KINDS = {"actor-critic": "mechsearch actor", "push-values": "mechsearch push policy"}
"""What a file says that it is, where that is not the algorithm's own name."""


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy, with what is known of its training.

    Attributes:
        policy: What acts.
        algorithm: What it was learnt by.
        training_actions: Actions executed in its training.
        camera: View that it was trained with, if it is known.
        image_size: Side of its images [px], likewise.
    """

    policy: Policy
    algorithm: Algorithm
    training_actions: int = 0
    camera: str | None = None
    image_size: int | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """Observation keys that the policy reads."""
        return self.policy.keys

    @property
    def goal(self) -> str:
        """What it is after; see `evaluation.policies.goal_of`."""
        return goal_of(self.policy)

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers, if it retrieves."""
        if isinstance(self.policy, Equipped):
            self.policy.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self.policy.reset(rng)

    def act(self, obs: Observation) -> Array:
        """Return the policy's action (3,), or decision (9,)."""
        return self.policy.act(obs)


def trained(policy: Policy, algorithm: Algorithm, actions: int, task: TaskConfig) -> TrainedPolicy:
    """Return a policy with what is known of its training."""
    return TrainedPolicy(policy, algorithm, actions, task.camera, task.image_size)


def save_policy(trained: TrainedPolicy, path: Path) -> None:
    """Write a policy to a safetensors file that `load_policy` needs nothing beside."""
    tensors, facts = trained.algorithm.save(trained.policy)
    known: dict[str, Any] = {
        "training_actions": trained.training_actions,
        "camera": trained.camera,
        "image_size": trained.image_size,
    }
    name = name_of(trained.algorithm)
    save_archive(path, Archive(POLICY_KINDS.get(name, name), tensors, {**facts, **known}))


def load_policy(path: Path) -> TrainedPolicy:
    """Read a policy written by `save_policy`.

    Args:
        path: The file, or a run directory, whose last policy is meant.

    Raises:
        MechSearchError: If the file is missing, damaged or holds something else.
    """
    file = path / POLICY_FILE if path.is_dir() else path
    kind = kind_of(file)
    try:
        algorithm = make_algorithm({v: k for k, v in POLICY_KINDS.items()}.get(kind, kind))
    except MechSearchError as error:
        raise MechSearchError(
            f"{file} holds a {kind}; expected a trained policy: {error}"
        ) from None
    archive = load_archive(file, kind)
    facts = dict(archive.meta)
    # Earlier versions kept the view with policies of pushes alone.
    kept = {**facts.get("policy", {}), **facts}
    names = ("training_actions", "camera", "image_size")
    known = {name: kept[name] for name in names if name in kept}
    return TrainedPolicy(algorithm.load(archive.tensors, facts), algorithm, **known)
