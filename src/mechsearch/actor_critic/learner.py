"""Deterministic policy gradient with a Bayesian, asymmetric critic (paper, III-C; AC-Teach)."""

import copy
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from mechsearch.actor_critic.networks import Actor, Critic, NetworkConfig, Shapes, Tensors
from mechsearch.actor_critic.replay import Batch, Replay
from mechsearch.actor_critic.symmetry import SYMMETRIES, TURNS, transform
from mechsearch.files.tensors import fill, fill_optimizer, optimizer_tensors, part, prefixed
from mechsearch.types import Array, MechSearchError

Metrics = dict[str, float]


@dataclass(frozen=True)
class LearnerConfig:
    """What the updates need; the paper leaves all of it open.

    Attributes:
        actor_rate: Learning rate of the actor (AC-Teach: 1e-4).
        critic_rate: Learning rate of the critic (AC-Teach: 1e-3).
        gamma: Discount of one action.
        tau: Share of the critic that enters its target at each update.
        actor_tau: Likewise of the actor. Its target, a running average, is what is evaluated; in
            the beginning it is the mean of all actors so far.
        batch: Transitions an update.
        reward_scale: What multiplies rewards before the critic sees them.
        dropout: Share of the critic's hidden units dropped; 0 makes it an ordinary critic.
        samples: Dropout copies of the critic that choose an action (AC-Teach: 50).
        update_samples: Dropout copies that an update averages over (AC-Teach: 50; Henderson, whose
            loss it is: 10). They are most of an update's time.
        alpha: Of the alpha-divergence loss (AC-Teach: 0.5).
        precision: Of an observed return in that loss, AC-Teach's tau, in scaled units.
        saturation_penalty: Weight of the mean square of the actor's output before the tanh, or of
            the distance of its length from 1 where that is normalised.
        normalise_value: Divide the actor's loss by the mean |Q|, so that scales do not matter.
        imitation: Weight, beside that loss, of what draws the actor to what teachers did
            (behaviour cloning beside a policy gradient: Nair et al. 2018); 0 is the paper's loss.
        worst: Share of all that was done, that of the episodes of lowest return, which is not
            imitated.
        max_gradient: Gradients longer than this are shortened to it; 0 leaves them.
        symmetry: Turn and mirror every batch at random (overhead camera only).
        mirrors: Whether symmetry mirrors too, or only turns: a teacher whose spirals have a hand
            is another one in a mirror.
        network: Sizes of the networks.
    """

    actor_rate: float = 3e-4
    critic_rate: float = 1e-3
    gamma: float = 0.97
    tau: float = 0.01
    actor_tau: float = 0.002
    batch: int = 64
    reward_scale: float = 0.1
    dropout: float = 0.1
    samples: int = 50
    update_samples: int = 10
    alpha: float = 0.5
    precision: float = 10.0
    saturation_penalty: float = 0.003
    normalise_value: bool = True
    imitation: float = 3.0
    worst: float = 0.4
    max_gradient: float = 10.0
    symmetry: bool = True
    mirrors: bool = True
    network: NetworkConfig = field(default_factory=lambda: NetworkConfig(directions=True))

    def __post_init__(self) -> None:
        for name in ("actor_rate", "critic_rate", "alpha", "precision", "reward_scale"):
            if not getattr(self, name) > 0:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected more than 0")
        for name in ("batch", "samples", "update_samples"):
            if getattr(self, name) < 1:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected at least 1")
        for name in ("gamma", "tau", "actor_tau"):
            if not 0 < getattr(self, name) <= 1:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected (0, 1]")
        if self.imitation < 0 or not 0 <= self.worst < 1:
            raise MechSearchError(
                f"imitation is {self.imitation} and worst {self.worst}; expected at least 0, and a "
                "share below 1"
            )
        if not 0 <= self.dropout < 1:
            raise MechSearchError(f"dropout is {self.dropout}; expected a share in [0, 1)")


@dataclass(frozen=True)
class TensorBatch:
    """A batch as tensors, rewards scaled; fields as in `Batch`."""

    obs: Tensors
    action: Tensor
    reward: Tensor
    discount: Tensor
    next_obs: Tensors
    taught: Tensor


