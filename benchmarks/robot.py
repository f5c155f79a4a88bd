"""`robot-...`: decisions of exported policies beside PyTorch's, and whether they are the same."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env import HeapEnv, HeapEnvConfig, TaskConfig
from mechsearch.evaluation.policies import policy_named
from mechsearch.pushes.push import draw_pushes
from mechsearch.robot.policy import open_policy
from mechsearch.training.export import export_policy
from mechsearch.training.run_directory import save_policy, trained
from mechsearch.types import Observation

_SHAPES = {"depth": (1, 64, 64), "position_image": (3, 64, 64), "ee_position": (3,)}


def measure(settings: Settings) -> Iterator[Figure]:
    """Decide on what a random walk through heaps shows, by `uncover` and by an untrained actor."""
    workload, count = settings.workload, 1000 if settings.full else 100
    config = HeapEnvConfig(camera=workload.heap_set.camera)
    env = HeapEnv(workload.heaps(15, settings.heaps), workload.object_set, config)
    seen = _seen(env, count)
    uncover = policy_named("uncover")
    inner: Any = getattr(uncover, "policy", uncover)
    torch.manual_seed(0)
    actor = ActorPolicy(Actor(_SHAPES, NetworkConfig(directions=True, output_bound=0.5)))
    with TemporaryDirectory() as place:
        weights = Path(place, "actor.safetensors")
        save_policy(trained(actor, ActorCritic(), 0, TaskConfig()), weights)
        for name in ("uncover", str(weights)):
            export_policy(name, Path(place, Path(name).stem))
        carried: Any = open_policy(Path(place, "uncover"))
        own: Any = open_policy(Path(place, "actor"))
    same, apart = 0, 0.0
    for i, obs in enumerate(seen):
        candidates = draw_pushes(carried.candidates, np.random.default_rng(i))
        sight = inner.see(obs)
        expected, found = inner.judge(candidates, sight), carried.judge(candidates, sight)
        same += int(expected.argmax() == found.argmax())
        apart = max(apart, float(np.abs(expected - found).max()))
    note = f"values at most {apart:.1e} apart"
    settings.say(f"robot-same: {same} of {count}, {note}")
    yield Figure("robot-same", same / count, "of choices", note=note)
    for name, ours, theirs in (
        ("plus", _new_push(carried, carried.choose), _new_push(inner, inner.act)),
        ("method", own.choose, actor.act),
    ):
        found_ms, peer = (1e3 * _time(decide, seen[:100]) for decide in (ours, theirs))
        yield Figure(f"robot-{name}", found_ms, "ms", "PyTorch", peer)


def _seen(env: HeapEnv, count: int) -> list[Observation]:
    rng = np.random.default_rng(0)
    seen: list[Observation] = []
    while len(seen) < count:
        obs, over = env.reset(seed=len(seen))[0], False
        while not over and len(seen) < count:
            seen.append(obs)
            obs, _, ended, cut, _ = env.step(rng.uniform(-1, 1, 3).astype(np.float32))
            over = ended or cut
    return seen


def _new_push(policy: Any, decide: Callable[[Observation], Any]) -> Callable[[Observation], Any]:
    """Return decisions that each choose a new push."""

    def begun(obs: Observation) -> Any:
        policy.reset(np.random.default_rng(0))
        return decide(obs)

    return begun


def _time(decide: Callable[[Observation], Any], seen: list[Observation]) -> float:
    """Return the median time of a processor for a decision, in one thread [s]."""
    seconds = []
    for obs in seen:
        began = time.process_time()
        decide(obs)
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))
