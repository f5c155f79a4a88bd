"""How much more graspable targets become, while a policy learns to uncover them."""

import numpy as np

from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.grasp.network import GraspNetwork
from mechsearch.grasp.quality import graspability
from mechsearch.grasp.standing import at_rest
from mechsearch.objects.model import ObjectSet
from mechsearch.types import Floats


class GraspabilityChange:
    """Rates the target of an episode at its start and at its end (paper, section IV-C)."""

    def __init__(self, network: GraspNetwork, objects: ObjectSet) -> None:
        """Choose whose judgement it is, and of which objects the heaps are."""
        self._network, self._models = network, objects.models
        # Every policy begins with the same heaps.
        self._first: dict[int, float] = {}

    def __call__(self, record: EpisodeRecord) -> float:
        """Return the graspability at the end, when all has come to rest, minus that of the heap."""
        if np.array_equal(record.poses[-1], record.poses[0]):
            return 0.0
        if record.heap_seed not in self._first:
            self._first[record.heap_seed] = self._rated(record, record.poses[0])
        models = [self._models[name] for name in record.objects]
        last = self._rated(record, at_rest(models, record.poses[-1]))
        return last - self._first[record.heap_seed]

    def _rated(self, record: EpisodeRecord, poses: Floats) -> float:
        models = [self._models[name] for name in record.objects]
        return graspability(self._network, models, poses, record.target).score
