"""Where the time of an action goes: physics, rays, and everything else.

Every call into the two engines is timed where it happens. The limit of an action is these calls
alone: bare `mj_step`s and bare ray casts.
"""

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
from embreex.rtcore_scene import EmbreeScene

from benchmarks.results import Figure
from benchmarks.settings import Settings
from benchmarks.workload import Episode, Workload

_PHYSICS = ("mj_step", "mj_step1", "mj_step2")


@dataclass
class Stopwatch:
    """Adds up the time of calls.

    Attributes:
        seconds: In all.
        calls: How many.
        steps: Physics steps in them.
    """

    seconds: float = 0.0
    calls: int = 0
    steps: int = 0

    def timed(self, function: Callable[..., Any], steps: bool = False) -> Callable[..., Any]:
        """Return the function, timed; `steps` says whether it takes a number of physics steps."""

        def call(*values: Any, **options: Any) -> Any:
            began = time.perf_counter()
            result = function(*values, **options)
            self.seconds += time.perf_counter() - began
            self.calls += 1
            if steps:
                self.steps += values[2] if len(values) > 2 else options.get("nstep", 1)
            return result

        return call

    def taken(self) -> "Stopwatch":
        """Return what was added up, and begin again."""
        taken = replace(self)
        self.seconds, self.calls, self.steps = 0.0, 0, 0
        return taken


@dataclass(frozen=True)
class ActionTimes:
    """One action, split.

    Attributes:
        total: Of `HeapEnv.step` [s].
        physics: Calls of the physics engine.
        rays: Calls of the ray caster.
    """

    total: float
    physics: Stopwatch
    rays: Stopwatch


def measure(settings: Settings) -> Iterator[Figure]:
    """Split the actions of 15-object heaps, and print the split."""
    workload = settings.workload
    episodes = workload.episodes(workload.heaps(15, settings.heaps))
    everything: list[ActionTimes] = []
    moving: list[ActionTimes] = []
    for number, episode in enumerate(episodes):
        times = split(workload, episode)
        everything += times
        moving += [times[i] for i in episode.moving]
        settings.say(f"share: heap {number + 1} of {len(episodes)}")
    inside, outside = _proxy_cost()
    for title, rows in (("all actions", everything), ("actions that move an object", moving)):
        table = _table(rows, inside, outside)
        print(_text(f"{title} ({len(rows)})", rows, table))
        suffix = "" if rows is everything else "-moving"
        for part in ("physics", "rays", "everything else"):
            label = part.replace("everything else", "rest")
            yield Figure(f"action-15-{label}{suffix}", table[part], "ms", note=title)
        share = table["everything else"] / sum(table.values())
        yield Figure(f"action-15-outside-physics-and-rays{suffix}", share, "share", note=title)


def split(workload: Workload, episode: Episode) -> list[ActionTimes]:
    """Return the split of each action of an episode."""
    physics, rays = Stopwatch(), Stopwatch()
    with _timed_engines(physics, rays):
        env = workload.env([episode.heap])
        env.reset(options={"heap": 0, "fixed_start": True})
        env.step(episode.actions[0])
        env.reset(options={"heap": 0, "fixed_start": True})
        rows = []
        for action in episode.actions:
            physics.taken(), rays.taken()
            began = time.perf_counter()
            env.step(action)
            total = time.perf_counter() - began
            rows.append(ActionTimes(total, physics.taken(), rays.taken()))
    return rows


@contextmanager
def _timed_engines(physics: Stopwatch, rays: Stopwatch) -> Iterator[None]:
    """Put timed calls in place of the engines', wherever the package holds them."""

    class TimedScene(EmbreeScene):  # type: ignore[misc]
        run = rays.timed(EmbreeScene.run)

    swaps: dict[Any, Any] = {EmbreeScene: TimedScene}
    swaps |= {
        getattr(mujoco, name): physics.timed(getattr(mujoco, name), steps=True)
        for name in _PHYSICS
        if hasattr(mujoco, name)
    }
    _swap(swaps)
    _forget_scenes()
    try:
        yield
    finally:
        _swap({new: old for old, new in swaps.items()})
        _forget_scenes()


def _swap(swaps: Mapping[Any, Any]) -> None:
    names = [name for name in sys.modules if name.partition(".")[0] == "mechsearch"]
    for module in (mujoco, *(sys.modules[name] for name in names)):
        _swap_in(module, swaps)


def _swap_in(module: ModuleType, swaps: Mapping[Any, Any]) -> None:
    for name, value in list(vars(module).items()):
        for old, new in swaps.items():
            if value is old:
                setattr(module, name, new)


def _forget_scenes() -> None:
    """Have every object's scene built anew."""
    for name, module in list(sys.modules.items()):
        if name.startswith("mechsearch.render.") and hasattr(module, "body_of"):
            module.body_of.cache_clear()


def _proxy_cost(calls: int = 20_000) -> tuple[float, float]:
    """Return what a timed call adds to its stopwatch, and to the time around it [s]."""

    def nothing(*values: Any, **options: Any) -> None:
        del values, options

    watch = Stopwatch()
    call = watch.timed(nothing)
    began = time.perf_counter()
    for _ in range(calls):
        nothing(None, None, 1)
    bare = time.perf_counter() - began
    began = time.perf_counter()
    for _ in range(calls):
        call(None, None, 1)
    whole = time.perf_counter() - began
    return max(watch.seconds - bare, 0.0) / calls, max(whole - bare, 0.0) / calls


def _table(rows: list[ActionTimes], inside: float, outside: float) -> dict[str, float]:
    """Return the mean of each part of an action [ms], the clocks' own time taken out."""
    if not rows or not any(row.rays.calls for row in rows):
        raise SystemExit("no ray was seen: the environment casts them by another function now")
    physics = float(np.mean([r.physics.seconds - inside * r.physics.calls for r in rows]))
    rays = float(np.mean([r.rays.seconds - inside * r.rays.calls for r in rows]))
    calls = [r.physics.calls + r.rays.calls for r in rows]
    total = float(np.mean([r.total for r in rows])) - outside * float(np.mean(calls))
    parts = {"physics": physics, "rays": rays, "everything else": total - physics - rays}
    return {name: 1e3 * seconds for name, seconds in parts.items()}


def _text(title: str, rows: list[ActionTimes], table: Mapping[str, float]) -> str:
    total = sum(table.values())
    steps = np.mean([row.physics.steps for row in rows])
    casts = np.mean([row.rays.calls for row in rows])
    lines = [f"Where the time of an action goes, {title}:"]
    lines += [f"  {name:16s} {ms:7.2f} ms {ms / total:6.1%}" for name, ms in table.items()]
    lines.append(f"  {'total':16s} {total:7.2f} ms, {steps:.1f} steps, {casts:.1f} ray casts")
    return "\n".join(lines)
