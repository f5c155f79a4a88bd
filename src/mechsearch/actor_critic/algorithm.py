"""The paper's way of learning as an algorithm among others (section III)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.actor_critic.session import ActorCriticConfig, ActorCriticSession
from mechsearch.algorithm import NamedTensors, RunConfig, TrainingSetup
from mechsearch.env.task import TaskConfig
from mechsearch.files import record_from_json
from mechsearch.files.tensors import fill
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class ActorCritic(ActorCriticConfig):
    """An actor-critic guided by teachers; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What the actor sees."""
        return self.actor_keys

    def check(self, task: TaskConfig) -> None:
        """Refuse a view that does not turn as the task does.

        Raises:
            MechSearchError: If batches are to be turned under another camera than the overhead one.
        """
        if self.learner.symmetry and task.camera != "overhead":
            raise MechSearchError(
                f"learner.symmetry needs the overhead camera; the camera is {task.camera!r}: "
                "choose the other, or symmetry False"
            )

    def begin(
        self, run: RunConfig["ActorCritic"], setup: TrainingSetup, folder: Path
    ) -> ActorCriticSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment lacks a key, or the replay does not fit.
        """
        return ActorCriticSession(run, setup)

    def save(self, policy: ActorPolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return an actor's weights, and the shapes and sizes of its network."""
        actor = policy.actor
        # Pairs, since the order of the keys is the order of the heads' features.
        shapes = [[key, list(shape)] for key, shape in actor.shapes.items()]
        return dict(actor.state_dict()), {"shapes": shapes, "network": asdict(actor.config)}

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> ActorPolicy:
        """Return the actor that `save` was given, as a policy."""
        network = record_from_json(NetworkConfig, facts["network"], retired={"bfloat16": False})
        actor = Actor({key: tuple(shape) for key, shape in facts["shapes"]}, network)
        fill(actor, tensors)
        return ActorPolicy(actor)
