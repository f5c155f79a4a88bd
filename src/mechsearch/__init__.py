"""Teach robots to uncover a known object in a heap of unknown ones.

`make_env` (or `gymnasium.make` with "mechsearch/SingleHeap-v0" and "mechsearch/DualHeap-v0") gives
environments, `make_retrieve_env` ("mechsearch/Retrieve-v0" and "mechsearch/RetrieveDual-v0") those
of retrieval, "mechsearch/BenchmarkUncoverSingle-v1" and its like the benchmark's,
`make_vector_env` (or `gymnasium.make_vec`) many of them in worker processes,
`generate` and `load_heaps` heap sets, `load_object_set` objects, `make_policy` policies by name,
file or function, `evaluate` their episodes, `train` runs of any algorithm (PyTorch), and
`CurveLogger` curves of any other learner. Each is imported when it is first used.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import gymnasium

from mechsearch.benchmark.protocol import environment_ids
from mechsearch.types import EXTRAS, check_extra

if TYPE_CHECKING:
    from mechsearch.env import (
        HeapEnv,
        HeapEnvConfig,
        RetrieveConfig,
        RetrieveEnv,
        RewardConfig,
        TaskConfig,
        make_env,
        make_retrieve_env,
    )
    from mechsearch.env.vector.vector_env import VectorHeapEnv, make_vector_env
    from mechsearch.evaluation.policies import make_policy
    from mechsearch.evaluation.rollout import evaluate
    from mechsearch.heaps.dataset import load_heaps
    from mechsearch.heaps.generate import GenerateConfig, generate
    from mechsearch.objects.catalog import load_object_set
    from mechsearch.training.config import run_config
    from mechsearch.training.curve_logger import CurveLogger
    from mechsearch.training.run import train
    from mechsearch.types import MechSearchError, Policy

_PLACES = {
    "CurveLogger": "training.curve_logger:CurveLogger",
    "GenerateConfig": "heaps.generate:GenerateConfig",
    "HeapEnv": "env.heap_env:HeapEnv",
    "HeapEnvConfig": "env.task:HeapEnvConfig",
    "MechSearchError": "types:MechSearchError",
    "Policy": "types:Policy",
    "RetrieveConfig": "env.task:RetrieveConfig",
    "RetrieveEnv": "env.retrieve_env:RetrieveEnv",
    "RewardConfig": "env.reward:RewardConfig",
    "TaskConfig": "env.task:TaskConfig",
    "VectorHeapEnv": "env.vector.vector_env:VectorHeapEnv",
    "evaluate": "evaluation.rollout:evaluate",
    "generate": "heaps.generate:generate",
    "load_heaps": "heaps.dataset:load_heaps",
    "load_object_set": "objects.catalog:load_object_set",
    "make_env": "env.heap_env:make_env",
    "make_retrieve_env": "env.retrieve_env:make_retrieve_env",
    "make_vector_env": "env.vector.vector_env:make_vector_env",
    "make_policy": "evaluation.policies:make_policy",
    "run_config": "training.config:run_config",
    "train": "training.run:train",
}

__version__ = version("mechsearch")
__all__ = [
    "CurveLogger",
    "GenerateConfig",
    "HeapEnv",
    "HeapEnvConfig",
    "MechSearchError",
    "Policy",
    "RetrieveConfig",
    "RetrieveEnv",
    "RewardConfig",
    "TaskConfig",
    "VectorHeapEnv",
    "evaluate",
    "generate",
    "load_heaps",
    "load_object_set",
    "make_env",
    "make_policy",
    "make_retrieve_env",
    "make_vector_env",
    "run_config",
    "train",
]

for _name, _condition in (("SingleHeap", "single"), ("DualHeap", "dual")):
    gymnasium.register(
        f"mechsearch/{_name}-v0",
        entry_point="mechsearch.env.heap_env:make_env",
        vector_entry_point="mechsearch.env.vector.vector_env:make_vector_env",
        kwargs={"condition": _condition},
    )
for _name, _arguments in environment_ids().items():
    gymnasium.register(
        _name,
        entry_point="mechsearch.benchmark.environment:make_benchmark_env",
        kwargs=_arguments,
    )
for _name, _condition in (("Retrieve", "single"), ("RetrieveDual", "dual")):
    gymnasium.register(
        f"mechsearch/{_name}-v0",
        entry_point="mechsearch.env.retrieve_env:make_retrieve_env",
        kwargs={"condition": _condition},
    )


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'mechsearch' has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    try:
        return getattr(import_module(f"mechsearch.{module}"), attribute)
    except ModuleNotFoundError as error:
        needed = [extra for extra, (_, library) in EXTRAS.items() if library == error.name]
        if not needed:
            raise
    return check_extra(f"mechsearch.{name}", needed[0])
