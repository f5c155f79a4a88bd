"""The paper's way of learning (section III): its options, its session and the algorithm."""

import json
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from mechsearch.actor_critic.behaviour import Behaviour
from mechsearch.actor_critic.collector import Collector, Transition
from mechsearch.actor_critic.episode_log import EpisodeLog
from mechsearch.actor_critic.exploration import Noise, NoiseConfig
from mechsearch.actor_critic.freed_memory import keep_freed_memory
from mechsearch.actor_critic.guidance import Guidance, GuidanceConfig
from mechsearch.actor_critic.learner import Learner, LearnerConfig
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.actor_critic.replay import Replay
from mechsearch.algorithm import Env, Line, NamedTensors, RunConfig, TrainingSetup, at_least
from mechsearch.env import TaskConfig
from mechsearch.files import record_from_json
from mechsearch.files.tensors import fill, part, prefixed
from mechsearch.teachers import PAPER_TEACHERS, check_teacher
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, Array, MechSearchError

CRITIC_KEYS = ("ee_position", "target_offset", "clutter_offsets")
"""What the asymmetric critic reads (paper, III-C); removed and missing objects are zeros."""


@dataclass(frozen=True)
class ActorCriticConfig:
    """Actor on images, critic on positions, teachers that suggest actions (paper, section III).

    Attributes:
        actor_keys: What the actor sees.
        critic_keys: What the critic sees; the actor's keys make it symmetric.
        teachers: Who guides: names in `teachers.TEACHERS`, or package.module:factory; empty is
            unguided.
        imitated: Those of the teachers whose actions the actor is drawn to; empty is all.
        updates_per_action: Gradient steps for each action.
        block: Actions executed between two looks at the networks, which learn meanwhile.
        warmup: Actions before the first update.
        replay_rows: Most frames kept.
        learner: The updates.
        guidance: The choice among actor and teachers.
        noise: Exploration of the actor.
    """

    actor_keys: tuple[str, ...] = ACTOR_KEYS
    critic_keys: tuple[str, ...] = CRITIC_KEYS
    teachers: tuple[str, ...] = PAPER_TEACHERS
    imitated: tuple[str, ...] = ()
    updates_per_action: float = 1.0
    block: int = 4
    warmup: int = 300
    replay_rows: int = 20_000
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)

    def __post_init__(self) -> None:
        at_least(0, self, "updates_per_action", "warmup")
        at_least(1, self, "block", "replay_rows")
        for name in self.teachers:
            check_teacher(name)
        strangers = [name for name in self.imitated if name not in self.teachers]
        if strangers:
            raise MechSearchError(
                f"imitated names {strangers[0]!r}, but the teachers are "
                f"{', '.join(self.teachers) or 'none'}; choose among them"
            )
        if not self.actor_keys or not self.critic_keys:
            raise MechSearchError("actor and critic need at least one observation key each")
        seen = [key for key in self.actor_keys if key in PRIVILEGED_KEYS]
        if seen:
            raise MechSearchError(
                f"the actor must not see {seen[0]!r}: it is known to a simulator only"
            )
        if self.teachers and not self.learner.dropout:
            raise MechSearchError(
                "teachers need a Bayesian critic to choose by: dropout is 0; expected more, "
                "or no teachers"
            )


_TURN = 0.0005
"""Longest turn of one thread while another waits [s]. With Python's 5 ms, each of a gradient step's
many short calls would wait for the world's next long one."""


