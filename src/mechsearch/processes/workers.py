"""A process of our own that answers requests in turn, and that may die, hang or fail."""

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

from mechsearch.types import MechSearchError

START_LIMIT = 300.0
"""A worker that has not started after this long hangs [s]; imports are slow on a busy machine."""

STARTS = 10
"""Starts in a row that may fail, because the process was killed or hung."""

EXITS = 3
"""Starts in a row that may fail because the process ended by itself, as it always will."""


@dataclass(frozen=True)
class Failure:
    """Why a request has no result.

    Attributes:
        reason: "worker died", "worker hung" or "worker raised: ...".
        error: What was raised, if anything.
    """

    reason: str
    error: Exception | None = None

    @classmethod
    def of(cls, error: Exception) -> "Failure":
        """Return the failure that an exception is; the exception keeps its own traceback's text."""
        text = "".join(traceback.format_exception(error))
        error.add_note(f"In the worker:\n{text}")
        return cls(f"worker raised: {type(error).__name__}: {error}", error)


class Asked(NamedTuple):
    """A request that is not yet answered: what it is known by, and its time limit [s]."""

    key: int
    limit: float | None


class MapWorker(Protocol):
    """What a map needs of a worker, wherever it is; see `Worker`."""

    asked: deque[Asked]
    alive: bool
    awaited: Any

    @property
    def deadline(self) -> float:
        """When it has used up its time, on the monotonic clock; infinite without a limit."""

    def ask(self, key: int, request: Any, limit: float | None = None) -> None:
        """Send a request."""

    def reply(self) -> "Reply[Self] | None":
        """Return what there is to tell once something is; None for one that has just started."""

    def fail(self, reason: str) -> "Reply[Self]":
        """End the process; the request whose turn it was has failed."""

    def replace(self) -> Self:
        """Return a new worker in the place of this one."""

    def stop(self) -> None:
        """End the process."""


Crew = TypeVar("Crew", bound=MapWorker)


class Reply(NamedTuple, Generic[Crew]):
    """What became of a request; `key` is None where a worker failed while nobody's turn it was."""

    worker: Crew
    key: int | None
    value: Any


class Worker:
    """A process that makes a function once, and then applies it to one request after another.

    Attributes:
        asked: Requests without a reply, the one that is being worked on first.
        alive: Whether it may be asked; once it is not, it must be replaced.
        awaited: What `replies` waits for.
    """

    def __init__(
        self, make: Callable[[], Callable[[Any], Any]], failed_starts: Sequence[int] = ()
    ) -> None:
        """Start the process, of this machine's `process_context`.

        Args:
            make: Called in the process; returns what answers the requests. Must pickle.
            failed_starts: Exit codes of the predecessors in a row that did not start.
        """
        context = process_context()
        self._make, self._failed_starts = make, tuple(failed_starts)
        self._started = False
        self.awaited, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(dict(os.environ), make, theirs), daemon=True
        )
        with _deaf(), _path_told():
            self._process.start()
        theirs.close()
        self.asked: deque[Asked] = deque()
        self.alive = True
        self._since = time.monotonic()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    @property
    def deadline(self) -> float:
        """When it has used up its time, on the monotonic clock; infinite without a limit."""
        if not self._started:
            return self._since + START_LIMIT
        limit = self.asked[0].limit if self.asked else None
        return float("inf") if limit is None else self._since + limit

    def ask(self, key: int, request: Any, limit: float | None = None) -> None:
        """Send a request.

        Args:
            key: Returned with the reply.
            request: Handed to the function; must pickle.
            limit: Time that the answer may take, from its turn on [s].
        """
        if self._started and not self.asked:
            self._since = time.monotonic()
        self.asked.append(Asked(key, limit))
        data = ForkingPickler.dumps(request)
        with suppress(OSError):  # If it has died since, the end of its pipe will say so.
            self.awaited.send_bytes(data)

    def reply(self) -> "Reply[Worker] | None":
        """Return what there is to tell after `wait`; None for a worker that has just started."""
        try:
            value = self.awaited.recv()
        except (EOFError, OSError):
            self._process.join(1.0)
            return self.fail("worker died")
        self._since = time.monotonic()
        if not self._started:
            self._started = True
            return None
        return Reply(self, self.asked.popleft().key, value)

    def fail(self, reason: str) -> "Reply[Worker]":
        """End the process; the request whose turn it was has failed."""
        self.stop()
        at_work = self._started and self.asked
        return Reply(self, self.asked.popleft().key if at_work else None, Failure(reason))

    def replace(self) -> Self:
        """Return a new worker in the place of this one, which is asked nothing yet.

        Raises:
            MechSearchError: If workers do not start at all.
        """
        failed = () if self._started else (*self._failed_starts, self._process.exitcode or 0)
        if len(failed) == STARTS or sum(code >= 0 for code in failed) == EXITS:
            raise MechSearchError(
                f"worker processes do not start, tried {len(failed)} times, exit code "
                f"{failed[-1]}; a script that uses them needs `if __name__ == '__main__':` around "
                "what it does"
            )
        return type(self)(self._make, failed)

    def stop(self) -> None:
        """End the process, whatever it does."""
        self.alive = False
        self.awaited.close()
        self._process.kill()
        self._process.join()


