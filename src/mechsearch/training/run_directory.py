"""A run directory: configuration, policies and checkpoints, of which the last two are kept."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mechsearch.algorithm import NamedTensors, RunConfig
from mechsearch.files import (
    CHECKPOINTS_FOLDER,
    CONFIG_FILE,
    POLICIES_FOLDER,
    POLICY_FILE,
    differing_fields,
)
from mechsearch.files.tensors import Archive, load_archive, save_archive
from mechsearch.training.config import load_config, save_config
from mechsearch.training.policies import TrainedPolicy, save_policy
from mechsearch.types import MechSearchError

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
