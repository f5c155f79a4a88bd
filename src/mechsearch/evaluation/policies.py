"""Policies by name: baselines, teachers, trained actors and users' own."""

import importlib
import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.entry_point import is_entry_point, load_entry_point
from mechsearch.evaluation.look_ahead import LookAheadPolicy
from mechsearch.evaluation.shipped import SHIPPED, card, shipped_file
from mechsearch.files import read_record
from mechsearch.files.layout import CONFIG_FILE
from mechsearch.teachers import TEACHERS, make_teacher
from mechsearch.types import MechSearchError, Observation, Policy

TRAINED_LOADER = "mechsearch.training.policies:load_policy"
"""Function that turns a run directory or an actor's file into a policy; needs the `learn` extra."""

LOOK_AHEAD = "look-ahead"
"""Plans in the simulator, and takes some seconds a heap; a ceiling rather than a baseline."""


class RandomPolicy:
    """Commands drawn uniformly from the action box.

    The environment projects each on the ball of 5 cm, so the longest push is the likeliest: the
    ball fills about half of the box.
    """

    keys: tuple[str, ...] = ("ee_position",)

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the coming actions from `rng`."""
        self._rng = rng

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return a command (3,) uniform in [-1, 1] along each axis."""
        return self._rng.uniform(-1, 1, 3).astype(np.float32)


class IdlePolicy:
    """Never moves."""

    keys: tuple[str, ...] = ("ee_position",)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin a new episode; there is nothing to draw."""

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the command (3,) that stays in place."""
        return np.zeros(3, np.float32)


def policy_names() -> tuple[str, ...]:
    """Return the names of the built-in baselines, which plan nothing."""
    return ("random", "idle", *(f"teacher-{name}" for name in TEACHERS))


def make_policy(spec: str) -> Policy:
    """Return the policy that a text names.

    Args:
        spec: "random", "idle", "look-ahead", or "teacher-" and a name in `teachers.TEACHERS`;
            "single" or "dual", the trained policies that are shipped; a run directory, whose last
            policy is meant, or one policy's file (.safetensors); or
            `package.module:factory`, a function without arguments, or a class, that returns a
            `mechsearch.types.Policy`.

    Raises:
        MechSearchError: If there is no such policy, or it cannot be made.
    """
    if spec == "random":
        return RandomPolicy()
    if spec == "idle":
        return IdlePolicy()
    if spec == LOOK_AHEAD:
        return LookAheadPolicy()
    if spec.startswith("teacher-") and spec.removeprefix("teacher-") in TEACHERS:
        return make_teacher(spec.removeprefix("teacher-"))
    if spec in SHIPPED:
        return _trained(shipped_file(spec))
    if _is_file_of_run(spec):
        return _trained(Path(spec))
    if is_entry_point(spec):
        return _checked(load_entry_point(spec, "policy")(), spec)
    known = ", ".join((*policy_names(), LOOK_AHEAD, *SHIPPED))
    raise MechSearchError(
        f"unknown policy {spec!r}; choose one of {known}, a run "
        "directory, an actor's file (.safetensors), or package.module:factory"
    )


def run_config(spec: str) -> Mapping[str, Any]:
    """Return the configuration of the run that a policy comes from; empty for others.

    A shipped policy goes by the name that it has on the command line.

    Raises:
        MechSearchError: If the configuration is damaged.
    """
    if spec in SHIPPED:
        return {**card(spec)["config"], "name": spec}
    if not _is_file_of_run(spec):
        return {}
    path = Path(spec)
    for folder in (path, path.parent, path.parent.parent):
        if (folder / CONFIG_FILE).is_file():
            return read_record(folder / CONFIG_FILE, "training configuration")
    return {}


def _is_file_of_run(spec: str) -> bool:
    return spec.endswith(".safetensors") or (bool(spec) and Path(spec).is_dir())


def _trained(path: Path) -> Policy:
    if not path.exists():
        raise MechSearchError(f"no actor at {path}")
    if importlib.util.find_spec("torch") is None:
        raise MechSearchError(f"the trained policy {path} needs PyTorch; install mechsearch[learn]")
    # Other numbers of threads give other bits, and scores must not depend on the workers.
    importlib.import_module("torch").set_num_threads(1)
    return _checked(load_entry_point(TRAINED_LOADER, "policy")(path), str(path))


def _checked(policy: object, spec: str) -> Policy:
    if not isinstance(policy, Policy):
        missing = [name for name in ("keys", "reset", "act") if not hasattr(policy, name)]
        raise MechSearchError(
            f"policy {spec!r} gives a {type(policy).__name__} without {', '.join(missing)}; "
            "a policy has keys, reset(rng) and act(obs)"
        )
    return policy
