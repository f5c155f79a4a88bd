"""A run directory: configuration, trained policies of any algorithm, last two checkpoints."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.algorithm import Algorithm, NamedTensors, RunConfig
from mechsearch.env import TaskConfig
from mechsearch.evaluation.policies import Equipped, goal_of
from mechsearch.files import (
    CHECKPOINTS_FOLDER,
    CONFIG_FILE,
    POLICIES_FOLDER,
    POLICY_FILE,
    differing_fields,
)
from mechsearch.files.tensors import Archive, kind_of, load_archive, save_archive
from mechsearch.training.config import load_config, make_algorithm, name_of, save_config
from mechsearch.types import Array, MechSearchError, Observation, Policy, Weighed

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

    @property
    def on_demand(self) -> bool:
        """Whether it reads images only where it needs them, before it acts."""
        return getattr(self.policy, "on_demand", False)

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

    @property
    def weighed(self) -> Weighed | None:
        """What the last action was chosen among, if the policy tells; see `Weighed`."""
        return getattr(self.policy, "weighed", None)


def trained(policy: Policy, algorithm: Algorithm, actions: int, task: TaskConfig) -> TrainedPolicy:
    """Return a policy with what is known of its training."""
    return TrainedPolicy(policy, algorithm, actions, task.camera, task.image_size)


def save_policy(trained: TrainedPolicy, path: str | Path, rounded: bool = False) -> None:
    """Write a policy to a safetensors file that `load_policy` needs nothing beside.

    Args:
        trained: The policy.
        path: Where to.
        rounded: Whether to round its weights to 16 bits, which halves the file.
    """
    tensors, facts = trained.algorithm.save(trained.policy)
    if rounded:
        tensors = {n: t.half() if t.is_floating_point() else t for n, t in tensors.items()}
    known: dict[str, Any] = {
        "training_actions": trained.training_actions,
        "camera": trained.camera,
        "image_size": trained.image_size,
    }
    name = name_of(trained.algorithm)
    save_archive(Path(path), Archive(POLICY_KINDS.get(name, name), tensors, {**facts, **known}))


def load_policy(path: str | Path) -> TrainedPolicy:
    """Read a policy written by `save_policy`.

    Args:
        path: The file, or a run directory, whose last policy is meant.

    Raises:
        MechSearchError: If the file is missing, damaged or holds something else.
    """
    path = Path(path)
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


CHECKPOINT_KIND = "mechsearch checkpoint"
CHECKPOINT_FORMAT = 2
"""With the running episode; the first format had none."""

_KEPT = 2


class RunDirectory:
    """A run's files: `config.json`, `checkpoints/`, `actors/` and `actor.safetensors`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, config: RunConfig[Any], resume: bool) -> Archive | None:
        """Prepare the directory; return the last checkpoint when resuming.

        Raises:
            MechSearchError: If it holds a run and `resume` is off, a run of another configuration
                or of more actions, or a damaged or older checkpoint.
        """
        file = self.path / CONFIG_FILE
        if not file.exists():
            save_config(config, file)
            return None
        if not resume:
            raise MechSearchError(f"{self.path} holds a run already; resume it or name another")
        _check_same(load_config(file), config, self.path)
        found = self._checkpoints()
        checkpoint = _load(found[-1]) if found else None
        if (
            checkpoint
            and config.schedule.actions
            and checkpoint.meta["step"] > config.schedule.actions
        ):
            raise MechSearchError(
                f"{self.path} has executed {checkpoint.meta['step']} actions already; expected "
                f"--actions of at least as many, not {config.schedule.actions}"
            )
        save_config(config, file)
        return checkpoint

    def save(
        self,
        step: int,
        tensors: NamedTensors,
        meta: Mapping[str, Any],
        logged: int,
    ) -> None:
        """Write a checkpoint and drop all but the last two.

        Args:
            step: How far the run is.
            tensors: What to keep.
            meta: Likewise, as JSON.
            logged: Length of the metrics then [bytes]; see `RunLog`.
        """
        path = self.path / CHECKPOINTS_FOLDER / f"step-{step:08d}.safetensors"
        facts = {"checkpoint": CHECKPOINT_FORMAT, "step": step, "logged": logged, **meta}
        save_archive(path, Archive(CHECKPOINT_KIND, tensors, facts))
        for old in self._checkpoints()[:-_KEPT]:
            old.unlink()

    @property
    def kept(self) -> int:
        """Actions executed up to the last checkpoint; 0 if there is none yet."""
        return max((int(path.stem.partition("-")[2]) for path in self._checkpoints()), default=0)

    def save_policy(self, step: int, policy: TrainedPolicy) -> None:
        """Write the policy as it is now, both by step and as the run's last."""
        for path in (f"{POLICIES_FOLDER}/step-{step:08d}.safetensors", POLICY_FILE):
            save_policy(policy, self.path / path)

    def _checkpoints(self) -> list[Path]:
        return sorted((self.path / CHECKPOINTS_FOLDER).glob("step-*.safetensors"))


def _load(path: Path) -> Archive:
    checkpoint = load_archive(path, CHECKPOINT_KIND)
    found = checkpoint.meta.get("checkpoint", 1)
    if found != CHECKPOINT_FORMAT:
        raise MechSearchError(
            f"{path} is a checkpoint of format {found}; this version goes on from format "
            f"{CHECKPOINT_FORMAT}. Finish the run with the version that began it, or begin it anew "
            "in another folder"
        )
    return checkpoint


def _check_same(stored: RunConfig[Any], given: RunConfig[Any], path: Path) -> None:
    longer = replace(stored.schedule, actions=given.schedule.actions)
    differing = differing_fields(replace(stored, schedule=longer), given)
    if differing:
        name, before, now = differing[0]
        raise MechSearchError(
            f"{path} holds a run with another {', '.join(name for name, *_ in differing)}: {name} "
            f"was {before} and is {now}; only actions may change"
        )
