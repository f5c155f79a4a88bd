"""Checkpoints of a run: everything that going on needs, in one file, the last two kept."""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from mechsearch.files.layout import CONFIG_FILE, POLICY_FILE
from mechsearch.files.tensors import Archive, load_archive, save_archive
from mechsearch.train.config import TrainConfig, load_config, save_config
from mechsearch.train.trained import Trained, save_policy
from mechsearch.types import MechSearchError

KIND = "mechsearch checkpoint"
FORMAT = 2
"""With the running episode; the first format had none."""

_KEPT = 2


class RunDirectory:
    """A run's files: `config.json`, `checkpoints/`, `actors/` and `actor.safetensors`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, config: TrainConfig, resume: bool) -> Archive | None:
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
        if checkpoint and config.actions and checkpoint.meta["step"] > config.actions:
            raise MechSearchError(
                f"{self.path} has executed {checkpoint.meta['step']} actions already; expected "
                f"--actions of at least as many, not {config.actions}"
            )
        save_config(config, file)
        return checkpoint

    def save(
        self,
        step: int,
        tensors: Mapping[str, Tensor],
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
        path = self.path / "checkpoints" / f"step-{step:08d}.safetensors"
        facts = {"checkpoint": FORMAT, "step": step, "logged": logged, **meta}
        save_archive(path, Archive(KIND, tensors, facts))
        for old in self._checkpoints()[:-_KEPT]:
            old.unlink()

    def save_actor(self, step: int, policy: Trained) -> None:
        """Write the policy as it is now, both by step and as the run's last."""
        for path in (f"actors/step-{step:08d}.safetensors", POLICY_FILE):
            save_policy(policy, self.path / path)

    def _checkpoints(self) -> list[Path]:
        return sorted((self.path / "checkpoints").glob("step-*.safetensors"))


def _load(path: Path) -> Archive:
    checkpoint = load_archive(path, KIND)
    found = checkpoint.meta.get("checkpoint", 1)
    if found != FORMAT:
        raise MechSearchError(
            f"{path} is a checkpoint of format {found}; this version goes on from format {FORMAT}. "
            "Finish the run with the version that began it, or begin it anew in another folder"
        )
    return checkpoint


def _check_same(stored: TrainConfig, given: TrainConfig, path: Path) -> None:
    before, after = asdict(replace(stored, actions=given.actions)), asdict(given)
    differing = [name for name in after if before[name] != after[name]]
    if differing:
        name = differing[0]
        raise MechSearchError(
            f"{path} holds a run with another {', '.join(differing)}: {name} was {before[name]} "
            f"and is {after[name]}; only actions may change"
        )


def generator_state(rng: np.random.Generator) -> str:
    """Return a NumPy generator's state as text."""
    return json.dumps(rng.bit_generator.state)


def restore_generator(rng: np.random.Generator, state: str) -> None:
    """Set a NumPy generator to a state from `generator_state`."""
    rng.bit_generator.state = json.loads(state)
