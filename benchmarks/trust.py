"""`score-...`, `overlap-...`: whether larger steps and what is left out change what is measured."""

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.rollout import run_episode
from mechsearch.sim.scene import PhysicsConfig
from mechsearch.sim.world import World
from mechsearch.teachers import PAPER_TEACHERS, Teacher, make_teacher
from mechsearch.types import Floats, select

NOTHING_ASLEEP = replace(PhysicsConfig(), sleep_speed=0.0)
REFERENCE = replace(
    NOTHING_ASLEEP,
    time_step=0.0025,
    action_steps=60,
    rest_steps=28,
    clearance=float("inf"),
    stops_when_still=False,
)
"""Half the step, and nothing left out."""

PEER = "steps of 2.5 ms, nothing asleep or left out"


def measure(settings: Settings) -> Iterator[Figure]:
    """Score the teachers on 100 held-out heaps in both physics, and measure how bodies overlap."""
    numbers = (34, 33, 33) if settings.full else (12, 12, 12)
    workload = settings.workload
    heaps = [
        h for count, n in zip((5, 10, 15), numbers, strict=True) for h in workload.heaps(count, n)
    ]
    base = HeapEnvConfig(keys=("ee_position",), privileged=True, camera=workload.heap_set.camera)

    def env(physics: PhysicsConfig) -> HeapEnv:
        return HeapEnv(heaps, workload.object_set, replace(base, physics=physics))

    ours, reference = env(PhysicsConfig()), env(REFERENCE)
    for name in PAPER_TEACHERS:
        teacher = make_teacher(name)
        scores = np.array([_scores(one, teacher, len(heaps)) for one in (ours, reference)])
        difference = scores[0] - scores[1]
        half = 1.96 * float(difference.std(ddof=1)) / np.sqrt(len(heaps))
        low, high = float(difference.mean()) - half, float(difference.mean()) + half
        own = 1.96 * float(scores[1].std(ddof=1)) / np.sqrt(len(heaps))
        note = (
            f"{len(heaps)} heaps; difference {low:+.1f} to {high:+.1f} (95 %, paired), "
            f"where the mean itself is known to +-{own:.1f}"
        )
        settings.say(f"score-{name}: {scores.mean(axis=1).round(2)}, {note}")
        mean = scores.mean(axis=1)
        yield Figure(
            f"score-{name}", float(mean[0]), "reward", PEER, float(mean[1]), "neither", note
        )
    pushed, resting = _overlaps(env(NOTHING_ASLEEP), len(heaps))
    yield Figure("overlap-pushed", 1e3 * float(np.percentile(pushed, 99.9)), "mm", note="99.9 %")
    yield Figure("overlap-at-rest", 1e3 * float(np.percentile(resting, 99.9)), "mm", note="99.9 %")


def _scores(env: HeapEnv, teacher: Teacher, number: int) -> Floats:
    records = [run_episode(teacher, env, i) for i in range(number)]
    return np.array([sum(term.sum() for term in r.reward_terms.values()) for r in records])


def _overlaps(env: HeapEnv, number: int) -> tuple[Floats, Floats]:
    """Return the overlap [m] of all contacts after each action, and half a second after a reset."""
    pushed, resting = [], []
    teachers = [make_teacher(name) for name in PAPER_TEACHERS]
    for i in range(number):
        obs, _ = env.reset(options={"heap": i, "fixed_start": True})
        teacher = teachers[i % 3]
        teacher.reset(np.random.default_rng(i))
        world = cast(World, env.world)
        world.step(round(0.5 / env.config.physics.time_step))
        resting.append(world.penetrations())
        over = False
        while not over:
            obs, _, terminated, truncated, _ = env.step(teacher.act(select(obs, teacher.keys)))
            over = terminated or truncated
            pushed.append(world.penetrations())
    return np.concatenate(pushed), np.concatenate(resting)
