"""Parts of a run from a heap set: environment, teachers and evaluators."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mechsearch.actor_critic.collector import Evaluator, Parts
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.evaluation.metrics import mean_interval, score
from mechsearch.evaluation.rollout import run
from mechsearch.grasp.network import load_network
from mechsearch.heaps.dataset import HeapSet
from mechsearch.heaps.heap import evenly_spread
from mechsearch.objects.model import ObjectSet
from mechsearch.teachers import make_teachers
from mechsearch.train.config import SHIPPED_NETWORK, TrainConfig
from mechsearch.train.graspability import GraspabilityChange
from mechsearch.types import MechSearchError, Policy


@dataclass(frozen=True)
class HeapEvaluator:
    """Scores a policy on some heaps, from each heap's own start.

    Attributes:
        env: The task, with the actor's observations only.
        heaps: Indices of the heaps.
        intervals: Whether to return the mean's confidence interval too.
        grasped: Returns the change in graspability of an episode's target, where it is measured.
    """

    env: HeapEnv
    heaps: tuple[int, ...]
    intervals: bool = False
    grasped: Callable[[EpisodeRecord], float] | None = None

    def __call__(self, policy: Policy) -> dict[str, float]:
        """Return the mean of every metric.

        With intervals, `<metric>_ci_low`, `<metric>_ci_high` and the number of `heaps` follow.
        """
        records = run(policy, self.env, self.heaps)
        scores = score(records)
        if self.grasped:
            scores["graspability_change"] = mean_interval([self.grasped(r) for r in records])
        found = {name: estimate.mean for name, estimate in scores.items()}
        if self.intervals:
            found |= {f"{name}_ci_low": estimate.ci_low for name, estimate in scores.items()}
            found |= {f"{name}_ci_high": estimate.ci_high for name, estimate in scores.items()}
            found["heaps"] = len(self.heaps)
        return found


def assemble(config: TrainConfig, heap_set: HeapSet, objects: ObjectSet) -> Parts:
    """Return the parts of a run on the training heaps of a set.

    Validation heaps are taken out of the training heaps, evenly over the object counts, the same
    ones for every configuration. Held-out heaps are watched only where the configuration asks.

    Raises:
        MechSearchError: If the set has too few heaps.
    """
    training = [i for i, heap in enumerate(heap_set.heaps) if not heap.held_out]
    held_out = [i for i, heap in enumerate(heap_set.heaps) if heap.held_out]
    validation = _some(training, config.validation_heaps, "validation")
    watched = _some(held_out, config.held_out_heaps, "held-out")
    learnt = [i for i in training if i not in set(validation)]
    if not learnt:
        raise MechSearchError(
            f"{len(training)} training heaps, of which {len(validation)} are kept for validation, "
            "leave none to learn on"
        )
    teachers = make_teachers()
    task = HeapEnvConfig(keys=config.actor_keys, camera=config.camera, image_size=config.image_size)
    env = HeapEnv(heap_set.heaps, objects, replace(task, privileged=True))
    quiet = HeapEnv(heap_set.heaps, objects, task)
    evaluators: dict[str, Evaluator] = {}
    if validation:
        evaluators["validation"] = HeapEvaluator(quiet, tuple(validation))
    if watched:
        grasped = _grasped(config, objects)
        evaluators["held_out"] = HeapEvaluator(quiet, tuple(watched), True, grasped)
    return Parts(env, learnt, {name: teachers[name] for name in config.teachers}, evaluators)


def _grasped(config: TrainConfig, objects: ObjectSet) -> GraspabilityChange | None:
    if not config.grasp_network:
        return None
    shipped = config.grasp_network == SHIPPED_NETWORK
    network = load_network(None if shipped else Path(config.grasp_network))
    return GraspabilityChange(network, objects)


def _some(heaps: list[int], count: int, what: str) -> list[int]:
    if count > len(heaps):
        raise MechSearchError(
            f"{count} {what} heaps asked for; the set has {len(heaps)} to take them from"
        )
    return [heaps[i] for i in evenly_spread(len(heaps), count)]
