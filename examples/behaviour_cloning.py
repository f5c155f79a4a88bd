"""A teacher's clone: `mechsearch train behaviour_cloning:Cloning --heaps HEAPS --out RUN`."""

import json
from dataclasses import dataclass

import numpy as np
import torch

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.algorithm import Algorithm, Line
from mechsearch.files.tensors import fill, part, prefixed
from mechsearch.types import ACTOR_KEYS, select


@dataclass(frozen=True)
class Cloning(Algorithm):
    """Its options; `teacher` is who is cloned, `passes` how often a fit sees every action."""

    teacher: str = "spiral"
    rate: float = 1e-3
    passes: int = 5
    keys, teachers = ACTOR_KEYS, property(lambda self: (self.teacher,))
    save, load = ActorCritic.save, ActorCritic.load

    def begin(self, run, setup, folder):
        """Return a session at its beginning."""
        torch.manual_seed(run.seed)
        shapes = {key: setup.env.observation_space[key].shape for key in ACTOR_KEYS}
        return Watching(self, setup, run.seed, Actor(shapes, NetworkConfig()))


class Watching:
    """What was seen of the teacher, as tensors by key, and the actor that is fitted to it."""

    policy = property(lambda self: ActorPolicy(self.actor))

    def __init__(self, options, setup, seed, actor):
        self.options, self.env, self.heaps, self.actor = options, setup.env, setup.heaps, actor
        self.teacher, self.rng = setup.teachers[options.teacher], np.random.default_rng(seed)
        self.executed, self.seen = 0, {}

    def advance(self, until):
        """Watch one episode."""
        heap, *seeds = self.rng.choice(self.heaps), *self.rng.integers(2**31, size=2)
        obs, info = self.env.reset(seed=int(seeds[0]), options={"heap": int(heap)})
        self.teacher.reset(np.random.default_rng(seeds[1]))
        rows, info = [], {"end": None}
        while info["end"] is None:
            rows.append({**obs, "action": self.teacher.act(select(obs, self.teacher.keys))})
            obs, _, _, _, info = self.env.step(rows[-1]["action"])
        for key in (*ACTOR_KEYS, "action"):
            new = torch.as_tensor(np.stack([row[key] for row in rows]))
            self.seen[key] = torch.cat([self.seen.get(key, new[:0]), new])
        self.executed += len(rows)
        yield [Line("episode", self.executed, {"heap": int(heap), "end": info["end"]})]

    def catch_up(self, step):
        """Fit the actor to everything that was seen."""
        adam = torch.optim.Adam(self.actor.parameters(), self.options.rate)
        order = self.rng.permutation(self.options.passes * self.executed) % self.executed
        for rows in torch.from_numpy(order).split(64):
            batch = {key: values[rows] for key, values in self.seen.items()}
            loss = (self.actor(batch) - batch["action"]).square().mean()
            adam.zero_grad(), loss.backward(), adam.step()
        return [Line("fit", step, {"loss": loss.item()})]

    def archive(self):
        """Return all that `restore` needs."""
        tensors = prefixed("seen", self.seen) | prefixed("actor", self.actor.state_dict())
        return tensors, {"executed": self.executed, "rng": json.dumps(self.rng.bit_generator.state)}

    def restore(self, tensors, facts):
        """Go on where `archive` was called."""
        self.seen, self.executed = part(tensors, "seen"), facts["executed"]
        self.rng.bit_generator.state = json.loads(facts["rng"])
        fill(self.actor, part(tensors, "actor"))
