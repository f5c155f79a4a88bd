"""A policy as `mechsearch export policy` writes it: a network for onnxruntime, and what it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mechsearch.camera import Camera, preset
from mechsearch.observe.observation import KINDS
from mechsearch.pushes.chooser import PushChooser
from mechsearch.pushes.push import NUMBERS, PATCH, Push, Sight, view_pushes
from mechsearch.robot.network import Exported, Network, open_exported, tensors
from mechsearch.types import Array, Floats, Observation, select

_BY_NETWORK = ("K", "N")
_PUSH_TENSORS = {
    "patches": (("N", *PATCH), "float16", "dm above table and fingertip, shares of target and way"),
    "numbers": (("N", NUMBERS), "float32", "as `pushes.push.view_pushes` returns them"),
    "planned": (("N",), "float32", "actions"),
    "value": (("N",), "float32", "reward"),
    "uncovered": (_BY_NETWORK, "float32", "probability"),
    "occlusion": (_BY_NETWORK, "float32", "share of the target"),
    "actions": (_BY_NETWORK, "float32", "actions"),
}
_ACTION = {"action": ((1, 3), "float32", "5 cm along the workspace's axes")}
_OUTPUTS = {"pushes": ("value", "uncovered", "occlusion", "actions"), "actions": ("action",)}


def described_tensors(
    kind: str, keys: Sequence[str], size: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the inputs and outputs of a kind of network by name: shape, dtype and unit each.

    Args:
        kind: "pushes", N of which K networks judge, or "actions".
        keys: Of the observations that a network of actions reads.
        size: Side of its images [px].
    """
    known: dict[str, Any] = _PUSH_TENSORS
    if kind == "actions":
        sides = {"H": size, "W": size}
        known = _ACTION | {
            key: (
                (1, *(sides.get(str(n), n) for n in seen.shape)),
                seen.dtype.__name__,
                seen.meaning,
            )
            for key, seen in KINDS.items()
            if key in keys
        }
        inputs: Sequence[str] = keys
    else:
        inputs = [name for name in known if name not in _OUTPUTS[kind]]
    rows = tensors(known)
    return {n: rows[n] for n in inputs}, {n: rows[n] for n in _OUTPUTS[kind]}


@dataclass(frozen=True)
class Description(Exported):
    """What stands beside the network, of the kind "pushes" or "actions"; see `described_tensors`.

    Attributes:
        camera: View of the images, a name for `camera.preset`.
        low: Lowest corner of the workspace (3,) [m].
        high: Highest corner (3,) [m].
        candidates: Pushes to judge each time; 0 where it judges none.
        searches: Whether it looks for a hidden target all over the heap; see `PushChooser`.
        full_steps: Whether its pushes are carried out by actions of full length.
    """

    camera: str
    low: Sequence[float]
    high: Sequence[float]
    candidates: int
    searches: bool
    full_steps: bool = False


@dataclass(frozen=True)
class Expectation:
    """What a policy expects of the push that it has chosen.

    Attributes:
        uncovered: Probability that it uncovers the target.
        occlusion: Of the target afterwards, in [0, 1].
        actions: How many it takes.
    """

    uncovered: float
    occlusion: float
    actions: float


@dataclass(frozen=True)
class Choice:
    """What a policy would do.

    Attributes:
        action: Displacement (3,), 1 is 5 cm along an axis of the workspace.
        reason: In words.
        confidence: How well its networks agree, in [0, 1]: 1 less the range of their
            probabilities that the push uncovers the target; None where there are not several.
        expects: Of the whole push; None of a policy that chooses single actions.
    """

    action: Array
    reason: str
    confidence: float | None
    expects: Expectation | None


class Chooser(Protocol):
    """An exported policy."""

    description: Description
    camera: Camera

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def choose(self, obs: Observation) -> Choice:
        """Return what to do after an observation."""


def open_policy(folder: str | Path) -> Chooser:
    """Return a policy that `mechsearch export policy` wrote; needs the `robot` extra.

    Raises:
        MechSearchError: If it is missing, damaged, or written for another version.
    """
    kinds: dict[str, type[ExportedPushes | ExportedActor]] = {
        "pushes": ExportedPushes, "actions": ExportedActor,
    }  # fmt: skip
    description, network = open_exported(Path(folder), "policy", Description, list(kinds))
    return kinds[description.kind](description, network)


class ExportedPushes(PushChooser):
    """Chooses whole pushes; see `push_values.policy.PushPolicy`."""

    def __init__(self, description: Description, network: Network) -> None:
        """Take an exported policy's parts; see `open_policy`."""
        self.description, self._network = description, network
        view = preset(description.camera, description.image_size)
        super().__init__(view, description.candidates, description.searches, description.full_steps)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; candidates come from `rng`."""
        super().reset(rng)
        self._judged = Choice(np.zeros(3, np.float32), "", None, None)
        self._begins = False

    def choose(self, obs: Observation) -> Choice:
        """Return the next action of the present push, or of a new one."""
        self._begins = False
        action = self.act(obs)
        last = self._judged
        reason = f"{'begins' if self._begins else 'goes on with'} {last.reason}"
        return Choice(action, reason, last.confidence, last.expects)

    def judge(self, pushes: Sequence[Push], sight: Sight) -> Floats:
        """Return the rewards expected of pushes and of what follows them (n,)."""
        return np.asarray(self._seen(pushes, sight)["value"], np.float64)

    def best(self, pushes: Sequence[Push], sight: Sight) -> int:
        """Return the index of the best push, and keep what is expected of it."""
        found = self._seen(pushes, sight)
        index = int(np.argmax(found["value"]))
        uncovered = found["uncovered"][:, index]
        means = (float(found[n][:, index].mean()) for n in ("uncovered", "occlusion", "actions"))
        push, several = pushes[index], len(uncovered) > 1
        way = f"{push.kind} push towards {np.rad2deg(push.direction):.0f} degrees"
        self._judged = Choice(
            np.zeros(3, np.float32), f"a {way}, the best of {len(pushes)}",
            1 - float(np.ptp(uncovered)) if several else None, Expectation(*means),
        )  # fmt: skip
        self._begins = True
        return index

    def _seen(self, pushes: Sequence[Push], sight: Sight) -> dict[str, Array]:
        views = view_pushes(pushes, sight)
        return self._network(patches=views.patches, numbers=views.numbers, planned=views.actions)


class ExportedActor:
    """Chooses single actions; see `actor_critic.policy.ActorPolicy`."""

    def __init__(self, description: Description, network: Network) -> None:
        """Take an exported policy's parts; see `open_policy`."""
        self.description, self._network = description, network
        self.camera = preset(description.camera, description.image_size)
        self.keys = tuple(description.inputs)

    def reset(self, rng: np.random.Generator) -> None:
        """Do nothing: an actor remembers nothing."""

    def choose(self, obs: Observation) -> Choice:
        """Return the action for one observation."""
        inputs = {
            key: np.asarray(value, KINDS[key].dtype)[None]
            for key, value in select(obs, self.keys).items()
        }
        action = self._network(**inputs)["action"][0]
        return Choice(action, "the actor's action", None, None)
