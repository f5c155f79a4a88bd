"""Learning to retrieve, as an algorithm among others; `retrieve` is its name in the results."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mechsearch.algorithm import NamedTensors, RunConfig, TrainingSetup
from mechsearch.env.task import RetrievalTask, TaskConfig
from mechsearch.files import record_from_json
from mechsearch.files.tensors import filled, tensors_of
from mechsearch.retrieval_values.policy import RetrievePolicy, RetrievePolicyConfig
from mechsearch.retrieval_values.session import RetrievalValuesConfig, RetrievalValuesSession
from mechsearch.retrieval_values.value import RetrievalValue, RetrievalValueConfig
from mechsearch.types import RETRIEVAL_KEYS, MechSearchError


@dataclass(frozen=True)
class RetrievalValues(RetrievalValuesConfig):
    """Learning to retrieve; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What is seen in retrieval."""
        return RETRIEVAL_KEYS

    @property
    def teachers(self) -> tuple[str, ...]:
        """None: it needs no demonstrations."""
        return ()

    def check(self, task: TaskConfig) -> None:
        """Refuse a task that is no retrieval.

        Raises:
            MechSearchError: Saying so.
        """
        if not isinstance(task, RetrievalTask):
            raise MechSearchError(
                f"retrieval is learnt in a RetrievalTask, not in a {type(task).__name__}; "
                "begin from the variant retrieve, which has one"
            )

    def begin(
        self, run: RunConfig["RetrievalValues"], setup: TrainingSetup, folder: Path
    ) -> RetrievalValuesSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment is no retrieval.
        """
        return RetrievalValuesSession(run, setup, folder)

    def save(self, policy: RetrievePolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return the networks' weights, and all that deciding by them needs."""
        return tensors_of(policy.networks), {
            "network": asdict(policy.networks[0].config) if policy.networks else {},
            "networks": len(policy.networks),
            "policy": asdict(policy.config),
        }

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> RetrievePolicy:
        """Return the policy that `save` was given."""
        config = record_from_json(RetrievalValueConfig, facts["network"])
        return RetrievePolicy(
            filled([RetrievalValue(config) for _ in range(int(facts["networks"]))], tensors),
            record_from_json(RetrievePolicyConfig, facts["policy"]),
        )
