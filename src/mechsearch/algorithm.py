"""What a learning algorithm is: the small protocol between the training loop and everyone's own.

An algorithm is a frozen dataclass of its options. It begins a session, which acts, learns and can
be kept; the loop (`training.loop`) asks the session to advance, writes what it tells, scores its
policy and keeps checkpoints. The built-in ones, `actor_critic`, `push_values` and
`retrieval_values`, are no different from one that a user names as `package.module:factory`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, Self, TypeVar, cast

import gymnasium

from mechsearch.env import TaskConfig
from mechsearch.processes import Input, Mapper, Result, map_in_order
from mechsearch.teachers import Teacher
from mechsearch.types import Array, MechSearchError, Policy

if TYPE_CHECKING:
    from torch import Tensor

Evaluator = Callable[[Policy], Mapping[str, float]]
"""Scores a policy."""

NamedTensors = Mapping[str, "Tensor"]
"""Tensors by name; a slash parts a name from its owner's."""


class Env(Protocol):
    """What a run needs of a task: Gymnasium's episodes, which can be kept and gone on with."""

    @property
    def observation_space(self) -> gymnasium.Space[Any]:
        """A dictionary of boxes."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin an episode on the heap that `options` names."""

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Execute one action."""

    def snapshot(self) -> dict[str, Array]:
        """Return all that the rest of the episode depends on."""

    def restore(self, snapshot: dict[str, Array]) -> dict[str, Array]:
        """Go on from a snapshot, bit by bit; return its observation."""


@dataclass(frozen=True)
class TrainingSetup:
    """What a run is given, ready-made.

    Attributes:
        env: The task, with privileged observations.
        heaps: Indices of the heaps to learn on.
        teachers: Who guides, by name.
        evaluators: Score a policy on heaps of their own, by name of these heaps.
        workers: Processes for what an algorithm can spread.
        mapper: How it is spread.
    """

    env: Env
    heaps: Sequence[int]
    teachers: Mapping[str, Teacher]
    evaluators: Mapping[str, Evaluator]
    workers: int = 1
    mapper: Mapper = map_in_order

    def spread(
        self, function: Callable[[Input], Result], inputs: Iterable[Input]
    ) -> Iterator[Result]:
        """Yield a function of each input, in order, from however many processes; see `Mapper`."""
        return self.mapper(function, inputs, self.workers, held=1)


@dataclass(frozen=True)
class Schedule:
    """How long a run is, and when it is looked at.

    Attributes:
        actions: Actions executed while learning (paper: 8,000).
        evaluate_every: Actions between evaluations; where pushes are learnt, between fits too.
        checkpoint_every: Actions between checkpoints.
        validation_heaps: Training heaps set apart to watch the learning.
        held_out_heaps: Held-out heaps to log a curve on, from the untrained policy on; they choose
            nothing.
        grasp_network: Rates the targets of the held-out heaps too, for a curve of graspability: a
            file, or "shipped"; empty rates none.
        threads: CPU threads; other numbers give other bits.
    """

    actions: int = 8000
    evaluate_every: int = 1000
    checkpoint_every: int = 1000
    validation_heaps: int = 20
    held_out_heaps: int = 0
    grasp_network: str = ""
    threads: int = 1

    def __post_init__(self) -> None:
        at_least(0, self, "actions", "validation_heaps", "held_out_heaps")
        at_least(1, self, "evaluate_every", "checkpoint_every", "threads")
        if self.grasp_network and not self.held_out_heaps:
            raise MechSearchError(
                f"grasp_network is {self.grasp_network!r}, and held_out_heaps 0: there are no "
                "targets to rate; expected more, or no grasp network"
            )

    def stops(self, begun: int) -> Iterator[int]:
        """Yield the numbers of actions, from `begun` on, at which the run is looked at or kept."""
        while begun < self.actions:
            every = (self.evaluate_every, self.checkpoint_every)
            begun = min(self.actions, *(begun - begun % n + n for n in every))
            yield begun


class Line(NamedTuple):
    """What the log notes: a kind of record, the action it belongs to, and its values."""

    kind: str
    step: int
    values: Mapping[str, Any]


class Session(Protocol):
    """All of a run that changes while it goes on."""

    @property
    def executed(self) -> int:
        """Actions executed so far."""

    @property
    def policy(self) -> Policy:
        """What has been learnt, as it would act without noise or teachers."""

    def advance(self, until: int) -> Iterator[Iterable[Line]]:
        """Execute some actions, and learn meanwhile.

        Args:
            until: Number of actions at which the loop wants to look; an algorithm that can stop at
                the ends of episodes alone goes on to the next.

        Yields:
            What to note, after each action or episode.
        """

    def catch_up(self, step: int) -> Iterable[Line]:
        """Learn what is due before the policy is looked at, at a step; return what to note."""

    def archive(self) -> tuple[NamedTensors, dict[str, Any]]:
        """Return tensors and JSON that `restore` takes back, bit by bit."""

    def restore(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> None:
        """Go on where `archive` was called."""


class Algorithm(Protocol):
    """A way of learning, a frozen dataclass whose fields are the options of `mechsearch train`."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Observation keys that its policies read."""

    @property
    def teachers(self) -> tuple[str, ...]:
        """Names of the teachers that it wants to be given; none, unless it says so."""
        return ()

    def check(self, task: TaskConfig) -> None:
        """Refuse a task that it cannot learn; there is none, unless it says so.

        Raises:
            MechSearchError: Saying what of the task is in the way.
        """

    def begin(self, run: "RunConfig[Any]", setup: TrainingSetup, folder: Path) -> Session:
        """Return a session at its beginning.

        Args:
            run: Seed, task and schedule; `run.algorithm` is this.
            setup: Environment, heaps and teachers.
            folder: The run directory, for files of the algorithm's own.
        """

    def save(self, policy: Any) -> tuple[NamedTensors, dict[str, Any]]:
        """Return tensors and JSON from which `load` makes the policy again."""

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> Policy:
        """Return the policy that `save` was given; options are those of the file, not one's own."""


