"""A person's clone: `mechsearch train demonstrations:Imitation --episodes FILES ...`.

FILES are recorded episodes: of `mechsearch view`, in which somebody pushed by hand, or of
`mechsearch evaluate`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from behaviour_cloning import Cloning, Watching

from mechsearch.algorithm import Line
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.frames import frames_of
from mechsearch.types import ACTOR_KEYS, MechSearchError


@dataclass(frozen=True)
class Imitation(Cloning):
    """Its options, those of `Cloning`, and `episodes`, the files of what is imitated."""

    episodes: tuple[str, ...] = ()

    def begin(self, run, setup, folder):
        """Return a session at its beginning."""
        return Remembering(self, setup, run.seed, super().begin(run, setup, folder).actor)


class Remembering(Watching):
    """What was seen in recorded episodes, in their order, and from the first again."""

    def __init__(self, options, setup, seed, actor):
        super().__init__(options, setup, seed, actor)
        spaces = setup.env.observation_space
        shape = {key: spaces[key].shape for key in ACTOR_KEYS} | {"action": (3,)}
        self.steps, self.records = [], []
        for file in options.episodes:
            for frames in frames_of(load_episodes(file), lost=print):
                record = frames.record
                steps = {k: v[:-1] for k, v in frames.observations.items()}
                steps["action"] = record.actions
                if any(key not in steps or steps[key].shape[1:] != shape[key] for key in shape):
                    raise MechSearchError(f"{file} has other images or actions; expected {shape}")
                self.steps.append(steps), self.records.append(record)
        if not self.records:
            raise MechSearchError("nothing to imitate; name files of recorded episodes: --episodes")
        self.ends = np.cumsum([len(record.actions) for record in self.records])

    def advance(self, until):
        """Remember one episode."""
        number = np.searchsorted(self.ends, self.executed % self.ends[-1], "right")
        steps, record = self.steps[number], self.records[number]
        for key in (*ACTOR_KEYS, "action"):
            new = torch.as_tensor(steps[key])
            self.seen[key] = torch.cat([self.seen.get(key, new[:0]), new])
        self.executed += len(record.actions)
        yield [Line("episode", self.executed, {"policy": record.policy, "end": record.end})]
