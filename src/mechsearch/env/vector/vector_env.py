"""Many environments at once, in worker processes that may fail (`gymnasium.make_vec`)."""

import weakref
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from numbers import Integral, Real
from typing import Any, NoReturn, cast

import numpy as np
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from mechsearch.env.heap_env import HeapEnv, make_env, start_options
from mechsearch.env.vector.hosting import Act, Hosts, Look
from mechsearch.env.vector.sub_env import Quarantine, SubEnv
from mechsearch.processes import PROCESSORS, Failure
from mechsearch.types import Array, MechSearchError, finite_numbers, real_array, shown

AUTORESET_MODES = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)

Batch = tuple[dict[str, Array], Array, Array, Array, dict[str, Any]]


class VectorHeapEnv(VectorEnv[dict[str, Array], Array, Array]):
    """Heap environments in worker processes, with Gymnasium's vector interface.

    The same seeds give the same episodes whatever the number of workers, and those of
    `gymnasium.vector.SyncVectorEnv` over `HeapEnv`. No transition crosses the border between two
    episodes: an episode that is over is followed by the next within the same step (SAME_STEP; the
    last observation and info are `final_obs` and `final_info`), or when
    `reset(options={"reset_mask": ...})` says so (DISABLED).

    A worker that dies, hangs or raises costs one episode: it is truncated with reward 0, the last
    trusted observation and a reason in `info["failure"]`, in either mode, and this transition must
    not be learnt from. Another worker takes over; other episodes that the first held are played
    again there, bit by bit. A heap on which two workers failed is not drawn again: its seed is in
    `info["quarantined"]` when that happens, and in `quarantined`.

    `step` waits for the slowest worker. `send` and `receive` keep all workers busy: of many
    environments, a few are received and sent again while the others go on.
    """

    def __init__(
        self,
        make: Callable[[], HeapEnv],
        num_envs: int = 1,
        workers: int | None = None,
        time_limit: float = 60.0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        """Start the worker processes.

        Args:
            make: Makes an environment; called here and in each worker.
            num_envs: Environments; several in a worker, where they are more.
            workers: Processes; as many as there are processors, or environments, by default.
            time_limit: Time after which an action or a reset hangs [s].
            autoreset_mode: SAME_STEP or DISABLED. NEXT_STEP would make transitions that cross the
                border between two episodes.

        Raises:
            MechSearchError: If a number is not positive, or the mode is another.
        """
        self.closed = True
        mode = _mode(autoreset_mode)
        given = {"num_envs": num_envs, "workers": workers, "time_limit": time_limit}
        for name, value in given.items():
            kind = Real if name == "time_limit" else Integral
            good = isinstance(value, kind) and not isinstance(value, bool) and value > 0
            if not good and (name, value) != ("workers", None):
                expected = "number" if kind is Real else "whole number"
                raise MechSearchError(f"{name} is {shown(value)}; expected a {expected} above 0")
        env = make()
        if not isinstance(env, HeapEnv):
            raise MechSearchError(f"a {type(env).__name__} was made; expected a HeapEnv")
        self.heaps, self.num_envs = env.heaps, num_envs
        self.metadata = {**env.metadata, "autoreset_mode": mode}
        self.render_mode = env.render_mode
        self.single_observation_space = env.observation_space
        self.single_action_space = env.action_space
        self.observation_space = batch_space(env.observation_space, num_envs)
        self.action_space = batch_space(env.action_space, num_envs)
        workers = min(num_envs, workers or PROCESSORS)
        self._hosts = Hosts(make, env.observation_space, num_envs, workers, time_limit)
        # Also when the interpreter ends, while processes can still be ended.
        self._end = weakref.finalize(self, self._hosts.close)
        self.closed = False
        shared = self._hosts.observations
        self._kept = {key: np.zeros_like(rows) for key, rows in shared.items()}
        self._quarantine = Quarantine([heap.seed for heap in env.heaps])
        same_step, nothing = mode is AutoresetMode.SAME_STEP, env.no_reward
        self._sub_envs = [
            SubEnv(i, shared, self._kept, self._quarantine, same_step, nothing)
            for i in range(num_envs)
        ]
        self._turn: deque[int] = deque()
        self._complete: set[int] = set()

    @property
    def quarantined(self) -> dict[int, str]:
        """Seeds of the heaps that are not drawn any more, and why the last worker failed there."""
        return dict(self._quarantine.names)

    @property
    def pids(self) -> tuple[int, ...]:
        """Process numbers of the workers."""
        return self._hosts.pids

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin an episode in every environment, or in those that `options["reset_mask"]` names.

        Args:
            seed: Of the first environment, the others count up; or of each.
            options: Of `HeapEnv.reset`, and `reset_mask` (num_envs,) bool.

        Raises:
            MechSearchError: If an option or a seed is no good, or no episode can begin.
        """
        self._check_idle("reset")
        passed = start_options(options, len(self.heaps), ("reset_mask",))
        mask = _mask(passed.pop("reset_mask", None), self.num_envs)
        seeds = _seeds(seed, self.num_envs)
        envs = [int(i) for i in np.flatnonzero(mask)]
        for request in [self._sub_envs[i].reset(seeds[i], passed) for i in envs]:
            self._hosts.ask(request)
        if error := self._await(envs):
            raise error
        infos = [(i, self._sub_envs[i].result.info) for i in envs]
        return self._seen(slice(None)), _batched(infos, self.num_envs)

    def step(self, actions: Array) -> Batch:
        """Execute one action (num_envs, 3) in every environment.

        Raises:
            MechSearchError: If the actions are malformed or an episode is over.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Array) -> None:
        """Begin to execute actions; `step_wait` returns what they led to."""
        self._check_idle("step_async")
        self.send(actions, range(self.num_envs))

    def step_wait(self) -> Batch:
        """Return what the actions of `step_async` led to."""
        self._check_open()
        if list(self._turn) != list(range(self.num_envs)):
            raise NoAsyncCallError("step_wait needs a step_async before it", "step")
        return self.receive(self.num_envs)[1]

    def send(self, actions: Array, envs: Iterable[int]) -> None:
        """Begin to execute actions in some environments.

        Args:
            actions: One for each (n, 3), in [-1, 1].
            envs: Which environments (n,); none that has not been received since it was last sent.

        Raises:
            MechSearchError: If the actions are malformed or an episode is over.
        """
        self._check_open()
        envs = [int(i) for i in envs]
        if not set(envs) <= set(range(self.num_envs)):
            raise MechSearchError(f"environments {envs}; choose among 0 to {self.num_envs - 1}")
        if set(envs) & set(self._turn) or len(set(envs)) < len(envs):
            raise AlreadyPendingCallError(f"of {envs}, some are sent and not received", "step")
        actions = _checked(actions, len(envs))
        over = [i for i in envs if self._sub_envs[i].over]
        if over:
            raise MechSearchError(
                f"the episodes of {over} are over; begin others with "
                'reset(options={"reset_mask": ...})'
            )
        for i, action in zip(envs, actions, strict=True):
            self._turn.append(i)
            self._hosts.ask(Act(i, action))

    def receive(self, count: int) -> tuple[Array, Batch]:
        """Return what the actions sent longest ago led to.

        Args:
            count: How many environments.

        Returns:
            Their indices (count,), in the order in which they were sent, and their observations,
            rewards, terminations, truncations and infos, batched in this order.
        """
        self._check_open()
        if not 1 <= count <= len(self._turn):
            raise NoAsyncCallError(f"receive({count}) of {len(self._turn)} that were sent", "step")
        envs = [self._turn[k] for k in range(count)]
        error = self._await(envs)
        for _ in envs:
            self._turn.popleft()
        if error:
            raise error
        results = [self._sub_envs[i].result for i in envs]
        return np.array(envs), (
            self._seen(envs),
            np.array([result.reward for result in results]),
            np.array([result.terminated for result in results]),
            np.array([result.truncated for result in results]),
            _batched([(k, result.info) for k, result in enumerate(results)], count),
        )

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return an attribute of each environment, or what a method that changes nothing returns.

        Raises:
            MechSearchError: If the method would change the environment, or a worker fails.
        """
        self._check_idle(name)
        if name in ("reset", "step", "restore", "close"):
            raise MechSearchError(f"{name} would change the environments; call only looks at them")
        for i in range(self.num_envs):
            self._hosts.ask(Look(i, name, args, kwargs))
        found: dict[int, Any] = {}
        while len(found) < self.num_envs:
            found.update(self._hosts.replies())
        for value in found.values():
            if isinstance(value, Failure):
                raise value.error or MechSearchError(f"{value.reason} while it looked at {name}")
        return tuple(found[i] for i in range(self.num_envs))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment."""
        return self.call(name)

    def render(self) -> tuple[Any, ...]:
        """Return a picture of each environment, when made with render_mode="rgb_array"."""
        return self.call("render")

    def close_extras(self, **kwargs: Any) -> None:
        """End all worker processes, whatever they do."""
        self._end()

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise MechSearchError(
            "a vector environment holds processes, and is neither copied nor pickled; make another"
        )

    def _await(self, envs: Sequence[int]) -> MechSearchError | None:
        """Wait until the outcomes of some environments are complete.

        Returns:
            Why no episode can begin in one of them, if so.
        """
        error = None
        while not self._complete.issuperset(envs):
            for i, value in self._hosts.replies():
                try:
                    request = self._sub_envs[i].take(value)
                except MechSearchError as found:
                    error, request = error or found, None
                if request is None:
                    self._complete.add(i)
                else:
                    self._hosts.ask(request)
        self._complete.difference_update(envs)
        return error

    def _seen(self, envs: Any) -> dict[str, Array]:
        return {key: np.array(rows[envs]) for key, rows in self._kept.items()}

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError("the vector environment is closed")

    def _check_idle(self, name: str) -> None:
        self._check_open()
        if self._turn:
            raise AlreadyPendingCallError(
                f"{name} while the actions of {list(self._turn)} are not received", "step"
            )


