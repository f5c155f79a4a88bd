"""The same map over the machines of a Ray cluster; needs the `ray` extra."""

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import ray
from ray.exceptions import ActorDiedError, ActorUnavailableError, RayError, RayTaskError

from mechsearch.processes.mapping import Input, Ledger, Result, attempted, raise_failure
from mechsearch.processes.workers import START_LIMIT, STARTS, Failure
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
) -> Iterator[Result]:
    """Yield function(input) for each input, in order; `parallel.map_in_order` on a cluster.

    Workers are actors of one processor each. One that is lost, with its process or its machine, is
    replaced, and the input it was at is tried again.

    Args:
        function: Must pickle, and give the same result wherever it runs; files that it reads must
            be at the same place on every machine.
        inputs: Perhaps endless; at most a few for each worker are computed ahead.
        workers: Number of actors.
        time_limit: Time that one input may take [s].
        instead: Given an input that failed twice and its last failure, returns what is yielded in
            the result's place, or raises.

    Raises:
        MechSearchError: If no actor starts, or a machine has other versions.
    """
    ledger, shared = Ledger(inputs, instead), ray.put(function)
    needed = min(workers, len(inputs)) if isinstance(inputs, Sized) else workers
    seats = [_Seat.start(shared) for _ in range(needed)]
    try:
        while True:
            yield from ledger.due()
            for seat in seats:
                if seat.reply is None and (taken := ledger.take(4 * workers)):
                    seat.ask(*taken, time_limit)
            busy = [seat for seat in seats if seat.reply is not None]
            if not busy:
                return
            for seat in _answered(busy):
                number, value = seat.take()
                if isinstance(value, Failure) and value.error is None:
                    seats[seats.index(seat)] = _Seat.start(shared, seat)
                if number is not None:
                    ledger.settle(number, value)
    finally:
        for seat in seats:
            ray.kill(seat.actor)


class Hand:
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


_Actor: Any = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Hand)


@dataclass(eq=False)
class _Seat:
    """An actor, what it was asked, and until when it may take."""

    actor: Any
    reply: Any
    deadline: float
    number: int | None = None
    started: bool = False
    failed_starts: int = 0

    @classmethod
    def start(cls, function: Any, before: "_Seat | None" = None) -> "_Seat":
        """Return a new seat, perhaps in the place of one that was lost.

        Raises:
            MechSearchError: If too many in a row did not start.
        """
        failed = 0 if before is None or before.started else before.failed_starts + 1
        if failed == STARTS:
            raise MechSearchError(f"actors do not start on the Ray cluster, tried {STARTS} times")
        actor = _Actor.remote(function, os.getcwd())
        deadline = time.monotonic() + START_LIMIT
        return cls(actor, actor.versions.remote(), deadline, failed_starts=failed)

    def ask(self, number: int, item: Any, limit: float | None) -> None:
        """Have one input done."""
        self.number, self.reply = number, self.actor.answer.remote(item)
        self.deadline = float("inf") if limit is None else time.monotonic() + limit

    def take(self) -> tuple[int | None, Any]:
        """Return what was asked, and the result or failure; the seat is free then."""
        number, reply = self.number, self.reply
        self.number = self.reply = None
        if time.monotonic() >= self.deadline and not _is_ready(reply):
            ray.kill(self.actor)
            return number, Failure("worker hung")
        try:
            value = ray.get(reply)
        except (ActorDiedError, ActorUnavailableError):
            return number, Failure("worker died")
        except RayTaskError as error:
            return number, Failure.of(error)
        except RayError as error:
            return number, Failure(f"worker died: {type(error).__name__}")
        if not self.started:
            self.started = True
            _check(value)
        return number, value


def _answered(busy: list[_Seat]) -> list[_Seat]:
    """Wait until an actor has answered, is lost, or has used up its time."""
    first = min(seat.deadline for seat in busy)
    timeout = None if first == float("inf") else max(0.0, first - time.monotonic())
    ready, _ = ray.wait([seat.reply for seat in busy], timeout=timeout)
    late = time.monotonic()
    return [seat for seat in busy if seat.reply in ready or seat.deadline <= late]


def _is_ready(reply: Any) -> bool:
    return bool(ray.wait([reply], timeout=0)[0])


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
