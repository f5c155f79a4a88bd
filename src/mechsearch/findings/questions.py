"""Questions to an experiment, each answered by one number with its interval.

Every question has a threshold: the answer is yes if the whole 95 % interval lies on the side that
the question names, no if it lies on the other, and undecided if it holds the threshold. Intervals
are of the crossed bootstrap over training seeds and heaps (`bootstrap`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import stats

from mechsearch.evaluation.episodes import HIGHER_IS_BETTER, Estimate, mean_interval
from mechsearch.findings.bootstrap import SEED, estimated, percentile_interval, replicates
from mechsearch.findings.experiment import PASSIVE, Condition, Experiment
from mechsearch.findings.runs import learning_curve
from mechsearch.findings.tables import MINUS, difference_text, display, number, percent
from mechsearch.types import Floats

HOLDS, FAILS, UNDECIDED, UNMEASURED = "holds", "does not hold", "undecided", "not measured"
FLOOR, BEST_TEACHER = "the better of idle and random", "the best teacher"
"""Policies by what they are: which ones that is depends on the scores."""

PAPER_TEACHERS = ("teacher-straight", "teacher-zigzag", "teacher-spiral")
"""Those that claims speak of, whichever others there are."""


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


class Question(Protocol):
    """Can be put to an experiment."""

    def ask(self, experiment: Experiment) -> Answer:
        """Return the answer, or that it was not measured."""


@dataclass(frozen=True)
class _OfPolicy:
    """What a question is about.

    Attributes:
        condition: Of the heaps.
        metric: Which direction is better is known of it.
        ours: A policy.
    """

    condition: str
    metric: str
    ours: str

    @property
    def about(self) -> str:
        """Condition and metric in words."""
        return f"{self.condition}, {display(self.metric).label}"


@dataclass(frozen=True)
class Better(_OfPolicy):
    """Is one policy better than another on the same heaps?

    Attributes:
        theirs: The other, or `FLOOR` or `BEST_TEACHER`.
    """

    theirs: str

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the mean paired difference, ours minus theirs."""
        condition = experiment.condition(self.condition)
        names = [self.ours, resolved(condition, self.metric, self.theirs)]
        if not condition.measured(self.metric, *names):
            return Answer(self.about, f"{self.ours} against {self.theirs}", UNMEASURED)
        means = [float(values.mean()) for values in condition.matrices(names, self.metric)]
        estimate = difference(condition, self.metric, *names)
        above = HIGHER_IS_BETTER[self.metric]
        figures = f"{_means(self.metric, names, means)}: {difference_text(self.metric, estimate)}"
        test = f"paired difference, {_sizes(condition, names, self.metric)}"
        return Answer(self.about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class ShareOfGap(_OfPolicy):
    """How much of the way from doing nothing useful to the best teacher does a policy go?

    Attributes:
        least: Share that the answer is compared with.
        above: Whether it should lie above that.
        lost_by: Ask for the share that this other policy loses against `ours` instead.
        from_nothing: Begin at 0 instead of the better of idle and random.
        teachers: Among which is the best.
    """

    least: float
    above: bool = True
    lost_by: str = ""
    from_nothing: bool = False
    teachers: tuple[str, ...] = PAPER_TEACHERS

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by a ratio of differences of means."""
        condition = experiment.condition(self.condition)
        names = self.names(condition)
        if not condition.measured(self.metric, *names):
            subject = self.lost_by or self.ours
            return Answer(self.about, f"{subject} against {BEST_TEACHER}", UNMEASURED)
        means = [float(values.mean()) for values in condition.matrices(names, self.metric)]
        estimate = self.share(condition)
        kept = [i for i in range(len(names)) if not (self.from_nothing and i == 1)]
        shown = _means(self.metric, [names[i] for i in kept], [means[i] for i in kept])
        if np.isnan(estimate.mean):
            figures = f"{shown}: {names[2]} is no better, there is no gap"
            return Answer(self.about, figures, UNDECIDED)
        figures = f"{shown}: {percent(estimate)} of the {'change' if self.from_nothing else 'gap'}"
        if self.lost_by:
            figures += " lost"
        side = "more" if self.above else "less"
        test = f"{side} than {self.least:.0%}; {_sizes(condition, names, self.metric)}"
        found = verdict(estimate, self.least, self.above)
        return Answer(self.about, figures, found, test, estimate)

    def names(self, condition: Condition) -> list[str]:
        """Return ours, the floor, the best teacher, and the one that loses; "" for one missing."""
        floor, best = (
            resolved(condition, self.metric, role, self.teachers) for role in (FLOOR, BEST_TEACHER)
        )
        return [self.ours, floor, best, *([self.lost_by] if self.lost_by else [])]

    def share(self, condition: Condition) -> Estimate:
        """Return the share itself; NaN where there is no gap."""
        return estimated(condition.matrices(self.names(condition), self.metric), self._share)

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
        both = [experiment.condition(name) for name in (self.harder, self.easier)]
        if not all(condition.measured(self.metric, self.ours) for condition in both):
            return Answer(about, f"{self.ours} in both", UNMEASURED)
        rng = np.random.default_rng(SEED)
        values = [condition.matrices([self.ours], self.metric)[0] for condition in both]
        means = [float(one.mean()) for one in values]
        drawn = [replicates([one], rng)[0] for one in values]
        least = min(one.shape[1] for one in values)
        estimate = percentile_interval(means[0] - means[1], drawn[0] - drawn[1], least)
        shown = _means(self.metric, (self.harder, self.easier), means)
        heaps = " and ".join(str(one.shape[1]) for one in values)
        seeds = _seeds([(self.ours, len(one)) for one in values])
        test = f"unpaired difference, {heaps} heaps, {seeds}"
        figures = f"{shown}: {difference_text(self.metric, estimate)}"
        above = not HIGHER_IS_BETTER[self.metric]
        return Answer(about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class Level(_OfPolicy):
    """Does a policy's mean lie above a number?

    Attributes:
        least: The number, in the metric's own unit.
    """

    least: float

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the mean."""
        condition = experiment.condition(self.condition)
        if not condition.measured(self.metric, self.ours):
            return Answer(self.about, self.ours, UNMEASURED)
        estimate = estimated(condition.matrices([self.ours], self.metric))
        low, high = (number(self.metric, end) for end in (estimate.ci_low, estimate.ci_high))
        figures = f"{self.ours} {number(self.metric, estimate.mean)} ({low} to {high})"
        least = number(self.metric, self.least)
        test = f"more than {least}; {_sizes(condition, [self.ours], self.metric)}"
        return Answer(self.about, figures, verdict(estimate, self.least, True), test, estimate)


@dataclass(frozen=True)
class Rises(_OfPolicy):
    """Does a learning curve improve on its own beginning?

    Attributes:
        within: Actions until the later point.
    """

    within: int

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by the later point minus the untrained one, with Student's t over the seeds."""
        runs = experiment.condition(self.condition).runs.get(self.ours, ())
        drawn = learning_curve(runs, self.metric, experiment.scored_on)
        place = int((drawn.steps <= self.within).sum()) - 1 if drawn else 0
        if drawn is None or drawn.steps[0] > 0 or place < 1:
            figures = f"the curve of {self.ours} from its beginning"
            return Answer(self.about, figures, UNMEASURED)
        step, first, last = drawn.steps[place], drawn.seeds[:, 0], drawn.seeds[:, place]
        estimate = mean_interval(last - first)
        figures = (
            f"{number(self.metric, float(first.mean()))} untrained, "
            f"{number(self.metric, float(last.mean()))} after {step:,.0f} actions: "
            f"{difference_text(self.metric, estimate)}"
        )
        seeds = len(first)
        test = "1 seed: no interval" if seeds == 1 else f"Student's t over {seeds} seeds"
        above = HIGHER_IS_BETTER[self.metric]
        return Answer(self.about, figures, verdict(estimate, 0, above), test, estimate)


@dataclass(frozen=True)
class QuickerMovesMore:
    """Do policies that need fewer actions move the clutter more?

    Idle and random are left out, and so are other teachers than the paper's.

    Attributes:
        condition: Of the heaps.
    """

    condition: str

    def ask(self, experiment: Experiment) -> Answer:
        """Answer by Spearman's rank correlation over the policies' means; below 0 is yes."""
        about = f"{self.condition}, actions and clutter moved"
        condition = experiment.condition(self.condition)
        others = {*PASSIVE, *condition.teachers} - {*PAPER_TEACHERS}
        names = [name for name in condition.policies if name not in others]
        if len(names) < 4:
            return Answer(about, "fewer than four policies that act", UNMEASURED)
        # The same generator draws the same seeds and heaps for both metrics.
        drawn, points = [], []
        for metric in ("episode_actions", "clutter_moved_m"):
            matrices = condition.matrices(names, metric)
            points.append(np.array([values.mean() for values in matrices]))
            drawn.append(replicates(matrices, np.random.default_rng(SEED)))
        estimate = percentile_interval(
            _rank_correlation(*(point[:, None] for point in points))[0],
            _rank_correlation(*drawn),
            matrices[0].shape[1],
        )
        figures = (
            f"rank correlation of {len(names)} policies {estimate.mean:.2f} "
            f"({estimate.ci_low:.2f} to {estimate.ci_high:.2f})"
        ).replace("-", MINUS)
        test = f"below 0; {_sizes(condition, names, metric)}"
        return Answer(about, figures, verdict(estimate, 0, False), test, estimate)


def verdict(estimate: Estimate, threshold: float, above: bool) -> str:
    """Return whether an estimate lies above (or below) a threshold with its whole interval."""
    if estimate.ci_low > threshold:
        return HOLDS if above else FAILS
    if estimate.ci_high < threshold:
        return FAILS if above else HOLDS
    return UNDECIDED


def difference(condition: Condition, metric: str, ours: str, theirs: str) -> Estimate:
    """Return the mean of ours minus theirs, on the heaps that both ran on."""
    matrices = condition.matrices([ours, theirs], metric)
    return estimated(matrices, lambda means: means[0] - means[1])


def resolved(
    condition: Condition, metric: str, name: str, teachers: Sequence[str] = PAPER_TEACHERS
) -> str:
    """Return which policy a role means by the mean of a metric; "" if there is none."""
    if name not in (FLOOR, BEST_TEACHER):
        return name
    among = PASSIVE if name == FLOOR else teachers
    names = [one for one in condition.policies if one in among and condition.measured(metric, one)]
    if not names:
        return ""
    means = [float(values.mean()) for values in condition.matrices(names, metric)]
    best = int(np.argmax(means) if HIGHER_IS_BETTER[metric] else np.argmin(means))
    return names[best]


def _means(metric: str, names: Sequence[str], means: Sequence[float]) -> str:
    return ", ".join(f"{n} {number(metric, mean)}" for n, mean in zip(names, means, strict=True))


def _sizes(condition: Condition, names: Sequence[str], metric: str) -> str:
    """Return how many heaps and training seeds stand behind a number."""
    matrices = dict(zip(names, condition.matrices(names, metric), strict=True))
    seeds = [(name, len(matrices[name])) for name in names if name in condition.learnt]
    heaps = f"{matrices[names[0]].shape[1]} heaps"
    return f"{heaps}, {_seeds(seeds)}" if seeds else heaps


def _seeds(numbers: Sequence[tuple[str, int]]) -> str:
    """Return how many training seeds each policy has, and what an interval of one covers."""
    counts = {count for _, count in numbers}
    if counts == {1}:
        return "1 seed: the interval covers heaps only"
    if len(counts) == 1:
        return f"{counts.pop()} seeds"
    text = f"seeds: {', '.join(f'{name} {count}' for name, count in numbers)}"
    return text + "; of one seed, heaps only" if 1 in counts else text


def _rank_correlation(left: Floats, right: Floats) -> Floats:
    """Return Spearman's correlation over the rows of two tables (K, B), for each column (B,)."""
    ranks = [stats.rankdata(table, axis=0) for table in (left, right)]
    centred = [rank - rank.mean(axis=0) for rank in ranks]
    spread = np.sqrt((centred[0] ** 2).sum(axis=0) * (centred[1] ** 2).sum(axis=0))
    with np.errstate(invalid="ignore"):
        correlation: Floats = (centred[0] * centred[1]).sum(axis=0) / spread
    return correlation