def make_vector_env(
    num_envs: int = 1,
    workers: int | None = None,
    time_limit: float = 60.0,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    **task: Any,
) -> VectorHeapEnv:
    """Return many environments in worker processes.

    Args:
        num_envs: Environments; this and the next three are as in `VectorHeapEnv`.
        workers: Processes.
        time_limit: Time after which an action or a reset hangs [s].
        autoreset_mode: SAME_STEP or DISABLED.
        task: What `make_env` takes.

    Raises:
        MechSearchError: If a name, number or setting is wrong, or heaps and objects do not fit.
    """
    return VectorHeapEnv(partial(make_env, **task), num_envs, workers, time_limit, autoreset_mode)


def _mode(mode: AutoresetMode | str) -> AutoresetMode:
    values = [choice.value for choice in AUTORESET_MODES]
    value = mode.value if isinstance(mode, AutoresetMode) else mode
    if value not in values:
        raise MechSearchError(
            f"unknown autoreset_mode {value!r}; choose one of {', '.join(values)}: any other makes "
            "transitions that cross the border between two episodes"
        )
    return AutoresetMode(value)


def _mask(mask: Any, num_envs: int) -> Array:
    if mask is None:
        return np.ones(num_envs, np.bool_)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise MechSearchError(f"reset_mask is {shown(mask)}; expected an array of booleans")
    if mask.shape != (num_envs,) or not mask.any():
        raise MechSearchError(
            f"reset_mask is {shown(mask)}; expected {num_envs} values, one of them true"
        )
    return mask


