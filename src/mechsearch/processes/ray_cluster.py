"""The same map over the machines of a Ray cluster; needs the `ray` extra."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from typing import Any

import ray
from ray.exceptions import ActorDiedError, ActorUnavailableError, RayError, RayTaskError

from mechsearch.processes.mapping import Input, Ledger, Result, attempted, map_with, raise_failure
from mechsearch.processes.workers import START_LIMIT, STARTS, Asked, Failure, Reply, replies
from mechsearch.types import MechSearchError

SAME_EVERYWHERE = ("mechsearch", "mujoco-core", "numpy", "ray")
"""Packages whose versions must agree on all machines, or results would differ."""


@contextmanager
def connected(address: str = "", cpus: int | None = None) -> Iterator[int]:
    """Connect to a cluster, unless this process already is; yield how many processors it has.

    Args:
        address: Of the head node, such as "auto" or "ray://host:10001"; empty starts a cluster of
            this machine alone, which ends with the context.
        cpus: Processors of the cluster that is started; all of the machine by default.

    Raises:
        MechSearchError: If there is no cluster at the address.
    """
    if ray.is_initialized():
        yield _processors()
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        if address:
            ray.init(address, **quiet)
        else:
            ray.init("local", num_cpus=cpus, include_dashboard=False, **quiet)
    except (ConnectionError, ValueError, RuntimeError) as error:
        place = address or "this machine"
        raise MechSearchError(f"no Ray cluster at {place}: {error}") from None
    try:
        yield _processors()
    finally:
        ray.shutdown()


def _processors() -> int:
    resources: Callable[[], dict[str, float]] = ray.cluster_resources
    return max(1, int(resources().get("CPU", 1)))


def ray_map(
    function: Callable[[Input], Result],
    inputs: Iterable[Input],
    workers: int,
    time_limit: float | None = None,
    instead: Callable[[Input, Failure], Result] = raise_failure,
    held: int = 1,
) -> Iterator[Result]:
    """Map on a cluster; see `Mapper`.

    Workers are actors of one processor each, and hold one input each whatever `held` says. One that
    is lost, with its process or its machine, is replaced. Files that the function reads must be at
    the same place on every machine.

    Raises:
        MechSearchError: If no actor starts, or a machine has other versions.
    """
    start = partial(RayWorker, ray.put(function))
    yield from map_with(start, _replies, Ledger(inputs, instead), workers, time_limit, 1)


class RemoteFunction:
    """Does the work, on whichever machine."""

    def __init__(self, function: Callable[[Any], Any], folder: str) -> None:
        """Work in the folder of whoever asks, where there is one, so that relative paths hold."""
        self._function = function
        if os.path.isdir(folder):
            os.chdir(folder)
            sys.path.append(folder)

    def versions(self) -> dict[str, str]:
        """Return what is installed there."""
        return _versions()

    def answer(self, item: Any) -> Any:
        """Return the function's result, or its failure."""
        return attempted(self._function, item)


_Actor: Any = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(RemoteFunction)


class RayWorker:
    """An actor of the cluster, as `Worker` is a process of this machine.

    Attributes:
        asked: The request that it works on, if any.
        alive: Whether it may be asked; once it is not, it must be replaced.
        awaited: First its versions, then each answer.
        deadline: When it has used up its time, on the monotonic clock.
    """

    def __init__(self, function: Any, failed_starts: int = 0) -> None:
        """Start an actor.

        Args:
            function: What it does, put into the cluster.
            failed_starts: How many before it did not start.

        Raises:
            MechSearchError: If too many in a row did not.
        """
        if failed_starts == STARTS:
            raise MechSearchError(f"actors do not start on the Ray cluster, tried {STARTS} times")
        self._function, self._failed_starts = function, failed_starts
        self._actor = _Actor.remote(function, os.getcwd())
        self._started, self._answer = False, None
        self.asked: deque[Asked] = deque()
        self.alive = True
        self.awaited = self._actor.versions.remote()
        self.deadline = time.monotonic() + START_LIMIT

    def ask(self, key: int, request: Any, limit: float | None = None) -> None:
        """Have one input done."""
        self.asked.append(Asked(key, limit))
        self._answer = self._actor.answer.remote(request)
        if self._started:
            self._await_answer()

    def _await_answer(self) -> None:
        limit = self.asked[0].limit
        self.awaited = self._answer
        self.deadline = float("inf") if limit is None else time.monotonic() + limit

    def replace(self) -> "RayWorker":
        """Return a new worker in the place of this one."""
        return RayWorker(self._function, 0 if self._started else self._failed_starts + 1)

    def stop(self) -> None:
        """End the actor, whatever it does."""
        self.alive = False
        ray.kill(self._actor)

    def reply(self) -> Reply["RayWorker"] | None:
        """Return what there is to tell after a wait; None for an actor that has just started."""
        value: Any
        try:
            value = ray.get(self.awaited)
        except (ActorDiedError, ActorUnavailableError):
            return self.fail("worker died")
        except RayTaskError as error:
            value = Failure.of(error)
        except RayError as error:
            return self.fail(f"worker died: {type(error).__name__}")
        if not self._started:
            self._started = True
            _check(value)
            self._await_answer()
            return None
        return Reply(self, self.asked.popleft().key, value)

    def fail(self, reason: str) -> Reply["RayWorker"]:
        """End the actor; the request whose turn it was has failed."""
        self.stop()
        key = self.asked.popleft().key if self._started else None
        return Reply(self, key, Failure(reason))


def _replies(workers: Sequence[RayWorker]) -> Iterator[Reply[RayWorker]]:
    return replies(workers, lambda awaited, limit: ray.wait(awaited, timeout=limit)[0])


def _versions() -> dict[str, str]:
    return {name: version(name) for name in SAME_EVERYWHERE}


def _check(found: dict[str, str]) -> None:
    """Refuse a machine that would compute something else.

    Raises:
        MechSearchError: Naming the packages that differ.
    """
    here = _versions()
    other = [
        f"{name} {found[name]} (here {here[name]})" for name in here if found[name] != here[name]
    ]
    if other:
        raise MechSearchError(f"a machine of the Ray cluster has {', '.join(other)}")
