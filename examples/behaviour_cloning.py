"""An algorithm of your own: the clone of a teacher, from images, in 80 lines.

mechsearch train examples.behaviour_cloning:Cloning --heaps HEAPS --out runs/clone
"""

import json
from dataclasses import dataclass

import numpy as np
import torch

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.algorithm import Line
from mechsearch.files.tensors import fill, part, prefixed
from mechsearch.types import ACTOR_KEYS, select


@dataclass(frozen=True)
class Cloning:
    """Its options; `teacher` is who is cloned, `passes` how often a fit sees every action."""

    teacher: str = "spiral"
    rate: float = 1e-3
    passes: int = 5
    keys, teachers = ACTOR_KEYS, property(lambda self: (self.teacher,))
    save, load = ActorCritic.save, ActorCritic.load

    def check(self, task):
        """Take any task."""

    def begin(self, run, setup, folder):
        """Return a session at its beginning."""
        torch.manual_seed(run.seed)
        return Watching(self, setup, np.random.default_rng(run.seed))


class Watching:
    """What was seen of the teacher, as tensors by key, and the actor that is fitted to it."""

    def __init__(self, options, setup, rng):
        self.options, self.setup, self.rng, self.executed, self.seen = options, setup, rng, 0, {}
        space = setup.env.observation_space
        self.actor = Actor({key: space[key].shape for key in ACTOR_KEYS}, NetworkConfig())
        self.policy = ActorPolicy(self.actor)

    def advance(self, until):
        """Watch one episode."""
        heap, *seeds = int(self.rng.choice(self.setup.heaps)), *self.rng.integers(2**31, size=2)
        obs, info = self.setup.env.reset(seed=int(seeds[0]), options={"heap": heap})
        teacher, rows, total, end = self.setup.teachers[self.options.teacher], [], 0.0, None
        teacher.reset(np.random.default_rng(seeds[1]))
        while end is None:
            action = teacher.act(select(obs, teacher.keys))
            rows.append(select(obs, ACTOR_KEYS) | {"action": action})
            obs, reward, _, _, info = self.setup.env.step(action)
            total, end = total + reward, info["end"]
        for key in rows[0]:
            new = [torch.as_tensor(np.stack([row[key] for row in rows]))]
            self.seen[key] = torch.cat([self.seen[key], *new] if key in self.seen else new)
        self.executed += len(rows)
        yield [Line("episode", self.executed, {"heap": heap, "end": end, "return": total})]

    def catch_up(self, step):
        """Fit the actor to everything that was seen."""
        adam = torch.optim.Adam(self.actor.parameters(), self.options.rate)
        order = self.rng.permutation(self.options.passes * self.executed) % self.executed
        for rows in torch.from_numpy(order).split(64):
            batch = {key: values[rows] for key, values in self.seen.items()}
            loss = (self.actor(batch) - batch["action"]).square().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
        self.policy = ActorPolicy(self.actor)
        return [Line("fit", step, {"loss": loss.item()})]

    def archive(self):
        """Return all that `restore` needs."""
        tensors = prefixed("seen", self.seen) | prefixed("actor", self.actor.state_dict())
        return tensors, {"executed": self.executed, "rng": json.dumps(self.rng.bit_generator.state)}

    def restore(self, tensors, facts):
        """Go on where `archive` was called."""
        self.seen, self.executed = part(tensors, "seen"), facts["executed"]
        fill(self.actor, part(tensors, "actor"))
        self.policy, self.rng.bit_generator.state = (
            ActorPolicy(self.actor),
            json.loads(facts["rng"]),
        )
