"""Map a function over inputs in worker processes, results in the order of the inputs."""

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Protocol, TypeVar

Input = TypeVar("Input")
Result = TypeVar("Result")


class Progress(Protocol):
    """Shown while something long goes on."""

    def __call__(self, label: str, done: int, total: int) -> None:
        """Tell that `done` of `total` pieces of `label` are finished."""


def silent(label: str, done: int, total: int) -> None:
    """Show nothing."""


def map_in_order(
    function: Callable[[Input], Result], inputs: Iterable[Input], workers: int
) -> Iterator[Result]:
    """Yield function(input) for each input, in order, computed by `workers` processes.

    The inputs may be endless; at most a few for each worker are computed ahead. One worker means
    this very process.
    """
    if workers <= 1:
        yield from map(function, inputs)
        return
    source = iter(inputs)
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        ahead: deque[Future[Result]] = deque()
        for item in source:
            ahead.append(pool.submit(function, item))
            if len(ahead) >= 4 * workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
