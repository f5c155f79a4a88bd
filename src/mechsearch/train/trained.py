"""Trained policies of any kind: written by a run, read by `evaluate` and `show`."""

from collections.abc import Callable
from pathlib import Path

from mechsearch.actor_critic.policy import KIND as ACTOR
from mechsearch.actor_critic.policy import ActorPolicy, load_actor, save_actor
from mechsearch.files.layout import POLICY_FILE
from mechsearch.files.tensors import kind_of
from mechsearch.push_values.policy import KIND as PUSHES
from mechsearch.push_values.policy import PushPolicy, load_push_policy, save_push_policy
from mechsearch.types import MechSearchError

Trained = ActorPolicy | PushPolicy


def save_policy(policy: Trained, path: Path) -> None:
    """Write a policy to a safetensors file that `load_policy` needs nothing beside."""
    if isinstance(policy, PushPolicy):
        save_push_policy(policy, path)
    else:
        save_actor(policy, path)


def load_policy(path: Path) -> Trained:
    """Read a policy written by `save_policy`.

    Args:
        path: The file, or a run directory, whose last policy is meant.

    Raises:
        MechSearchError: If the file is missing, damaged or holds something else.
    """
    file = path / POLICY_FILE if path.is_dir() else path
    loaders: dict[str, Callable[[Path], Trained]] = {ACTOR: load_actor, PUSHES: load_push_policy}
    kind = kind_of(file)
    if kind not in loaders:
        raise MechSearchError(f"{file} holds a {kind}; expected a {' or a '.join(loaders)}")
    return loaders[kind](file)
