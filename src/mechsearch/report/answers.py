"""Answers about an experiment, in figures and in words."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.evaluation.metrics import Estimate
from mechsearch.report.experiment import Experiment
from mechsearch.report.tables import MINUS, number
from mechsearch.types import Floats

HOLDS, FAILS, UNDECIDED, UNMEASURED = "holds", "does not hold", "undecided", "not measured"


@dataclass(frozen=True)
class Answer:
    """What was found.

    Attributes:
        about: Condition and metric.
        figures: Means, difference and interval in words.
        verdict: "holds", "does not hold", "undecided" or "not measured".
        test: Number of heaps and seeds behind it.
        estimate: The number that was compared with the threshold.
    """

    about: str
    figures: str
    verdict: str
    test: str = ""
    estimate: Estimate | None = None


def verdict(estimate: Estimate, threshold: float, above: bool) -> str:
    """Return whether an estimate lies above (or below) a threshold with its whole interval."""
    if estimate.ci_low > threshold:
        return HOLDS if above else FAILS
    if estimate.ci_high < threshold:
        return FAILS if above else HOLDS
    return UNDECIDED


def sizes(matrices: Sequence[Floats], names: Sequence[str], experiment: Experiment) -> str:
    """Return how many heaps and training seeds stand behind a number."""
    trained = {
        trial.name
        for condition in experiment.conditions.values()
        for trials in condition.trials.values()
        for trial in trials
        if trial.trained
    }
    kept = [(m, n) for m, n in zip(matrices, names, strict=True) if n in trained]
    heaps = f"{matrices[0].shape[1]} heaps"
    if not kept:
        return heaps
    return f"{heaps}, {seeds_of([m for m, _ in kept], [n for _, n in kept])}"


def signed(metric: str, estimate: Estimate) -> str:
    """Return a difference, with its interval if it has one."""
    ends = (estimate.mean, estimate.ci_low, estimate.ci_high)
    return _with_interval([number(metric, end, signed=True) for end in ends], estimate)


def percent(estimate: Estimate) -> str:
    """Return a share, with its interval if it has one."""
    ends = (estimate.mean, estimate.ci_low, estimate.ci_high)
    # What rounds to nothing has no sign.
    shown = [f"{round(end, 2) + 0.0:.0%}".replace("-", MINUS) for end in ends]
    return _with_interval(shown, estimate)


def _with_interval(shown: Sequence[str], estimate: Estimate) -> str:
    mean, low, high = shown
    return mean if np.isnan(estimate.ci_low) else f"{mean} ({low} to {high})"


def seeds_of(matrices: Sequence[Floats], names: Sequence[str]) -> str:
    """Return how many training seeds each policy has, and what an interval of one covers."""
    numbers = [len(values) for values in matrices]
    if set(numbers) == {1}:
        return "1 seed: the interval covers heaps only"
    if len(set(numbers)) == 1:
        return f"{numbers[0]} seeds"
    parts = (f"{name} {count}" for name, count in zip(names, numbers, strict=True))
    text = f"seeds: {', '.join(parts)}"
    return text + "; of one seed, heaps only" if 1 in numbers else text
