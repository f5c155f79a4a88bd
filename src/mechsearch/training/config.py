"""All algorithms by name; configurations of runs: their file, and the paper's by name."""

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, cast

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.algorithm import Algorithm, RunConfig, Schedule
from mechsearch.entry_point import called, is_entry_point, load_entry_point
from mechsearch.env import RetrievalTask, TaskConfig, task_from_json
from mechsearch.files import read_record, record_from_json, write_record
from mechsearch.push_values.algorithm import PushValueConfig, PushValues
from mechsearch.retrieval_values.algorithm import RetrievalValues
from mechsearch.types import ACTOR_KEYS, RGB_ACTOR_KEYS, MechSearchError

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
    made: Any = called(load_entry_point(spec, "algorithm"), "algorithm", spec)
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


PURPOSE = "training configuration"

Run = RunConfig[Any]


_RETRIEVAL = Schedule(actions=2500, evaluate_every=500, checkpoint_every=500, validation_heaps=20)
"""Of `retrieve`, whose actions are dearer: at each decision many others are tried."""

_UNCOVER = Schedule(
    actions=80_000, evaluate_every=16_000, checkpoint_every=16_000, validation_heaps=0
)
"""Of `uncover`, which wants many heaps, and whose fits take as long as thousands of actions."""


def _presets() -> Mapping[str, Run]:
    base = ActorCritic()
    # Directions serve imitation; where there is nobody to imitate, the actor is the paper's.
    alone = replace(base.learner, network=NetworkConfig(centroid=True))
    # A spiral's next step follows from where the end effector is. That of a push through the
    # target does not, unless one knows from where it came, and the actor remembers nothing.
    drawn = NetworkConfig(directions=True, lengths=True, centroid=True)
    learner = replace(base.learner, imitation=10.0, mirrors=False, network=drawn)
    method = replace(base, imitated=("spiral",), learner=learner)
    ordinary = replace(alone, dropout=0.0, samples=1)
    # L = -Q alone, and the paper's actor: a tanh along each axis, no input of our own.
    printed = replace(base, learner=replace(base.learner, imitation=0.0, network=NetworkConfig()))
    debug = replace(method, warmup=20, learner=replace(method.learner, batch=8, samples=5))
    variants = {
        "method": method,
        "ddpg": replace(base, teachers=(), critic_keys=ACTOR_KEYS, learner=ordinary),
        "no-teachers": replace(base, teachers=(), learner=alone),
        "no-asymmetry": replace(method, critic_keys=ACTOR_KEYS),
        "no-pose-input": replace(method, actor_keys=RGB_ACTOR_KEYS),
        "plus": PushValues(),
        "as-printed": printed,
        "as-printed-no-teachers": replace(printed, teachers=()),
        "as-printed-no-asymmetry": replace(printed, critic_keys=ACTOR_KEYS),
        "as-printed-no-pose-input": replace(printed, actor_keys=RGB_ACTOR_KEYS),
        "debug": debug,
    }
    presets: dict[str, Run] = {name: RunConfig(name, made) for name, made in variants.items()}
    presets["retrieve"] = RunConfig(
        "retrieve", RetrievalValues(), task=RetrievalTask(), schedule=_RETRIEVAL
    )
    everywhere = PushValues(
        tries=4, searches=True, full_steps=True, value=PushValueConfig(epochs=6.0)
    )
    presets["uncover"] = RunConfig("uncover", everywhere, schedule=_UNCOVER)
    short = Schedule(actions=120, evaluate_every=60, checkpoint_every=60, validation_heaps=2)
    return presets | {"debug": replace(presets["debug"], schedule=short)}


PRESETS = _presets()
"""The method, its baseline and ablations (paper, section IV), `plus` (pushes), the paper's own loss
(`as-printed`) with its ablations, `retrieve` (pushes, removals and grasps), `uncover` (what `plus`
learns, for every heap), and `debug`."""


def run_config(name: str) -> Run:
    """Return the configuration of a preset, or the default one of an algorithm.

    Args:
        name: In `PRESETS` or `ALGORITHMS`, or `package.module:factory`.

    Raises:
        MechSearchError: If there is nothing of that name.
    """
    if name in PRESETS:
        return PRESETS[name]
    if name in ALGORITHMS or is_entry_point(name):
        return RunConfig(name.rpartition(":")[2], make_algorithm(name))
    known = ", ".join((*PRESETS, *ALGORITHMS))
    raise MechSearchError(
        f"unknown variant {name!r}; choose one of {known}, or package.module:factory"
    )


def save_config(config: Run, path: Path) -> None:
    """Write a configuration as JSON."""
    algorithm = {"kind": name_of(config.algorithm), **asdict(config.algorithm)}
    write_record(path, PURPOSE, {**asdict(config), "algorithm": algorithm})


def load_config(path: Path) -> Run:
    """Read a configuration, of this version or of an earlier one.

    Raises:
        MechSearchError: If the file is missing, damaged, or has unknown fields.
    """
    return config_from_json(read_record(path, PURPOSE, ("name", "seed")))


def config_from_json(found: Mapping[str, Any]) -> Run:
    """Return the configuration that JSON holds; see `load_config`."""
    if "algorithm" not in found:
        return _of_earlier_version(found)
    options = dict(found["algorithm"])
    kind: type[Any] = type(make_algorithm(str(options.pop("kind", ""))))
    return RunConfig(
        str(found["name"]),
        record_from_json(kind, options),
        int(found["seed"]),
        task_from_json(RetrievalTask if "grippers" in found["task"] else TaskConfig, found["task"]),
        record_from_json(Schedule, found["schedule"]),
    )


_RETIRED = {"horizon": 1, "target_action": "actor", "pessimism": 0.0, "bfloat16": False}
"""Options of earlier versions, and the value that each has now."""


def _of_earlier_version(found: Mapping[str, Any]) -> Run:
    """Return a configuration that stood flat in its file, with the options of both algorithms."""
    parts = (ActorCritic, TaskConfig, Schedule)
    known = {"name", "seed", "pushes", *(f.name for kind in parts for f in fields(kind))}
    if unknown := sorted(set(found) - known):
        raise MechSearchError(f"a configuration without an algorithm has no {', '.join(unknown)}")
    pushes = dict(found.get("pushes", {"networks": 0}))
    made: ActorCritic | PushValues
    if pushes["networks"]:
        pushes["candidates"] = pushes.pop("policy")["candidates"]
        made = record_from_json(PushValues, pushes, {"idleness": TaskConfig().reward.idleness})
    else:
        made = record_from_json(ActorCritic, _own(ActorCritic, found), _RETIRED)
    return RunConfig(
        str(found["name"]),
        made,
        int(found["seed"]),
        task_from_json(TaskConfig, _own(TaskConfig, found)),
        record_from_json(Schedule, _own(Schedule, found)),
    )


def _own(kind: type[Any], found: Mapping[str, Any]) -> dict[str, Any]:
    return {f.name: found[f.name] for f in fields(kind) if f.name in found}
