"""How a policy of whole pushes acts, whatever judges them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.pushes.push import PlannedPush, Push, Sight, draw_places, draw_pushes, look
from mechsearch.types import ACTOR_KEYS, PUSH, Floats, Observation, Weighed

_UNSEEN = np.array([0.0, 0.0, 0.03])
"""Where a target is looked for that was never visible (3,) [m]: in the middle of the heap."""


class PushChooser(ABC):
    """Looks, judges random pushes, carries out the best to its end, and looks again.

    Attributes:
        camera: View of the images.
        candidates: Pushes to judge each time.
        searches: Whether a hidden target is looked for all over the heap, and not only where it was
            seen last.
        full_steps: Whether pushes are carried out by actions of full length; see `Push`.
    """

    keys: tuple[str, ...] = ACTOR_KEYS
    on_demand = True
    """Images are read where a push is chosen, and not while it is carried out."""

    def __init__(
        self, camera: Camera, candidates: int, searches: bool = False, full_steps: bool = False
    ) -> None:
        """Take what the attributes say."""
        self.camera, self.candidates = camera, candidates
        self.searches, self.full_steps = searches, full_steps
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; candidates come from `rng`."""
        self._rng = rng
        self._push: PlannedPush | None = None
        self._compared: tuple[Sequence[Push], Floats, Sight] | None = None
        self._last_seen = _UNSEEN
        self._looked: list[Floats] = []

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the next action (3,) of the present push, or of a new one."""
        action = None if self._push is None else self._push.act(obs)
        self._compared = None
        if action is None:
            sight = self.see(obs)
            pushes = self.draw(sight, self._rng)
            self._push = self.begin(pushes[self.best(pushes, sight)], sight)
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

    def draw(self, sight: Sight, rng: np.random.Generator) -> list[Push]:
        """Return random pushes to judge.

        Of a searcher, they are about places all over the heap where the target is hidden; half of
        them, if it was seen before.
        """
        pushes = draw_pushes(self.candidates, rng, self.full_steps)
        if not self.searches or sight.target.any() or not len(sight.obstacles):
            return pushes
        first = 0 if self._last_seen is _UNSEEN else len(pushes) // 2
        places = draw_places(len(pushes) - first, sight.obstacles, self._looked, rng)
        offsets = (places - self._last_seen[:2]).tolist()
        moved = [
            replace(push, offset=(x, y))
            for push, (x, y) in zip(pushes[first:], offsets, strict=True)
        ]
        return [*pushes[:first], *moved]

    def begin(self, push: Push, sight: Sight) -> PlannedPush:
        """Return a push as it is carried out; where it looks for the target is remembered."""
        assert sight.centre is not None
        if self.searches and not sight.target.any():
            self._looked.append(sight.centre[:2] + np.array(push.offset))
        return PlannedPush(push, sight)

    def best(self, pushes: Sequence[Push], sight: Sight) -> int:
        """Return the index of the best push."""
        values = self.judge(pushes, sight)
        self._compared = pushes, values, sight
        return int(np.argmax(values))

    @abstractmethod
    def judge(self, pushes: Sequence[Push], sight: Sight) -> Floats:
        """Return the rewards expected of pushes and of what follows them (n,)."""
