"""All algorithms by name; one of a user's own is named `package.module:factory`."""

from dataclasses import is_dataclass
from typing import Any, cast

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.algorithm import Algorithm
from mechsearch.entry_point import is_entry_point, load_entry_point
from mechsearch.push_values.algorithm import PushValues
from mechsearch.retrieval_values.algorithm import RetrievalValues
from mechsearch.types import MechSearchError

ALGORITHMS: dict[str, type[Any]] = {
    "actor-critic": ActorCritic,
    "push-values": PushValues,
    "retrieval-values": RetrievalValues,
}

_NEEDED = ("keys", "teachers", "check", "begin", "save", "load")


def make_algorithm(spec: str) -> Algorithm:
    """Return an algorithm with its default options.

    Args:
        spec: A name in `ALGORITHMS`, or `package.module:factory`: a class, or a function without
            arguments, that gives a frozen dataclass with the methods of `algorithm.Algorithm`.

    Raises:
        MechSearchError: If there is no such algorithm, or it lacks something.
    """
    if spec in ALGORITHMS:
        built_in: Algorithm = ALGORITHMS[spec]()
        return built_in
    if not is_entry_point(spec):
        raise MechSearchError(
            f"unknown algorithm {spec!r}; choose one of {', '.join(ALGORITHMS)}, or "
            "package.module:factory"
        )
    made: Any = load_entry_point(spec, "algorithm")()
    missing = [name for name in _NEEDED if not hasattr(made, name)]
    if missing or not is_dataclass(made):
        raise MechSearchError(
            f"algorithm {spec!r} gives a {type(made).__name__} that "
            f"{'lacks ' + ', '.join(missing) if missing else 'is no dataclass'}; an algorithm is a "
            f"frozen dataclass of its options with {', '.join(_NEEDED)}"
        )
    return cast(Algorithm, made)


def name_of(algorithm: Algorithm) -> str:
    """Return the name under which `make_algorithm` finds an algorithm's kind again."""
    kind = type(algorithm)
    known = {built_in: name for name, built_in in ALGORITHMS.items()}
    return known.get(kind, f"{kind.__module__}:{kind.__qualname__}")
