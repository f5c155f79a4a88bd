"""Decisions of retrieval as `env.trial.roll_out` wants them proposed: one after the other."""

from collections.abc import Callable

from mechsearch.env.decision import Decision
from mechsearch.pushes.view import PlannedPush
from mechsearch.types import Array, Observation

Propose = Callable[[Observation], Array | None]
"""Returns the vector (9,) of the next decision, or None at the end."""


def pushing(planned: PlannedPush) -> Propose:
    """Return what proposes a push from its beginning to its end."""

    def propose(obs: Observation) -> Array | None:
        action = planned.act(obs)
        return None if action is None else Decision.push(action).vector()

    return propose


def once(decision: Decision) -> Propose:
    """Return what proposes a decision, and then nothing more."""
    left: list[Array] = [decision.vector()]
    return lambda obs: left.pop() if left else None
