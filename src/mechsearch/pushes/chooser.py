"""How a policy of whole pushes acts, whatever judges them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.pushes.push import PlannedPush, Push, Sight, draw_pushes, look
from mechsearch.types import ACTOR_KEYS, PUSH, Floats, Observation, Weighed

_UNSEEN = np.array([0.0, 0.0, 0.03])
"""Where a target is looked for that was never visible (3,) [m]: in the middle of the heap."""


class PushChooser(ABC):
    """Looks, judges random pushes, carries out the best to its end, and looks again.

    Attributes:
        camera: View of the images.
        candidates: Pushes to judge each time.
    """

    keys: tuple[str, ...] = ACTOR_KEYS

    def __init__(self, camera: Camera, candidates: int) -> None:
        """Take the view, and how many pushes to judge."""
        self.camera, self.candidates = camera, candidates
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; candidates come from `rng`."""
        self._rng = rng
        self._push: PlannedPush | None = None
        self._compared: tuple[Sequence[Push], Floats, Sight] | None = None
        self._last_seen = _UNSEEN

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the next action (3,) of the present push, or of a new one."""
        action = None if self._push is None else self._push.act(obs)
        self._compared = None
        if action is None:
            sight = self.see(obs)
            pushes = draw_pushes(self.candidates, self._rng)
            self._push = PlannedPush(pushes[self.best(pushes, sight)], sight)
            action = self._push.act(obs)
        return np.zeros(3, np.float32) if action is None else action

    @property
    def weighed(self) -> Weighed | None:
        """What the last action was chosen among; see `Weighed`."""
        if self._compared is None:
            return None
        pushes, values, sight = self._compared
        ways = tuple(PlannedPush(push, sight).way for push in pushes)
        chosen = int(np.argmax(values))
        return Weighed((PUSH,) * len(ways), ways, values, chosen, "reward expected from here")

    def see(self, obs: Observation) -> Sight:
        """Return what an observation shows; a hidden target counts as where it was seen last."""
        sight = look(obs, self.camera)
        if sight.centre is None:
            return replace(sight, centre=self._last_seen)
        self._last_seen = sight.centre
        return sight

    def best(self, pushes: Sequence[Push], sight: Sight) -> int:
        """Return the index of the best push."""
        values = self.judge(pushes, sight)
        self._compared = pushes, values, sight
        return int(np.argmax(values))

    @abstractmethod
    def judge(self, pushes: Sequence[Push], sight: Sight) -> Floats:
        """Return the rewards expected of pushes and of what follows them (n,)."""
