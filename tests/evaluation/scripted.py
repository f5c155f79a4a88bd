"""Policies of retrieval that know where the target is."""

import numpy as np

from mechsearch.env.decision import Decision
from mechsearch.geometry import yaw_quaternion


class Scripted:
    """Pushes towards the target and grasps at its centre, in turn, each time turned further."""

    goal = "retrieve"
    keys = ("ee_position", "target_offset")

    def reset(self, rng):
        self._rng, self._decisions = rng, 0

    def act(self, obs):
        self._decisions += 1
        if self._decisions % 2:
            return Decision.push(np.clip(obs["target_offset"] / 0.05, -1, 1)).vector()
        centre = np.asarray(obs["ee_position"] + obs["target_offset"], np.float64)
        turn = yaw_quaternion(self._rng.uniform(0, np.pi))
        return Decision.grasp([*np.clip(centre, [-0.4, -0.4, 0], 0.25), *turn]).vector()


class Equipped(Scripted):
    """Wants to know its grippers."""

    def equip(self, grippers):
        self.grippers = grippers
        if "jaws-56" in grippers:
            from mechsearch.types import MechSearchError

            raise MechSearchError("no network for jaws-56; choose jaws-85")


class Aimless(Scripted):
    """Has a goal that there is not."""

    goal = "tidy"
