"""Learning what pushes bring, as an algorithm among others; `plus` is its name in the results."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mechsearch.algorithm import NamedTensors, RunConfig, TrainingSetup
from mechsearch.env.task import TaskConfig
from mechsearch.files import record_from_json
from mechsearch.files.tensors import filled, tensors_of
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.session import PushValuesConfig, PushValuesSession
from mechsearch.push_values.value import Continuation, PushValue, PushValueConfig
from mechsearch.types import ACTOR_KEYS


@dataclass(frozen=True)
class PushValues(PushValuesConfig):
    """Learning of whole pushes; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What the actor of the paper sees."""
        return ACTOR_KEYS

    @property
    def teachers(self) -> tuple[str, ...]:
        """None: it needs no demonstrations."""
        return ()

    def check(self, task: TaskConfig) -> None:
        """Take any task: pushes are seen in their own frame, under any camera."""

    def begin(
        self, run: RunConfig["PushValues"], setup: TrainingSetup, folder: Path
    ) -> PushValuesSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment has no heaps.
        """
        return PushValuesSession(run, setup, folder)

    def save(self, policy: PushPolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return the networks' weights, and all that choosing by them needs."""
        return tensors_of(policy.networks), {
            "network": asdict(policy.networks[0].config),
            "networks": len(policy.networks),
            "ahead": asdict(policy.continuation),
            "policy": asdict(policy.config),
        }

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> PushPolicy:
        """Return the policy that `save` was given."""
        # Earlier versions kept the cost of an action with the network.
        network = dict(facts["network"])
        own = {"idleness": network.pop("idleness")} if "idleness" in network else {}
        config = record_from_json(PushValueConfig, network)
        return PushPolicy(
            filled([PushValue(config) for _ in range(int(facts["networks"]))], tensors),
            record_from_json(Continuation, facts["ahead"]),
            record_from_json(PushPolicyConfig, {**own, **facts["policy"]}),
        )
