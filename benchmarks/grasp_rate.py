"""How long a lift and a score take: `python benchmarks/grasp_rate.py HEAPS OBJECTS NETWORK`.

Prints JSON: milliseconds of processor time, by number of objects in the heap, on one thread.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.grasp.network import load_network
from mechsearch.grasp.proposals import antipodal, uniform
from mechsearch.grasp.quality import graspability_of_view
from mechsearch.grasp.view import view_of_heap
from mechsearch.heaps.dataset import load, object_set
from mechsearch.sim.lift import LiftWorld


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Return what a function returns, and the processor time it took [ms]."""
    start = time.process_time()
    result = function(*arguments)
    return result, 1000 * (time.process_time() - start)


def main(heaps: str, objects: str, network: str) -> None:
    """Time views, scores and lifts on all heaps of a set, and print what was found."""
    torch.set_num_threads(1)
    known, judge = object_set(objects).models, load_network(Path(network))
    found: dict[int, dict[str, list[float]]] = {}
    rng = np.random.default_rng(0)
    for heap in load(Path(heaps)).heaps:
        models = [known[name] for name in heap.objects]
        row = found.setdefault(len(models), {})
        world = LiftWorld(models)
        for target in range(0, len(models), 3):
            view, spent = timed(view_of_heap, models, heap.poses, target)
            row.setdefault("view", []).append(spent)
            if not view.mask.any():
                continue
            row.setdefault("score", []).append(timed(graspability_of_view, judge, view)[1])
            grasps = {"lift, geometric": antipodal(view, rng, 2, world.gripper)}
            grasps["lift, uniform"] = uniform(view, rng, 2)
            for name, own in grasps.items():
                for grasp in own:
                    pose = grasp.pose(view.camera)
                    spent = timed(world.lift, heap.poses, target, pose)[1]
                    row.setdefault(name, []).append(spent)
    print(json.dumps({count: summary(row) for count, row in found.items()}, indent=2))


def summary(row: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Return mean, 95th percentile and number of each row's times."""
    return {
        name: {
            "mean": round(float(np.mean(t)), 1),
            "p95": round(float(np.percentile(t, 95)), 1),
            "n": len(t),
        }
        for name, t in row.items()
    }


if __name__ == "__main__":
    main(*sys.argv[1:])
