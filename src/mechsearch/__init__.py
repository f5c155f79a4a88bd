"""Teach robots to uncover a known object in a heap of unknown ones.

`make_env` (or `gymnasium.make` with "mechsearch/SingleHeap-v0" and "mechsearch/DualHeap-v0") gives
environments, `generate` and `load_heaps` heap sets, `load_object_set` objects, and `make_policy`
policies by name, file or function.
"""

from importlib.metadata import version

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.register import make_env, register
from mechsearch.evaluation.policies import make_policy
from mechsearch.heaps.dataset import load as load_heaps
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.objects.catalog import load_object_set
from mechsearch.types import MechSearchError, Policy

__version__ = version("mechsearch")
register()

__all__ = [
    "GenerateConfig",
    "HeapEnv",
    "HeapEnvConfig",
    "MechSearchError",
    "Policy",
    "generate",
    "load_heaps",
    "load_object_set",
    "make_env",
    "make_policy",
]
