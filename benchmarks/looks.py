"""`looks-...`: an action of `uncover`, whose images are made where it reads them."""

import time
from collections.abc import Iterator
from dataclasses import replace
from unittest.mock import patch

from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.policies import policy_named
from mechsearch.evaluation.rollout import run
from mechsearch.pushes.chooser import PushChooser

PEER = "an image after every action"
SEEN = {
    "perfect": HeapEnvConfig(),
    "stereo": HeapEnvConfig(sensor="stereo"),
    "stereo-segmenter": HeapEnvConfig(sensor="stereo", segmenter="shipped"),
}


def measure(settings: Settings) -> Iterator[Figure]:
    """Play the same episodes both ways, heap by heap in turns."""
    workload, policy = settings.workload, policy_named("uncover")
    heaps = [heap for count in (5, 10, 15) for heap in workload.heaps(count, settings.heaps)]
    for name, seen in SEEN.items():
        task = replace(seen, keys=policy.keys, camera=workload.heap_set.camera)
        env = HeapEnv(heaps, workload.object_set, task)
        seconds, actions = {True: 0.0, False: 0.0}, 0
        for index in range(len(heaps)):
            run(policy, env, [index])
            for on_demand in seconds:
                began = time.perf_counter()
                with patch.object(PushChooser, "on_demand", on_demand):
                    (record,) = run(policy, env, [index])
                seconds[on_demand] += time.perf_counter() - began
            actions += len(record.actions)
        ours, theirs = (1e3 * spent / actions for spent in seconds.values())
        settings.say(f"looks-{name}: {ours:.1f} ms an action, {theirs:.1f} ms by {PEER}")
        yield Figure(f"looks-{name}", ours, "ms", PEER, theirs)