def straying(action: Tensor, recorded: Tensor, taught: Tensor, lengths: bool = False) -> Tensor:
    """Return 1 less the cosine between actions and what teachers did, averaged over the latter.

    Directions are compared and not squared distances, since teachers disagree: the mean of their
    actions is a short one, and an actor that learnt it would hover.

    Args:
        action: The actor's (B, 3).
        recorded: Executed actions (B, 3).
        taught: Which of them to learn (B,); with none, the result is 0.
        lengths: Add the squared difference of their lengths.
    """
    aligned = nn.functional.cosine_similarity(action, recorded, dim=1)
    apart = 1 - aligned
    if lengths:
        apart = apart + (action.norm(dim=1) - recorded.norm(dim=1)).square()
    return (apart * taught).sum() / taught.sum().clamp_min(1)


def alpha_divergence(errors: Tensor, alpha: float, precision: float) -> Tensor:
    """Return AC-Teach's critic loss, averaged over the batch.

    Args:
        errors: Target minus Q (K, B) under K dropout samples.
        alpha: Near 0 it is the mean squared error; larger, the best sample counts more.
        precision: Of an observed return.

    The mean over samples replaces their sum, which shifts the loss by a constant.
    """
    exponent = -0.5 * alpha * precision * errors.square()
    evidence = torch.logsumexp(exponent, dim=0) - np.log(len(errors))
    loss: Tensor = -evidence.mean() / alpha
    return loss


