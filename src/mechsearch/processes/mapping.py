"""Map a function over inputs in worker processes, results in the order of the inputs."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Generic, NoReturn, Protocol, TypeVar

from mechsearch.processes.workers import Crew, Failure, Reply, Worker, replies
from mechsearch.types import MechSearchError

Input = TypeVar("Input")
Result = TypeVar("Result")

PROCESSORS = (
    len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
)
"""Processors that this process may use."""

TRIES = 2
"""An input that fails on so many workers is not tried again."""


def raise_failure(item: object, failure: Failure) -> NoReturn:
    """Stop the whole map because of one input.

    Raises:
        Exception: What the function raised, if it did.
        MechSearchError: Naming the input whose workers died or hung.
    """
    if failure.error is not None:
        raise failure.error
    raise MechSearchError(
        f"{failure.reason}, {TRIES} times, on {item!r:.200}; perhaps for lack of memory: try fewer "
        "workers"
    )


class Mapper(Protocol):
    """How work is spread: by `map_in_order` on this machine, by `ray_cluster.ray_map` on many."""

    def __call__(
        self,
        function: Callable[[Input], Result],
        inputs: Iterable[Input],
        workers: int,
        time_limit: float | None = None,
        instead: Callable[[Input, Failure], Result] = raise_failure,
        held: int = 2,
    ) -> Iterator[Result]:
        """Yield function(input) for each input, in order, computed by `workers` processes.

        A worker that dies or hangs is replaced, and the input it was at is tried again; so is an
        input for which the function raised. What fails twice is handed to `instead`. A
        MechSearchError is bad input and stops the map at once.

        Args:
            function: Must pickle, and give the same result wherever it runs.
            inputs: Perhaps endless; at most a few for each worker are computed ahead.
            workers: Number of processes; one means this very process, where nothing can be killed.
            time_limit: Time that one input may take [s].
            instead: Given an input that failed twice and its last failure, returns what is yielded
                in the result's place, or raises.
            held: Inputs that a worker holds: the one it works on, and the next, so that it never
                waits; 1 for work of minutes, so that no input waits behind another.
        """


def map_in_order(
    function: Callable[[Input], Result],
    inputs: Iterable[Input],
    workers: int,
    time_limit: float | None = None,
    instead: Callable[[Input, Failure], Result] = raise_failure,
    held: int = 2,
) -> Iterator[Result]:
    """Map in processes of this machine; see `Mapper`."""
    ledger = Ledger(inputs, instead)
    if workers > 1:
        start = partial(Worker, partial(_same, function))
        yield from map_with(start, replies, ledger, workers, time_limit, held)
        return
    for number, item in iter(partial(ledger.take, 1), None):
        ledger.settle(number, attempted(function, item))
        yield from ledger.due()


def map_with(
    start: Callable[[], Crew],
    replies: Callable[[Sequence[Crew]], Iterator[Reply[Crew]]],
    ledger: "Ledger[Input, Result]",
    workers: int,
    time_limit: float | None,
    held: int,
) -> Iterator[Result]:
    """Yield the results of a ledger's inputs, computed by workers of any kind.

    Args:
        start: Starts one worker.
        replies: Waits until some of the busy workers have answered or failed.
        ledger: What is to be done.
        workers: As many are started as there is work for.
        time_limit: Time that one input may take [s].
        held: Inputs that a worker holds.
    """
    crew: list[Crew] = []
    try:
        while True:
            yield from ledger.due()
            while len(crew) < workers or any(len(worker.asked) < held for worker in crew):
                taken = ledger.take(4 * workers)
                if taken is None:
                    break
                if len(crew) < workers and all(worker.asked for worker in crew):
                    crew.append(start())
                min(crew, key=lambda worker: len(worker.asked)).ask(*taken, time_limit)
            busy = [worker for worker in crew if worker.asked]
            if not busy:
                return
            for worker, asked, value in replies(busy):
                if not worker.alive:
                    ledger.put_back(waiting.key for waiting in worker.asked)
                    crew[crew.index(worker)] = worker.replace()
                if asked is not None:
                    ledger.settle(asked, value)
    finally:
        for worker in crew:
            worker.stop()


def attempted(function: Callable[[Input], Result], item: Input) -> Result | Failure:
    """Return the result, or the failure that the function's exception is."""
    try:
        return function(item)
    except Exception as error:  # noqa: BLE001
        return Failure.of(error)


class Ledger(Generic[Input, Result]):
    """Keeps which inputs are to be done, were done, and may be handed out, in their order."""

    def __init__(
        self, inputs: Iterable[Input], instead: Callable[[Input, Failure], Result]
    ) -> None:
        """Begin with the first input."""
        self._source = enumerate(inputs)
        self._instead = instead
        self._items: dict[int, Input] = {}
        self._failures: dict[int, int] = {}
        self._again: deque[int] = deque()
        self._results: dict[int, Result | Failure] = {}
        self._due = 0

    def take(self, ahead: int) -> tuple[int, Input] | None:
        """Return the number and the input to do next.

        Args:
            ahead: Inputs that may be on their way or wait for an earlier one.

        Returns:
            None if there is none at present, because all are done or too many are on their way.
        """
        if self._again:
            number = self._again.popleft()
            return number, self._items[number]
        if len(self._items) >= ahead:
            return None
        taken = next(self._source, None)
        if taken is not None:
            self._items[taken[0]] = taken[1]
        return taken

    def put_back(self, numbers: Iterable[int]) -> None:
        """Have inputs done by another worker; they are not at fault."""
        self._again.extend(numbers)

    def settle(self, number: int, value: Result | Failure) -> None:
        """Keep a result, or have what failed done again unless it was bad input, or twice."""
        if not isinstance(value, Failure):
            self._results[number] = value
            return
        self._failures[number] = self._failures.get(number, 0) + 1
        if self._failures[number] < TRIES and not isinstance(value.error, MechSearchError):
            self._again.append(number)
        else:
            self._results[number] = value

    def due(self) -> Iterator[Result]:
        """Yield the results that all earlier ones have gone before, or what replaces them.

        Raises:
            MechSearchError: What the function raised about bad input.
        """
        while self._due in self._results:
            item, value = self._items.pop(self._due), self._results.pop(self._due)
            self._due += 1
            if not isinstance(value, Failure):
                yield value
            elif isinstance(value.error, MechSearchError):
                raise value.error
            else:
                yield self._instead(item, value)


def _same(function: Callable[[Input], Result]) -> Callable[[Input], Result]:
    return function