A = TypeVar("A", bound=Algorithm)


@dataclass(frozen=True)
class RunConfig(Generic[A]):
    """One training run: a task, one algorithm, and a schedule.

    Attributes:
        name: Variant, such as "method".
        seed: Of everything random.
        algorithm: How it learns.
        task: What it learns.
        schedule: How long, and when it is looked at.
    """

    name: str
    algorithm: A
    seed: int = 0
    task: TaskConfig = field(default_factory=TaskConfig)
    schedule: Schedule = field(default_factory=Schedule)

    def __post_init__(self) -> None:
        at_least(0, self, "seed")
        if self.task.engine != TaskConfig.engine:
            raise MechSearchError(
                f"engine is {self.task.engine!r}; runs learn in {TaskConfig.engine}, and "
                f"`mechsearch evaluate RUN --engine {self.task.engine}` scores them in another"
            )
        self.algorithm.check(self.task)

    def changed(self, **options: Any) -> Self:
        """Return it with other values of options, of its own or of a part, by their names alone.

        Raises:
            MechSearchError: If it has no option of a name.
        """
        changes: dict[str, Any] = {}
        for name in ("schedule", "task", "algorithm"):
            part = getattr(self, name)
            own = {f.name: options.pop(f.name) for f in fields(part) if f.name in options}
            changes |= {name: replace(part, **own)} if own else {}
        known = {f.name for f in fields(self)}
        if unknown := sorted(set(options) - known):
            parts = (self, self.schedule, self.task, self.algorithm)
            names = dict.fromkeys(f.name for part in parts for f in fields(cast(Any, part)))
            raise MechSearchError(
                f"{self.name} has no option {unknown[0]!r}; choose among {', '.join(names)}"
            )
        return replace(self, **changes, **options)


def at_least(least: float, record: object, *names: str) -> None:
    """Refuse a record's numbers below the least one.

    Raises:
        MechSearchError: Naming the first.
    """
    for name in names:
        if getattr(record, name) < least:
            raise MechSearchError(f"{name} is {getattr(record, name)}; expected at least {least:g}")
