"""`grasp-score-15` and `grasp-lift-15`: a score by the network, and a lift, in 15-object heaps."""

import time
from collections.abc import Iterator

import numpy as np
import torch

from benchmarks import machine
from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.grasp.grasp_scene import view_of_heap
from mechsearch.grasp.graspability import rate
from mechsearch.grasp.network import load_network
from mechsearch.grasp.proposals import antipodal, uniform
from mechsearch.sim.lift import LiftWorld


def measure(settings: Settings) -> Iterator[Figure]:
    """Score targets on all cores, and lift them on one by geometric and by random grasps."""
    workload = settings.workload
    heaps = workload.heaps(15, 100 if settings.full else 3 * settings.heaps)
    network = load_network()
    torch.set_num_threads(machine.cores())
    rng = np.random.default_rng(0)
    scores: list[float] = []
    lifts: dict[str, list[float]] = {"antipodal": [], "uniform": []}
    for heap in heaps:
        models = workload.models(heap)
        view = view_of_heap(models, heap.poses, heap.target)
        if not view.mask.any():
            continue
        began = time.perf_counter()
        assert rate(network, view).graspability.visible
        scores.append(time.perf_counter() - began)
        world = LiftWorld(models)
        grasps = {"antipodal": antipodal(view, rng, 2, world.gripper)}
        grasps["uniform"] = uniform(view, rng, 2)
        for name, own in grasps.items():
            for grasp in own:
                began = time.perf_counter()
                world.lift(heap.poses, heap.target, grasp.pose(view.camera))
                lifts[name].append(time.perf_counter() - began)
    torch.set_num_threads(1)
    # The first score also pays for the choice of the convolutions' code.
    worst = float(np.percentile(scores[1:], 95))
    note = f"{len(scores) - 1} targets, all cores; 95 % within {1000 * worst:.0f} ms"
    yield Figure("grasp-score-15", 1000 * float(np.mean(scores[1:])), "ms", note=note)
    for name, times in lifts.items():
        worst = float(np.percentile(times, 95))
        note = f"{len(times)} {name} grasps, one core; 95 % within {1000 * worst:.0f} ms"
        yield Figure(f"grasp-lift-15-{name}", 1000 * float(np.mean(times)), "ms", note=note)
