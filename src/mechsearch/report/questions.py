"""Questions to an experiment, each answered by one number with its interval.

Every question has a threshold: the answer is yes if the whole 95 % interval lies on the side that
the question names, no if it lies on the other, and undecided if it holds the threshold. Intervals
are of the crossed bootstrap over training seeds and heaps (`bootstrap`).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import stats

from mechsearch.evaluation.metrics import HIGHER_IS_BETTER, mean_interval
from mechsearch.report.answers import (
    UNDECIDED,
    UNMEASURED,
    Answer,
    percent,
    seeds_of,
    signed,
    sizes,
    verdict,
)
from mechsearch.report.bootstrap import SEED, interval, replicates
from mechsearch.report.experiment import PASSIVE, Experiment
from mechsearch.report.learning import curve, scored_on
from mechsearch.report.tables import MINUS, display, number
from mechsearch.types import Floats

FLOOR, BEST_TEACHER = "the better of idle and random", "the best teacher"
"""Policies by what they are: which ones that is depends on the scores."""


class Question(Protocol):
    """Can be put to an experiment."""

    def ask(self, experiment: Experiment) -> Answer:
        """Return the answer, or that it was not measured."""


@dataclass(frozen=True)
class Better:
    """Is one policy better than another on the same heaps?

    Attributes:
        condition: Of the heaps.
        metric: Which direction is better is known of it.
        ours: A policy.
        theirs: Another, or `FLOOR` or `BEST_TEACHER`.
        worse: Ask whether it is worse instead.
    """

    condition: str
    metric: str
    ours: str
    theirs: str
    worse: bool = False

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the mean paired difference, ours minus theirs."""
        about = f"{self.condition}, {display(self.metric).label}"
        theirs = resolved(experiment, self.condition, self.metric, self.theirs)
        if not theirs or not measured(experiment, self.condition, self.metric, self.ours, theirs):
            return Answer(about, f"{self.ours} against {self.theirs}", UNMEASURED)
        matrices = experiment.conditions[self.condition].matrices([self.ours, theirs], self.metric)
        ours, others = (float(values.mean()) for values in matrices)
        drawn = replicates(matrices, np.random.default_rng(SEED))
        estimate = interval(ours - others, drawn[0] - drawn[1], matrices[0].shape[1])
        above = HIGHER_IS_BETTER[self.metric] != self.worse
        figures = (
            f"{self.ours} {number(self.metric, ours)}, {theirs} {number(self.metric, others)}: "
            f"{signed(self.metric, estimate)}"
        )
        test = f"paired difference, {sizes(matrices, [self.ours, theirs], experiment)}"
        return Answer(about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class ShareOfGap:
    """How much of the way from doing nothing useful to the best teacher does a policy go?

    Attributes:
        condition: Of the heaps.
        metric: Gap in which.
        ours: A policy.
        least: Share that the answer is compared with.
        above: Whether it should lie above that.
        lost_by: Ask for the share that this other policy loses against `ours` instead.
        from_nothing: Begin at 0 instead of the better of idle and random.
    """

    condition: str
    metric: str
    ours: str
    least: float
    above: bool = True
    lost_by: str = ""
    from_nothing: bool = False

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by a ratio of differences of means."""
        about = f"{self.condition}, {display(self.metric).label}"
        subject = self.lost_by or self.ours
        found = [
            resolved(experiment, self.condition, self.metric, role)
            for role in (FLOOR, BEST_TEACHER)
        ]
        floor, best = found
        names = [self.ours, floor, best] + ([self.lost_by] if self.lost_by else [])
        if not floor or not best or not measured(experiment, self.condition, self.metric, *names):
            return Answer(about, f"{subject} against {BEST_TEACHER}", UNMEASURED)
        matrices = experiment.conditions[self.condition].matrices(names, self.metric)
        means = np.array([[values.mean()] for values in matrices])
        point = float(self._share(means)[0])
        drawn = self._share(replicates(matrices, np.random.default_rng(SEED)))
        estimate = interval(point, drawn, matrices[0].shape[1])
        shown = ", ".join(
            f"{name} {number(self.metric, float(mean))}"
            for name, mean in zip(names, means[:, 0], strict=True)
            if not (self.from_nothing and name == floor)
        )
        if np.isnan(point):
            return Answer(about, f"{shown}: {best} is no better, there is no gap", UNDECIDED)
        figures = f"{shown}: {percent(estimate)} of the {'change' if self.from_nothing else 'gap'}"
        if self.lost_by:
            figures += " lost"
        side = "more" if self.above else "less"
        test = f"{side} than {self.least:.0%}; {sizes(matrices, names, experiment)}"
        return Answer(about, figures, verdict(estimate, self.least, self.above), test, estimate)

    def _share(self, means: Floats) -> Floats:
        """Return the share of each draw (B,) from means (3 or 4, B); NaN where there is no gap."""
        ours, floor, best = means[:3]
        sign = 1 if HIGHER_IS_BETTER[self.metric] else -1
        start = np.zeros_like(floor) if self.from_nothing else floor
        part = ours - means[3] if self.lost_by else ours - start
        gap = sign * (best - start)
        share: Floats = np.where(gap > 0, sign * part / np.where(gap > 0, gap, 1), np.nan)
        return share


@dataclass(frozen=True)
class Harder:
    """Does a policy do worse in one condition than in another? The heaps are not paired.

    Attributes:
        metric: By which.
        ours: A policy.
        harder: Condition in which it should do worse.
        easier: The other.
    """

    metric: str
    ours: str
    harder: str = "dual"
    easier: str = "single"

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the difference of means, the harder condition's minus the easier one's."""
        about = f"{self.harder} against {self.easier}, {display(self.metric).label}"
        both = (self.harder, self.easier)
        if not all(measured(experiment, name, self.metric, self.ours) for name in both):
            return Answer(about, f"{self.ours} in both", UNMEASURED)
        rng = np.random.default_rng(SEED)
        values = [
            experiment.conditions[name].matrices([self.ours], self.metric)[0] for name in both
        ]
        harder, easier = (float(one.mean()) for one in values)
        drawn = [replicates([one], rng)[0] for one in values]
        least = min(one.shape[1] for one in values)
        estimate = interval(harder - easier, drawn[0] - drawn[1], least)
        figures = (
            f"{self.harder} {number(self.metric, harder)}, {self.easier} "
            f"{number(self.metric, easier)}: {signed(self.metric, estimate)}"
        )
        heaps = " and ".join(str(one.shape[1]) for one in values)
        test = f"unpaired difference, {heaps} heaps, {seeds_of(values, [self.ours, self.ours])}"
        above = not HIGHER_IS_BETTER[self.metric]
        return Answer(about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class Level:
    """Does a policy's mean lie above a number?

    Attributes:
        condition: Of the heaps.
        metric: By which.
        ours: A policy.
        least: The number, in the metric's own unit.
    """

    condition: str
    metric: str
    ours: str
    least: float

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the mean."""
        about = f"{self.condition}, {display(self.metric).label}"
        if not measured(experiment, self.condition, self.metric, self.ours):
            return Answer(about, self.ours, UNMEASURED)
        matrices = experiment.conditions[self.condition].matrices([self.ours], self.metric)
        drawn = replicates(matrices, np.random.default_rng(SEED))[0]
        estimate = interval(float(matrices[0].mean()), drawn, matrices[0].shape[1])
        low, high = (number(self.metric, end) for end in (estimate.ci_low, estimate.ci_high))
        figures = f"{self.ours} {number(self.metric, estimate.mean)} ({low} to {high})"
        least = number(self.metric, self.least)
        test = f"more than {least}; {sizes(matrices, [self.ours], experiment)}"
        return Answer(about, figures, verdict(estimate, self.least, True), test, estimate)


@dataclass(frozen=True)
class Rises:
    """Does a learning curve improve on its own beginning?

    Attributes:
        condition: Of the heaps.
        metric: Of the curve.
        ours: A variant.
        within: Actions until the later point.
    """

    condition: str
    metric: str
    ours: str
    within: int

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the later point minus the untrained one, with Student's t over the seeds."""
        about = f"{self.condition}, {display(self.metric).label}"
        found = experiment.conditions.get(self.condition)
        runs = found.runs.get(self.ours, ()) if found else ()
        drawn = curve(runs, self.metric, scored_on(experiment))
        place = int((drawn.steps <= self.within).sum()) - 1 if drawn else 0
        if drawn is None or drawn.steps[0] > 0 or place < 1:
            return Answer(about, f"the curve of {self.ours} from its beginning", UNMEASURED)
        step, first, last = drawn.steps[place], drawn.seeds[:, 0], drawn.seeds[:, place]
        estimate = mean_interval(last - first)
        figures = (
            f"{number(self.metric, float(first.mean()))} untrained, "
            f"{number(self.metric, float(last.mean()))} after {step:,.0f} actions: "
            f"{signed(self.metric, estimate)}"
        )
        test = f"Student's t over {len(first)} seeds"
        if len(first) == 1:
            test = "1 seed: no interval"
        above = HIGHER_IS_BETTER[self.metric]
        return Answer(about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class QuickerMovesMore:
    """Do policies that need fewer actions move the clutter more? Idle and random are left out.

    Attributes:
        condition: Of the heaps.
    """

    condition: str

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by Spearman's rank correlation over the policies' means; below 0 is yes."""
        about = f"{self.condition}, actions and clutter moved"
        condition = experiment.conditions.get(self.condition)
        names = [name for name in condition.trials if name not in PASSIVE] if condition else []
        if condition is None or len(names) < 4:
            return Answer(about, "fewer than four policies that act", UNMEASURED)
        # The same generator draws the same seeds and heaps for both metrics.
        drawn, points = [], []
        for metric in ("episode_actions", "clutter_moved_m"):
            matrices = condition.matrices(names, metric)
            points.append(np.array([values.mean() for values in matrices]))
            drawn.append(replicates(matrices, np.random.default_rng(SEED)))
        estimate = interval(
            _rank_correlation(*(point[:, None] for point in points))[0],
            _rank_correlation(*drawn),
            matrices[0].shape[1],
        )
        figures = (
            f"rank correlation of {len(names)} policies {estimate.mean:.2f} "
            f"({estimate.ci_low:.2f} to {estimate.ci_high:.2f})"
        ).replace("-", MINUS)
        test = f"below 0; {sizes(matrices, names, experiment)}"
        return Answer(about, figures, verdict(estimate, 0, False), test, estimate)


def resolved(experiment: Experiment, condition: str, metric: str, name: str) -> str:
    """Return which policy a role means by the mean of a metric; "" if there is none."""
    if name not in (FLOOR, BEST_TEACHER):
        return name
    found = experiment.conditions.get(condition)
    if found is None:
        return ""
    names = found.passive if name == FLOOR else found.teachers
    names = [one for one in names if found.measured(one, metric)]
    if not names:
        return ""
    means = [float(values.mean()) for values in found.matrices(names, metric)]
    best = int(np.argmax(means) if HIGHER_IS_BETTER[metric] else np.argmin(means))
    return names[best]


def measured(experiment: Experiment, condition: str, metric: str, *names: str) -> bool:
    """Return whether all the policies have values of a metric in a condition."""
    found = experiment.conditions.get(condition)
    return found is not None and all(found.measured(name, metric) for name in names)


def _rank_correlation(left: Floats, right: Floats) -> Floats:
    """Return Spearman's correlation over the rows of two tables (K, B), for each column (B,)."""
    ranks = [stats.rankdata(table, axis=0) for table in (left, right)]
    centred = [rank - rank.mean(axis=0) for rank in ranks]
    spread = np.sqrt((centred[0] ** 2).sum(axis=0) * (centred[1] ** 2).sum(axis=0))
    with np.errstate(invalid="ignore"):
        correlation: Floats = (centred[0] * centred[1]).sum(axis=0) / spread
    return correlation
