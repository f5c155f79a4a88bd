"""Scores on the way: the bare policy, without noise or teachers."""

from collections.abc import Callable, Mapping

from mechsearch.train.log import RunLog
from mechsearch.types import Policy


def evaluate(
    policy: Policy,
    step: int,
    evaluators: Mapping[str, Callable[[Policy], Mapping[str, float]]],
    log: RunLog,
) -> dict[str, float]:
    """Score a policy on every set of heaps, and log it; return the first set's scores."""
    found: dict[str, dict[str, float]] = {}
    for name, evaluator in evaluators.items():
        found[name] = dict(evaluator(policy))
        log.write(name, step, found[name])
    return next(iter(found.values()), {})


def label(name: str, scores: Mapping[str, float]) -> str:
    """Return what a progress bar shows: the run and its last evaluation."""
    shown = [
        text
        for key, text in (
            ("reward", f"reward {scores.get('reward', 0):.1f}"),
            ("uncovered_rate", f"uncovered {scores.get('uncovered_rate', 0):.0%}"),
        )
        if key in scores
    ]
    return ", ".join((name, *shown))
