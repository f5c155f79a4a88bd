"""Environments in worker processes: what they are asked, and how they outlive their worker.

Whatever an episode depends on (heap, generator, options, actions so far) is known to the process
that asks. So when a worker is lost, the episodes that were not at fault are played again, bit by
bit, in the worker that replaces it.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector.utils import (
    CloudpickleWrapper,
    create_shared_memory,
    read_from_shared_memory,
    write_to_shared_memory,
)

from mechsearch.env.heap_env import HeapEnv
from mechsearch.processes import Failure, Worker, process_context, replies
from mechsearch.types import Array

_ASKED = 2
"""Requests that a worker holds: the one it works on and the next, so that it never waits."""


@dataclass(frozen=True)
class Begin:
    """Start an episode, and take the actions of one that was lost.

    Attributes:
        env: Which environment.
        heap: Index of its heap.
        rng: The environment's generator once the heap is drawn.
        options: Of `HeapEnv.reset`.
        actions: Those taken so far.
    """

    env: int
    heap: int
    rng: np.random.Generator
    options: Mapping[str, Any]
    actions: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Act:
    """Execute one action (3,), after the episode was begun anew where its worker was lost."""

    env: int
    action: Array
    again: Begin | None = None


@dataclass(frozen=True)
class Look:
    """Read an attribute, or call a method that changes nothing."""

    env: int
    name: str
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] | None = None
    again: Begin | None = None


class Begun(NamedTuple):
    """An episode began: its info, and the generator as `reset` left it."""

    info: dict[str, Any]
    rng: np.random.Generator


class Acted(NamedTuple):
    """An action was executed; the observation is in the shared memory."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


class Host:
    """The environments of one worker process."""

    def __init__(self, make: Callable[[], HeapEnv], memory: Any) -> None:
        """Make the first environment; the others share its heaps and objects."""
        self._first = make()
        self._memory = memory
        self._envs: dict[int, HeapEnv] = {}

    def __call__(self, request: Begin | Act | Look) -> Any:
        """Do what is asked; an environment that raises is thrown away."""
        try:
            if isinstance(request, Begin):
                return self._begin(request)
            if request.again is not None:
                self._begin(request.again)
            if isinstance(request, Act):
                return self._act(request)
        except Exception:
            self._envs.pop(request.env, None)
            raise
        return self._look(request)

    def _begin(self, request: Begin) -> Begun:
        env = self._envs.get(request.env)
        if env is None:
            first = self._first
            env = type(first)(first.heaps, first.objects, first.config, first.render_mode)
            self._envs[request.env] = env
        env.np_random = request.rng
        obs, info = env.reset(options={**request.options, "heap": request.heap})
        for action in request.actions:
            obs, *_ = env.step(action)
        self._show(request.env, obs)
        return Begun(info, env.np_random)

    def _act(self, request: Act) -> Acted:
        obs, reward, terminated, truncated, info = self._envs[request.env].step(request.action)
        self._show(request.env, obs)
        return Acted(reward, terminated, truncated, info)

    def _look(self, request: Look) -> Any:
        found = getattr(self._envs.get(request.env, self._first), request.name)
        return found(*request.args, **(request.kwargs or {})) if callable(found) else found

    def _show(self, env: int, obs: Any) -> None:
        write_to_shared_memory(self._first.observation_space, env, obs, self._memory)


class Hosts:
    """The worker processes of a vector environment.

    Attributes:
        observations: The shared memory: for each key, the last observations (num_envs, ...).
    """

    def __init__(
        self,
        make: Callable[[], HeapEnv],
        space: gymnasium.Space[Any],
        num_envs: int,
        workers: int,
        time_limit: float,
    ) -> None:
        """Start the workers; environment i lives in worker i modulo their number.

        Args:
            make: Called once in each worker.
            space: Observations of one environment.
            num_envs: Environments.
            workers: Processes.
            time_limit: Time that one action or reset may take [s].
        """
        memory: Any = create_shared_memory(space, n=num_envs, ctx=process_context())
        observations: Any = read_from_shared_memory(space, memory, n=num_envs)
        self.observations: dict[str, Array] = observations
        make_host = partial(Host, CloudpickleWrapper(make), memory)
        self._workers = [Worker(make_host) for _ in range(workers)]
        self._waiting: list[deque[Begin | Act | Look]] = [deque() for _ in range(workers)]
        self._asked: dict[int, Begin | Act | Look] = {}
        self._episodes: dict[int, Begin] = {}
        self._present: set[int] = set()
        self._time_limit = time_limit

    @property
    def pids(self) -> tuple[int, ...]:
        """Numbers of the processes."""
        return tuple(worker.pid for worker in self._workers)

    def ask(self, request: Begin | Act | Look) -> None:
        """Ask an environment that has answered everything before."""
        self._waiting[request.env % len(self._workers)].append(request)
        self._hand_out(request.env % len(self._workers))

    def replies(self) -> Iterator[tuple[int, Any]]:
        """Wait until an environment that was asked has answered; yield all that have.

        Yields:
            The environment, and `Begun`, `Acted`, what was looked at, or the `Failure` that cost
            its episode.
        """
        for i in range(len(self._workers)):
            self._hand_out(i)
        busy = [worker for worker in self._workers if worker.asked]
        for worker, env, value in replies(busy):
            if not worker.alive:
                self._replace(worker)
            if env is not None:
                self._note(self._asked.pop(env), value)
                yield env, value

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.stop()

    def _hand_out(self, i: int) -> None:
        worker, waiting = self._workers[i], self._waiting[i]
        while waiting and len(worker.asked) < _ASKED:
            request = waiting.popleft()
            self._asked[request.env] = request
            limit = self._time_limit
            if not isinstance(request, Begin) and request.env not in self._present:
                request = replace(request, again=self._episodes.get(request.env))
                limit *= 1 + len(request.again.actions) if request.again else 1
            self._present.add(request.env)
            worker.ask(request.env, request, limit)

    def _note(self, request: Begin | Act | Look, value: Any) -> None:
        """Remember what an episode depends on, or that it is lost."""
        env = request.env
        if isinstance(request, Look):
            return
        if isinstance(value, Failure):
            self._episodes.pop(env, None)
            self._present.discard(env)
        elif isinstance(request, Begin):
            self._episodes[env] = request
        else:
            begin = self._episodes[env]
            self._episodes[env] = replace(begin, actions=(*begin.actions, request.action))

    def _replace(self, worker: Worker) -> None:
        """Put another in the place of a worker; what it had not begun is asked again."""
        i = self._workers.index(worker)
        self._present -= {env for env in self._present if env % len(self._workers) == i}
        self._waiting[i].extendleft(self._asked.pop(asked.key) for asked in reversed(worker.asked))
        self._workers[i] = worker.replace()