@contextmanager
def short_turns() -> Iterator[None]:
    """Let threads take short turns while inside."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(_TURN)
    try:
        yield
    finally:
        sys.setswitchinterval(usual)


class Speed:
    """Measures actions and updates between two laps."""

    def __init__(self, step: int = 0, updates: int = 0) -> None:
        """Start the clock at a step of the run."""
        self._step, self._updates = step, updates
        self._began = time.perf_counter()
        self._updating = 0.0

    @contextmanager
    def updating(self) -> Iterator[None]:
        """Count what happens inside as gradient steps."""
        began = time.perf_counter()
        yield
        self._updating += time.perf_counter() - began

    def lap(self, step: int, updates: int) -> dict[str, float]:
        """Return the speeds since the last lap: `updates_per_s` counts update time alone."""
        seconds = time.perf_counter() - self._began
        done = updates - self._updates
        speeds = {
            "seconds": seconds,
            "actions_per_s": (step - self._step) / seconds,
            "updates_per_s": done / self._updating if self._updating else 0.0,
        }
        self._step, self._updates, self._updating = step, updates, 0.0
        self._began = time.perf_counter()
        return speeds


class ActorCriticSession:
    """Learner, replay, collector, generators and counters.

    While some actions are executed by copies of actor and critic, the updates that are due for all
    actions before them are taken: who finishes first changes nothing.
    """

    def __init__(self, run: RunConfig[Any], setup: TrainingSetup) -> None:
        """Build everything from the configuration and its seed.

        Raises:
            MechSearchError: If the environment lacks a key, or the replay does not fit.
        """
        config: ActorCriticConfig = run.algorithm
        self.config, self._schedule, self._setup = config, run.schedule, setup
        torch.set_num_threads(run.schedule.threads)
        keep_freed_memory()
        torch.manual_seed(run.seed)
        spaces = _spaces(setup.env, config)
        shapes = {key: tuple(space.shape or ()) for key, space in spaces.items()}
        dtypes = {key: np.dtype(space.dtype) for key, space in spaces.items()}
        self.learner = Learner(
            {key: shapes[key] for key in config.actor_keys},
            {key: shapes[key] for key in config.critic_keys},
            config.learner,
            run.seed,
        )
        rows = min(config.replay_rows, 2 * run.schedule.actions + 2)
        self.replay = Replay(shapes, dtypes, rows, config.learner.worst)
        imitated = config.imitated or config.teachers
        # Candidate 0 is the actor.
        self._imitated = {1 + i for i, name in enumerate(setup.teachers) if name in imitated}
        seeds = np.random.SeedSequence(run.seed).spawn(3)
        names = ("episodes", "exploration", "batches")
        self.rngs = {n: np.random.default_rng(s) for n, s in zip(names, seeds, strict=True)}
        # They stay for the run: networks are slower in a thread's first calls.
        self._world = ThreadPoolExecutor(1, thread_name_prefix="collector")
        self._beside = ThreadPoolExecutor(1, thread_name_prefix="actor")
        self.behaviour = Behaviour(self.learner, run.seed + 1)
        self.collector = Collector(
            Guidance(config.guidance), Noise(config.noise), setup, self.behaviour, self.rngs
        )
        self.episode: EpisodeLog | None = None
        self.counts = {"step": 0, "block": 0, "episodes": 0, "updates": 0, "failures": 0}
        self._speed = Speed()

    @property
    def executed(self) -> int:
        """Actions executed so far."""
        return self.counts["step"]

    @property
    def policy(self) -> ActorPolicy:
        """The running average of the actors."""
        return ActorPolicy(self.learner.actor_target)

    def advance(self, until: int) -> Iterator[list[Line]]:
        """Execute a block of actions, or what is left of one up to `until`.

        The networks that act stay the same within a block. Blocks end with episodes and before
        evaluations, wherever the run or a checkpoint does, so that a run which is cut off and goes
        on is the run that was never stopped.
        """
        begins = self.executed == self.counts["block"]
        if begins:
            self.behaviour.refresh()
        count = min(self._block_end, until) - self.executed
        with short_turns():
            actions = self._world.submit(self.collector.collect, count)
            if begins:
                with self._speed.updating():
                    self.update()
            done = actions.result()
        for transition in done:
            summary = self.store(transition)
            yield [] if summary is None else [Line("episode", self.executed, summary)]

    def catch_up(self, step: int) -> list[Line]:
        """Take the updates that are due; return how fast the run was since the last time."""
        self.update()
        return [Line("speed", step, self._speed.lap(step, self.counts["updates"]))]

    @property
    def _block_end(self) -> int:
        began, every = self.counts["block"], self._schedule.evaluate_every
        return min(began + self.config.block, began - began % every + every)

    def store(self, done: Transition) -> dict[str, Any] | None:
        """Keep what an action led to; return the episode's summary if it is over.

        A failed simulation's transition is not kept.
        """
        self.counts["step"] += 1
        self.counts["episodes"] += done.over
        if self.episode is None:
            self.episode = self._new_log(done.heap)
        decision = done.decision
        self.episode.add(decision.choice, decision.q, decision.actor_action, done.reward, done.info)
        self._remember(done)
        if done.over or self.executed == self._block_end:
            self.counts["block"] = self.executed
        if not done.over:
            return None
        # What is due for the episode belongs in its summary.
        self.update()
        episode, self.episode = self.episode, None
        return episode.summary(done.terminated, done.info)

    def _remember(self, done: Transition) -> None:
        if done.info.get("failure"):
            self.counts["failures"] += 1
            self.replay.end(done.obs, whole=False)
            return
        discount = 0.0 if done.terminated else self.config.learner.gamma
        decision = done.decision
        imitated = decision.choice in self._imitated
        self.replay.add(done.obs, decision.action, done.reward, discount, imitated)
        if done.over:
            self.replay.end(done.after)

    def update(self) -> None:
        """Take the gradient steps that are due for all that is stored."""
        since = max(self.executed - self.config.warmup, 0)
        due = int(since * self.config.updates_per_action)
        while self.counts["updates"] < due and len(self.replay):
            metrics = self.learner.update(self.replay, self.rngs["batches"], self._beside)
            self.counts["updates"] += 1
            if self.episode is not None:
                self.episode.add_update(metrics)

    def archive(self) -> tuple[NamedTensors, dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, the running episode included."""
        arrays, episode = self.collector.archive()
        tensors = {
            **prefixed("learner", self.learner.state()),
            **prefixed("behaviour", self.behaviour.state()),
            **prefixed("replay", _tensors(self.replay.state())),
            **prefixed("episode", _tensors(arrays)),
        }
        return tensors, {
            "counts": dict(self.counts),
            "generators": {n: json.dumps(r.bit_generator.state) for n, r in self.rngs.items()},
            "episode": episode,
            # As text, since the order of its names is the order in the log.
            "episode_log": None if self.episode is None else json.dumps(self.episode.state()),
        }

    def restore(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> None:
        """Go back to where `archive` was called, in the middle of an episode or between two.

        Raises:
            MechSearchError: If it is of other networks or observations.
        """
        self.learner.restore(part(tensors, "learner"))
        self.behaviour.restore(part(tensors, "behaviour"))
        self.replay.restore(_arrays(part(tensors, "replay")))
        self.collector.restore(_arrays(part(tensors, "episode")), facts["episode"])
        self.counts = {**self.counts, **facts["counts"]}
        for name, rng in self.rngs.items():
            rng.bit_generator.state = json.loads(facts["generators"][name])
        self._speed = Speed(self.executed, self.counts["updates"])
        if facts["episode_log"] is not None:
            self.episode = self._new_log(facts["episode"]["heap"])
            self.episode.restore(json.loads(facts["episode_log"]))

    def _new_log(self, heap: int) -> EpisodeLog:
        return EpisodeLog(heap, ("actor", *self._setup.teachers), self.config.learner.gamma)


def _tensors(arrays: Mapping[str, Array]) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(value) for name, value in arrays.items()}


