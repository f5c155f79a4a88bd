"""What a training run is made of, and the named settings of the paper's comparison."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from mechsearch.actor_critic.exploration import NoiseConfig
from mechsearch.actor_critic.guidance import GuidanceConfig
from mechsearch.actor_critic.learner import LearnerConfig
from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.files import (
    read_record,
    record_from_json,
    write_record,
)
from mechsearch.push_values.policy import PushPolicyConfig
from mechsearch.push_values.value import PushValueConfig
from mechsearch.teachers import PAPER_TEACHERS, check_teacher
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, RGB_ACTOR_KEYS, MechSearchError

PURPOSE = "training configuration"

SHIPPED_NETWORK = "shipped"
"""Names the grasp network that comes with the package."""

CRITIC_KEYS = ("ee_position", "target_offset", "clutter_offsets")
"""What the asymmetric critic reads (paper, III-C); removed and missing objects are zeros."""


@dataclass(frozen=True)
class PushLearningConfig:
    """Learning what pushes bring, from episodes in which they are carried out.

    Attributes:
        networks: How many judge together; 0 is another way of learning.
        tries: Pushes at each decision whose outcome is learnt from: the executed one, and others
            that are only tried in the simulator from there. Without a simulator it is 1.
        explore: Share of random pushes among the executed ones, after the first fit; before it, all
            are random.
        ranked: Share of the tried pushes that are the best of what the policy judges, not random.
        value: The network and its fit.
        policy: How pushes are chosen.
    """

    networks: int = 0
    tries: int = 24
    explore: float = 0.1
    ranked: float = 0.5
    value: PushValueConfig = field(default_factory=PushValueConfig)
    policy: PushPolicyConfig = field(default_factory=PushPolicyConfig)

    def __post_init__(self) -> None:
        _at_least("networks", self.networks, 0)
        _at_least("tries", self.tries, 1)
        if self.tries > self.policy.candidates:
            raise MechSearchError(
                f"tries is {self.tries}, but {self.policy.candidates} candidates are drawn; "
                f"expected 1 to {self.policy.candidates}"
            )
        if not (0 <= self.explore <= 1 and 0 <= self.ranked <= 1):
            raise MechSearchError(
                f"explore is {self.explore} and ranked {self.ranked}; expected shares in [0, 1]"
            )


@dataclass(frozen=True)
class TrainConfig:
    """One training run.

    Attributes:
        name: Variant, such as "method".
        seed: Of everything random.
        actions: Actions executed while learning (paper: 8,000).
        actor_keys: What the actor sees.
        critic_keys: What the critic sees; the actor's keys make it symmetric.
        teachers: Who guides: names of `teachers.TEACHERS`, or `package.module:factory`; empty is
            unguided.
        imitated: Those of the teachers whose actions the actor is drawn to; empty is all.
        updates_per_action: Gradient steps for each action.
        block: Actions executed between two looks at the networks, which learn meanwhile.
        warmup: Actions before the first update.
        replay_rows: Most frames kept.
        evaluate_every: Actions between evaluations; where pushes are learnt, between fits too.
        checkpoint_every: Actions between checkpoints; where pushes are learnt, each fit has one.
        validation_heaps: Training heaps set apart to watch the learning.
        held_out_heaps: Held-out heaps to log a curve on, from the untrained actor on; they choose
            nothing.
        grasp_network: Rates the targets of the held-out heaps too, for a curve of graspability: a
            file, or "shipped"; empty rates none.
        threads: CPU threads; other numbers give other bits.
        camera: View of all images: "overhead" or "tilted".
        image_size: Side of the images [px].
        learner: The updates.
        guidance: The choice among actor and teachers.
        noise: Exploration of the actor.
        pushes: Learning of pushes instead of reinforcement, where its networks are not 0.
    """

    name: str = "method"
    seed: int = 0
    actions: int = 8000
    actor_keys: tuple[str, ...] = ACTOR_KEYS
    critic_keys: tuple[str, ...] = CRITIC_KEYS
    teachers: tuple[str, ...] = PAPER_TEACHERS
    imitated: tuple[str, ...] = ()
    updates_per_action: float = 1.0
    block: int = 4
    warmup: int = 300
    replay_rows: int = 20_000
    evaluate_every: int = 1000
    checkpoint_every: int = 1000
    validation_heaps: int = 20
    held_out_heaps: int = 0
    grasp_network: str = ""
    threads: int = 1
    camera: str = "overhead"
    image_size: int = 64
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    pushes: PushLearningConfig = field(default_factory=PushLearningConfig)

    def __post_init__(self) -> None:
        for name in ("actions", "warmup", "validation_heaps", "held_out_heaps"):
            _at_least(name, getattr(self, name), 0)
        for name in ("block", "replay_rows", "evaluate_every", "checkpoint_every", "threads"):
            _at_least(name, getattr(self, name), 1)
        if self.updates_per_action < 0:
            raise MechSearchError(
                f"updates_per_action is {self.updates_per_action}; expected at least 0"
            )
        if self.grasp_network and not self.held_out_heaps:
            raise MechSearchError(
                f"grasp_network is {self.grasp_network!r}, and held_out_heaps 0: there are no "
                "targets to rate; expected more, or no grasp network"
            )
        self._check_roles()
        self._check_pushes()

    def _check_roles(self) -> None:
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
        turned = self.learner.symmetry and not self.pushes.networks
        if turned and self.camera != "overhead":
            raise MechSearchError(
                f"learner.symmetry needs the overhead camera; the camera is {self.camera!r}: "
                "choose the other, or symmetry False"
            )

    def _check_pushes(self) -> None:
        # Fits come at these actions: else a run made longer would have one that a run of the full
        # length has not.
        if self.pushes.networks and self.actions % self.evaluate_every:
            raise MechSearchError(
                f"{self.name} fits its networks every {self.evaluate_every} actions "
                f"(evaluate_every), and actions is {self.actions}; expected a multiple of that"
            )


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise MechSearchError(f"{name} is {value}; expected at least {least}")


def _presets() -> Mapping[str, TrainConfig]:
    base = TrainConfig()
    # Directions serve imitation; where there is nobody to imitate, the actor is the paper's.
    alone = replace(base.learner, network=NetworkConfig(centroid=True))
    # A spiral's next step follows from where the end effector is. That of a push through the
    # target does not, unless one knows from where it came, and the actor remembers nothing.
    drawn = NetworkConfig(directions=True, lengths=True, centroid=True)
    learner = replace(base.learner, imitation=10.0, mirrors=False, network=drawn)
    method = replace(base, imitated=("spiral",), learner=learner)
    ordinary = replace(alone, dropout=0.0, samples=1)
    variants = {
        "method": method,
        "ddpg": replace(base, teachers=(), critic_keys=ACTOR_KEYS, learner=ordinary),
        "no-teachers": replace(base, teachers=(), learner=alone),
        "no-asymmetry": replace(method, critic_keys=ACTOR_KEYS),
        "no-pose-input": replace(method, actor_keys=RGB_ACTOR_KEYS),
        "plus": replace(base, teachers=(), pushes=PushLearningConfig(networks=3)),
        "debug": replace(
            method,
            actions=120,
            warmup=20,
            evaluate_every=60,
            checkpoint_every=60,
            validation_heaps=2,
            learner=replace(method.learner, batch=8, samples=5),
        ),
    }
    return {name: replace(config, name=name) for name, config in variants.items()}


PRESETS = _presets()
"""The method, its baseline and ablations (paper, section IV), `plus` (pushes), and `debug`."""


def preset_config(name: str) -> TrainConfig:
    """Return a named configuration.

    Raises:
        MechSearchError: If there is no such preset.
    """
    if name not in PRESETS:
        raise MechSearchError(f"unknown variant {name!r}; choose one of {', '.join(PRESETS)}")
    return PRESETS[name]


def save_config(config: TrainConfig, path: Path) -> None:
    """Write a configuration as JSON."""
    write_record(path, PURPOSE, asdict(config))


def load_config(path: Path) -> TrainConfig:
    """Read a configuration.

    Raises:
        MechSearchError: If the file is missing, damaged, or has unknown fields.
    """
    found = read_record(path, PURPOSE, ("name", "seed", "actions"))
    return record_from_json(TrainConfig, found)