def _seeds(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    given: Any = [None] * num_envs if seed is None else seed
    if isinstance(given, Integral):
        given = [given + i for i in range(num_envs)]
    if not isinstance(given, Sequence | np.ndarray) or not all(
        one is None or (isinstance(one, Integral) and cast("int", one) >= 0) for one in given
    ):
        raise MechSearchError(
            f"seed is {shown(seed)}; expected a whole number, not below 0, or {num_envs} of them"
        )
    if len(given) != num_envs:
        raise MechSearchError(f"{len(given)} seeds given; expected one, or {num_envs}")
    return [None if one is None else int(one) for one in given]


def _checked(actions: Any, count: int) -> Array:
    expected = f"actions of {count} environments are finite, of shape ({count}, 3), in [-1, 1]"
    with np.errstate(over="ignore"):
        values = np.asarray(real_array(actions, expected), np.float32)
    finite_numbers(values, (count, 3), expected)
    return values


def _batched(infos: Sequence[tuple[int, dict[str, Any]]], size: int) -> dict[str, Any]:
    """Return infos in Gymnasium's vector form, each at its place among `size`."""
    form: VectorEnv[Any, Any, Any] = VectorEnv()
    form.num_envs = size
    batch: dict[str, Any] = {}
    for place, info in infos:
        batch = form._add_info(batch, info, place)
    return batch