def _arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, Array]:
    return {name: tensor.numpy() for name, tensor in tensors.items()}


def _spaces(env: Env, config: ActorCriticConfig) -> dict[str, gymnasium.Space[Any]]:
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Dict):
        raise MechSearchError(f"the environment observes {space}; expected a dictionary")
    keys = dict.fromkeys((*config.actor_keys, *config.critic_keys))
    missing = [key for key in keys if key not in space.spaces]
    if missing:
        raise MechSearchError(
            f"the environment does not show {', '.join(missing)}; it shows "
            f"{', '.join(space.spaces)}. The critic needs privileged=True."
        )
    return {key: space.spaces[key] for key in keys}


@dataclass(frozen=True)
class ActorCritic(ActorCriticConfig):
    """An actor-critic guided by teachers; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What the actor sees."""
        return self.actor_keys

    def check(self, task: TaskConfig) -> None:
        """Refuse a view that does not turn as the task does.

        Raises:
            MechSearchError: If batches are to be turned under another camera than the overhead one.
        """
        if self.learner.symmetry and task.camera != "overhead":
            raise MechSearchError(
                f"learner.symmetry needs the overhead camera; the camera is {task.camera!r}: "
                "choose the other, or symmetry False"
            )

    def begin(
        self, run: RunConfig["ActorCritic"], setup: TrainingSetup, folder: Path
    ) -> ActorCriticSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment lacks a key, or the replay does not fit.
        """
        return ActorCriticSession(run, setup)

    def save(self, policy: ActorPolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return an actor's weights, and the shapes and sizes of its network."""
        actor = policy.actor
        # Pairs, since the order of the keys is the order of the heads' features.
        shapes = [[key, list(shape)] for key, shape in actor.shapes.items()]
        return dict(actor.state_dict()), {"shapes": shapes, "network": asdict(actor.config)}

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> ActorPolicy:
        """Return the actor that `save` was given, as a policy."""
        network = record_from_json(NetworkConfig, facts["network"], retired={"bfloat16": False})
        actor = Actor({key: tuple(shape) for key, shape in facts["shapes"]}, network)
        fill(actor, tensors)
        return ActorPolicy(actor)