class Learner:
    """Actor, critic and their targets, and the updates that improve them."""

    def __init__(
        self, actor_shapes: Shapes, critic_shapes: Shapes, config: LearnerConfig, seed: int
    ) -> None:
        """Build the networks; torch's own seed decides their first weights.

        Args:
            actor_shapes: Shape of every observation that the actor reads.
            critic_shapes: Likewise for the critic.
            config: Hyper-parameters.
            seed: Of the dropout masks.
        """
        self.config = config
        self.actor = Actor(actor_shapes, config.network)
        self.critic = Critic(critic_shapes, config.network, config.dropout)
        self.actor_target = copy.deepcopy(self.actor).requires_grad_(False)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.actor_optimizer = _adam(self.actor, config.actor_rate)
        self.critic_optimizer = _adam(self.critic, config.critic_rate)
        self.generator = torch.Generator().manual_seed(seed)
        self.updates = 0

    def _masks(self, batch: int) -> list[Tensor]:
        if not self.config.dropout:
            return []
        return self.critic.draw_masks(self.config.update_samples, batch, self.generator)

    def update(
        self, replay: Replay, rng: np.random.Generator, beside: Executor | None = None
    ) -> Metrics:
        """Draw one batch and improve critic, actor and targets with it.

        Args:
            replay: What to draw from.
            rng: Source of randomness.
            beside: A thread for the actor's look at the batch: the critic's step changes nothing
                in it, so neither need wait for the other.
        """
        batch = self._tensors(replay.sample(self.config.batch, rng))
        looked = beside.submit(self.actor.raw, batch.obs) if beside else None
        metrics = self.update_critic(batch)
        metrics |= self.update_actor(batch, looked.result() if looked else None)
        self.update_target()
        return metrics

    def _tensors(self, batch: Batch) -> TensorBatch:
        now = {**_tensors(batch.obs), "action": torch.as_tensor(batch.action)}
        after = _tensors(batch.next_obs)
        if self.config.symmetry:
            # One for the whole batch: turning each sample by itself costs a fifth of an update.
            symmetries = SYMMETRIES if self.config.mirrors else TURNS
            drawn = int(torch.randint(len(symmetries), (), generator=self.generator))
            now, after = (transform(keys, symmetries[drawn]) for keys in (now, after))
        reward = torch.as_tensor(batch.reward) * self.config.reward_scale
        return TensorBatch(
            now,
            now.pop("action"),
            reward,
            torch.as_tensor(batch.discount),
            after,
            torch.as_tensor(batch.taught),
        )

    def bellman_target(self, batch: TensorBatch) -> Tensor:
        """Return r + discount * Q'(s', a') (B,), with the target networks."""
        with torch.no_grad():
            action = self.actor_target(batch.next_obs)
            value: Tensor = self.critic_target(batch.next_obs, action)
            return batch.reward + batch.discount * value

    def update_critic(self, batch: TensorBatch) -> Metrics:
        """Take one step towards the Bellman target; return losses and Q."""
        target = self.bellman_target(batch)
        q = self.critic(batch.obs, batch.action, self._masks(len(target)))
        errors = target - q
        if self.config.dropout:
            loss = alpha_divergence(errors, self.config.alpha, self.config.precision)
        else:
            loss = errors.square().mean()
        length = self._step(self.critic_optimizer, self.critic, loss)
        return {
            "critic_loss": loss.item(),
            "critic_gradient": length,
            "bellman_error": errors.abs().mean().item() / self.config.reward_scale,
            "q": q.mean().item() / self.config.reward_scale,
        }

    def update_actor(self, batch: TensorBatch, output: Tensor | None = None) -> Metrics:
        """Take one step towards actions of higher Q; return the loss and how saturated it is.

        Args:
            batch: What was done.
            output: The actor's, if it has looked already.
        """
        output = self.actor.raw(batch.obs) if output is None else output
        action = self.actor.squash(output)
        with torch.no_grad():
            features = self.critic.encode(batch.obs)
        # The critic only passes the gradient on: its own would cost a third of the time.
        self.critic.requires_grad_(False)
        q = self.critic.value(features, action, self._masks(len(action)))
        self.critic.requires_grad_(True)
        scale = q.detach().abs().mean() if self.config.normalise_value else 1.0
        strays = straying(action, batch.action, batch.taught, self.config.network.lengths)
        loss = (
            -q.mean() / (scale + 1e-6)
            + self.config.imitation * strays
            + self.config.saturation_penalty * self.actor.excess(output)
        )
        length = self._step(self.actor_optimizer, self.actor, loss)
        return {
            "actor_loss": loss.item(),
            "actor_gradient": length,
            "strays": strays.item(),
            "output": output.detach().abs().mean().item(),
            "saturated": (action.detach().abs() > 0.99).float().mean().item(),
        }

    def _step(self, optimizer: torch.optim.Optimizer, network: nn.Module, loss: Tensor) -> float:
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        limit = self.config.max_gradient or float("inf")
        length = nn.utils.clip_grad_norm_(network.parameters(), limit)
        optimizer.step()
        return float(length)

    @torch.no_grad()
    def update_target(self) -> None:
        """Move both target networks their share towards their networks."""
        self.updates += 1
        for network, target, tau in (
            (self.actor, self.actor_target, max(self.config.actor_tau, 1 / self.updates)),
            (self.critic, self.critic_target, self.config.tau),
        ):
            torch._foreach_lerp_(list(target.parameters()), list(network.parameters()), tau)

    def state(self) -> dict[str, Tensor]:
        """Return all that a resume needs, by name."""
        state = {
            "generator": self.generator.get_state(),
            "updates": torch.tensor(self.updates),
        }
        for name, network in self._networks().items():
            state |= prefixed(name, network.state_dict())
        for name, optimizer in self._optimizers().items():
            state |= prefixed(name, optimizer_tensors(optimizer))
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned.

        Raises:
            MechSearchError: If it is of other networks.
        """
        for name, network in self._networks().items():
            fill(network, part(state, name))
        for name, optimizer in self._optimizers().items():
            fill_optimizer(optimizer, part(state, name))
        self.generator.set_state(state["generator"])
        self.updates = int(state["updates"])

    def _networks(self) -> dict[str, nn.Module]:
        names = ("actor", "critic", "actor_target", "critic_target")
        return {name: getattr(self, name) for name in names}

    def _optimizers(self) -> dict[str, Any]:
        return {n: getattr(self, n) for n in ("actor_optimizer", "critic_optimizer")}


def _adam(network: nn.Module, rate: float) -> torch.optim.Optimizer:
    return torch.optim.Adam(network.parameters(), rate, fused=True)


def _tensors(arrays: Mapping[str, Array]) -> dict[str, Tensor]:
    return {key: torch.as_tensor(value) for key, value in arrays.items()}