def replies(
    workers: Sequence[Crew], wait: Callable[[list[Any], float | None], Iterable[Any]] = wait
) -> Iterator[Reply[Crew]]:
    """Wait until one of the workers has answered, died, or used up its time; yield what is there.

    Args:
        workers: All alive.
        wait: Given what is awaited, and for how long at most [s], returns what is ready.
    """
    first = min(worker.deadline for worker in workers)
    timeout = None if first == float("inf") else max(0.0, first - time.monotonic())
    ready = set(wait([worker.awaited for worker in workers], timeout))
    for worker in workers:
        if worker.awaited in ready:
            reply = worker.reply()
            if reply is not None:
                yield reply
        elif worker.deadline <= time.monotonic():
            yield worker.fail("worker hung")


def process_context() -> Any:
    """Return how processes are started here; what is shared with them has to be made by it too.

    On Linux they are forked from a server without threads, which imports what this process has
    imported of the package by its first worker: workers start at once, and share one copy of
    PyTorch. Elsewhere each is a new interpreter.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    package = __name__.partition(".")[0]
    context.set_forkserver_preload(
        [name for name in sys.modules if name.partition(".")[0] == package]
    )
    return context


@contextmanager
def _deaf() -> Iterator[None]:
    """Have processes that are started inside never hear Ctrl-C, which is their parent's to answer.

    Until they run code of ours they would each answer it by a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _path_told() -> Iterator[None]:
    """Have a server that is started inside find modules where this process does.

    Python before 3.12.8 and 3.13.1 does not tell it (gh-117378), and it might import another copy.
    """
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    try:
        yield
    finally:
        del os.environ["PYTHONPATH"]
        if before is not None:
            os.environ["PYTHONPATH"] = before


def _serve(
    environment: dict[str, str], make: Callable[[], Callable[[Any], Any]], pipe: Connection
) -> None:
    """Answer requests until nobody asks any more.

    Args:
        environment: That of whoever starts the process; a server's may be older.
        make: Returns what answers.
        pipe: Where requests come from.
    """
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    answer = make()
    try:
        pipe.send(None)
        while True:
            pipe.send_bytes(_answered(answer, pipe.recv()))
    except (EOFError, ConnectionError):
        return


def _answered(answer: Callable[[Any], Any], request: Any) -> Any:
    """Return the pickled answer, or the pickled failure."""
    try:
        return ForkingPickler.dumps(answer(request))
    except Exception as error:  # noqa: BLE001
        failure = Failure.of(error)
    try:
        data = ForkingPickler.dumps(failure)
        ForkingPickler.loads(data)
        return data
    except Exception:  # noqa: BLE001
        return ForkingPickler.dumps(Failure(failure.reason, RuntimeError(failure.reason)))


def _leave_with_parent() -> None:
    """End this process when its parent is gone, even in the middle of something."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
