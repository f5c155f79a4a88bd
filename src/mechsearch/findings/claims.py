"""The paper's claims (section V-B) and this project's goals, as data: questions with verdicts.

A question is answered by one number. It has a threshold: the answer is yes if the whole 95 %
interval lies on the side that the question names, no if it lies on the other, and undecided if it
holds the threshold. Intervals are of the crossed bootstrap over training seeds and heaps.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product

import numpy as np
from scipy import stats

from mechsearch.evaluation.episodes import HIGHER_IS_BETTER, Estimate, mean_interval
from mechsearch.findings import tables
from mechsearch.findings.bootstrap import SEED, estimated, percentile_interval, replicates
from mechsearch.findings.experiment import PASSIVE, Condition, Experiment, learning_curve
from mechsearch.findings.tables import PAPER_METRICS, TRADEOFF, Table
from mechsearch.types import Floats

HOLDS, FAILS, UNDECIDED, UNMEASURED = "holds", "does not hold", "undecided", "not measured"
FLOOR, BEST_TEACHER = "the better of idle and random", "the best teacher"
"""Policies by what they are: which ones that is depends on the scores."""

TEACHER_POLICIES = ("teacher-straight", "teacher-zigzag", "teacher-spiral")
"""Those that claims speak of, whichever others there are."""

PAPER_CONDITIONS = ("single", "dual")

SMALL = 0.1
"""Share of the gap between doing nothing useful and the best teacher that does not matter."""

CLOSE = {"single": 0.60, "dual": 0.45}
"""Share of the gap from which a policy without privileged information is close to the teachers."""

_MARKS = {HOLDS: "better", FAILS: "worse"}


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


@dataclass(frozen=True)
class Question:
    """Can be put to an experiment; see each kind for the number that answers it.

    Attributes:
        condition: Of the heaps.
        metric: Which direction is better is known of it.
        ours: A policy.
    """

    condition: str
    metric: str = "reward"
    ours: str = "method"

    @property
    def about(self) -> str:
        """Condition and metric in words."""
        return f"{self.condition}, {tables.display(self.metric).label}"

    def ask(self, experiment: Experiment) -> Answer:
        """Return the answer, or that it was not measured."""
        raise NotImplementedError

    def _unmeasured(self, figures: str) -> Answer:
        return Answer(self.about, figures, UNMEASURED)

    def _better(self, figures: str, estimate: Estimate, test: str) -> Answer:
        """Return the answer by a difference of means: is it an improvement?"""
        words = f"{figures}: {tables.difference_text(self.metric, estimate)}"
        found = verdict(estimate, 0, HIGHER_IS_BETTER[self.metric])
        return Answer(self.about, words, found, test, estimate)


@dataclass(frozen=True)
class Better(Question):
    """Is one policy better than another on the same heaps? The mean of ours minus theirs.

    Attributes:
        theirs: The other, or `FLOOR` or `BEST_TEACHER`.
    """

    theirs: str = FLOOR

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        condition = experiment.condition(self.condition)
        names = [self.ours, resolved(condition, self.metric, self.theirs)]
        if not condition.measured(self.metric, *names):
            return self._unmeasured(f"{self.ours} against {self.theirs}")
        matrices = dict(zip(names, condition.matrices(names, self.metric), strict=True))
        estimate = difference(condition, self.metric, *names)
        test = f"paired difference, {_sizes(condition, matrices)}"
        return self._better(_means(self.metric, matrices), estimate, test)


@dataclass(frozen=True)
class ShareOfGap(Question):
    """How much of the way from doing nothing useful to the best teacher does a policy go?

    The answer is a ratio of differences of means.

    Attributes:
        least: Share that the answer is compared with.
        above: Whether it should lie above that.
        lost_by: Ask for the share that this other policy loses against `ours` instead.
        from_nothing: Begin at 0 instead of the better of idle and random.
        teachers: Among which is the best.
    """

    least: float = 1.0
    above: bool = True
    lost_by: str = ""
    from_nothing: bool = False
    teachers: tuple[str, ...] = TEACHER_POLICIES

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        condition = experiment.condition(self.condition)
        names = self.names(condition)
        if not condition.measured(self.metric, *names):
            return self._unmeasured(f"{self.lost_by or self.ours} against {BEST_TEACHER}")
        matrices = condition.matrices(names, self.metric)
        estimate = self.share(condition)
        kept = [i for i in range(len(names)) if not (self.from_nothing and i == 1)]
        figures = f"{_means(self.metric, {names[i]: matrices[i] for i in kept})}: "
        if np.isnan(estimate.mean):
            figures += f"{names[2]} is no better, there is no gap"
            return Answer(self.about, figures, UNDECIDED)
        figures += f"{tables.percent(estimate)} of the {'change' if self.from_nothing else 'gap'}"
        figures += " lost" if self.lost_by else ""
        sizes = _sizes(condition, dict(zip(names, matrices, strict=True)))
        test = f"{'more' if self.above else 'less'} than {self.least:.0%}; {sizes}"
        found = verdict(estimate, self.least, self.above)
        return Answer(self.about, figures, found, test, estimate)

    def names(self, condition: Condition) -> list[str]:
        """Return ours, the floor, the best teacher, and the one that loses; "" for one missing."""
        roles = (FLOOR, BEST_TEACHER)
        found = [resolved(condition, self.metric, role, self.teachers) for role in roles]
        return [self.ours, *found, *([self.lost_by] if self.lost_by else [])]

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
class Harder(Question):
    """Does a policy do worse than in another condition? A difference of means, heaps not paired.

    Attributes:
        easier: The other condition.
    """

    easier: str = "single"

    @property
    def about(self) -> str:
        """Conditions and metric in words."""
        return f"{self.condition} against {self.easier}, {tables.display(self.metric).label}"

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        both = [experiment.condition(name) for name in (self.condition, self.easier)]
        if not all(condition.measured(self.metric, self.ours) for condition in both):
            return self._unmeasured(f"{self.ours} in both")
        rng = np.random.default_rng(SEED)
        harder, easier = (condition.matrices([self.ours], self.metric)[0] for condition in both)
        drawn = replicates([harder], rng)[0] - replicates([easier], rng)[0]
        heaps = [harder.shape[1], easier.shape[1]]
        point = float(harder.mean()) - float(easier.mean())
        estimate = percentile_interval(point, drawn, min(heaps))
        shown = _means(self.metric, {self.condition: harder, self.easier: easier})
        seeds = _seeds([(self.ours, len(harder)), (self.ours, len(easier))])
        test = f"unpaired difference, {heaps[0]} and {heaps[1]} heaps, {seeds}"
        figures = f"{shown}: {tables.difference_text(self.metric, estimate)}"
        found = verdict(estimate, 0, not HIGHER_IS_BETTER[self.metric])
        return Answer(self.about, figures, found, test, estimate)


@dataclass(frozen=True)
class Level(Question):
    """Does a policy's mean lie above a number?

    Attributes:
        least: The number, in the metric's own unit.
    """

    least: float = 0.0

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        condition = experiment.condition(self.condition)
        if not condition.measured(self.metric, self.ours):
            return self._unmeasured(self.ours)
        matrices = condition.matrices([self.ours], self.metric)
        estimate = estimated(matrices)
        ends = (estimate.mean, estimate.ci_low, estimate.ci_high, self.least)
        mean, low, high, least = (tables.number(self.metric, end) for end in ends)
        test = f"more than {least}; {_sizes(condition, {self.ours: matrices[0]})}"
        figures = f"{self.ours} {mean} ({low} to {high})"
        return Answer(self.about, figures, verdict(estimate, self.least, True), test, estimate)


@dataclass(frozen=True)
class Rises(Question):
    """Does a learning curve improve on its own beginning? With Student's t over the seeds.

    Attributes:
        within: Actions until the later point.
    """

    within: int = 4000

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        runs = experiment.condition(self.condition).runs.get(self.ours, ())
        drawn = learning_curve(runs, self.metric, experiment.scored_on)
        place = int((drawn.steps <= self.within).sum()) - 1 if drawn else 0
        if drawn is None or drawn.steps[0] > 0 or place < 1:
            return self._unmeasured(f"the curve of {self.ours} from its beginning")
        first, last = drawn.seeds[:, 0], drawn.seeds[:, place]
        start, end = (tables.number(self.metric, float(values.mean())) for values in (first, last))
        figures = f"{start} untrained, {end} after {drawn.steps[place]:,.0f} actions"
        seeds = len(first)
        test = "1 seed: no interval" if seeds == 1 else f"Student's t over {seeds} seeds"
        return self._better(figures, mean_interval(last - first), test)


@dataclass(frozen=True)
class QuickerMovesMore(Question):
    """Do policies that need fewer actions move the clutter more?

    The answer is Spearman's rank correlation over the policies' means; below 0 is yes. Idle and
    random are left out, and so are other teachers than the paper's.
    """

    @property
    def about(self) -> str:
        """Condition and what is correlated."""
        return f"{self.condition}, actions and clutter moved"

    def ask(self, experiment: Experiment) -> Answer:
        """See `Question`."""
        condition = experiment.condition(self.condition)
        others = {*PASSIVE, *condition.teachers} - {*TEACHER_POLICIES}
        names = [name for name in condition.policies if name not in others]
        if len(names) < 4:
            return self._unmeasured("fewer than four policies that act")
        actions, moved = (condition.matrices(names, metric) for metric in TRADEOFF)
        points = [np.array([[one.mean()] for one in values]) for values in (actions, moved)]
        # The same generator draws the same seeds and heaps for both metrics.
        drawn = [replicates(values, np.random.default_rng(SEED)) for values in (actions, moved)]
        estimate = percentile_interval(
            _rank_correlation(*points)[0], _rank_correlation(*drawn), moved[0].shape[1]
        )
        figures = (
            f"rank correlation of {len(names)} policies {estimate.mean:.2f} "
            f"({estimate.ci_low:.2f} to {estimate.ci_high:.2f})"
        ).replace("-", tables.MINUS)
        test = f"below 0; {_sizes(condition, dict(zip(names, moved, strict=True)))}"
        return Answer(self.about, figures, verdict(estimate, 0, False), test, estimate)


@dataclass(frozen=True)
class Claim:
    """A sentence, and the questions whose answers decide it.

    Attributes:
        words: The sentence.
        questions: All must hold.
    """

    words: str
    questions: tuple[Question, ...]


@dataclass(frozen=True)
class Ruling:
    """A claim and what was found.

    Attributes:
        words: Of the claim.
        answers: To its questions.
    """

    words: str
    answers: tuple[Answer, ...]

    @property
    def verdict(self) -> str:
        """The verdict over all answers."""
        return combined([answer.verdict for answer in self.answers])


def _everywhere(
    kind: Callable[..., Question],
    *facts: object,
    metrics: Sequence[str] = PAPER_METRICS,
    **options: object,
) -> tuple[Question, ...]:
    """Return a question in both conditions by each metric."""
    return tuple(kind(c, m, *facts, **options) for c in PAPER_CONDITIONS for m in metrics)


def _less_clutter(ours: str) -> tuple[Question, ...]:
    pairs = product(PAPER_CONDITIONS, TEACHER_POLICIES)
    return tuple(Better(c, "clutter_moved_m", ours, teacher) for c, teacher in pairs)


def _of_learner(ours: str, ablated: str) -> tuple[tuple[Claim, ...], tuple[Claim, ...]]:
    """Return what the paper says of its learner alone, and of its parts.

    Args:
        ours: The variant that stands for the paper's.
        ablated: What its ablations' names begin with.
    """

    def essential(part: str) -> tuple[Question, ...]:
        without = f"{ablated}{part}"
        return _everywhere(Better, ours, without, metrics=("reward", "visibility_change"))

    blind = f"{ablated}pose-input"
    alone = (
        Claim(
            "The method learns to improve all four metrics in both conditions.",
            _everywhere(Better, ours, FLOOR),
        ),
        Claim(
            "It comes close to the teachers without their privileged information: it closes at "
            "least 60 % of the gap in reward in single heaps and 45 % in dual heaps.",
            tuple(ShareOfGap(c, "reward", ours, CLOSE[c]) for c in PAPER_CONDITIONS),
        ),
        Claim("The method moves the clutter less than any teacher.", _less_clutter(ours)),
        Claim(
            "Dual heaps are harder than single heaps.",
            tuple(Harder("dual", metric, ours) for metric in PAPER_METRICS),
        ),
    )
    parts = (
        Claim("The teachers are essential.", essential("teachers")),
        Claim("The asymmetry of actor and critic is essential.", essential("asymmetry")),
        Claim(
            "Without the position image the policy holds up in single heaps: it loses less than a "
            "tenth of the gap.",
            (ShareOfGap("single", "reward", ours, SMALL, above=False, lost_by=blind),),
        ),
        Claim(
            "Without the position image it does not hold up in dual heaps: it loses more than a "
            "tenth.",
            (ShareOfGap("dual", "reward", ours, SMALL, lost_by=blind),),
        ),
    )
    return alone, parts


def _paper() -> tuple[Claim, ...]:
    (learns, close, clutter, harder), parts = _of_learner("method", "no-")
    baseline = Claim(
        "DDPG does not improve any metric within the same actions: it closes less than a tenth of "
        "the gap.",
        _everywhere(ShareOfGap, "ddpg", SMALL, above=False),
    )
    price = Claim(
        "Uncovering in fewer actions has a price: the quicker a policy, the more clutter it moves.",
        tuple(QuickerMovesMore(c) for c in PAPER_CONDITIONS),
    )
    return learns, close, baseline, clutter, harder, *parts, price


PAPER = _paper()
"""What the paper says of its experiments."""

AS_PRINTED = tuple(
    Claim(f"As printed: {claim.words}", claim.questions)
    for claim in chain(*_of_learner("as-printed", "as-printed-no-"))
)
"""What it says of its learner, asked of the one whose loss is the paper's own."""

GOALS = (
    Claim(
        "The method improves on its own beginning within its first 4,000 actions.",
        _everywhere(Rises, "method", within=4000),
    ),
    Claim(
        "plus earns more reward than the best teacher in single heaps.",
        (Better("single", "reward", "plus", BEST_TEACHER),),
    ),
    Claim(
        "In single heaps plus makes at least as much visible as the best teacher.",
        (ShareOfGap("single", "visibility_change", "plus", 1.0, from_nothing=True),),
    ),
    Claim(
        "In single heaps plus uncovers 80 % of the targets.",
        (Level("single", "uncovered_rate", "plus", 0.8),),
    ),
    Claim("plus moves the clutter less than any teacher.", _less_clutter("plus")),
    Claim(
        "In dual heaps plus closes at least 85 % of the gap in reward, and makes at least 90 % of "
        "the best teacher's change visible.",
        (
            ShareOfGap("dual", "reward", "plus", 0.85),
            ShareOfGap("dual", "visibility_change", "plus", 0.9, from_nothing=True),
        ),
    ),
)
"""What this project asks besides, mostly of `plus`, its own image policy."""


def rule(claims: Sequence[Claim], experiment: Experiment) -> list[Ruling]:
    """Return each claim with the answers to its questions."""
    return [Ruling(c.words, tuple(q.ask(experiment) for q in c.questions)) for c in claims]


def combined(verdicts: Sequence[str]) -> str:
    """Return the verdict of a claim whose questions must all hold."""
    for decisive in (FAILS, UNMEASURED, UNDECIDED):
        if decisive in verdicts:
            return decisive
    return HOLDS


def overview_table(rulings: Sequence[Ruling]) -> Table:
    """Return one row for each claim."""
    rows, marks = [], []
    for ruling in rulings:
        counts = Counter(answer.verdict for answer in ruling.answers)
        known = (kind for kind in (HOLDS, FAILS, UNDECIDED, UNMEASURED) if counts[kind])
        said = ", ".join(f"{counts[kind]} {kind}" for kind in known)
        rows.append((ruling.words, ruling.verdict, said if counts.total() > 1 else "one row"))
        marks.append([_MARKS.get(ruling.verdict, ""), ""])
    return Table("", ("claim", "verdict", "rows"), tuple(rows), marks, True, (64, 15, 24))


def answer_table(ruling: Ruling) -> Table:
    """Return one row for each question of a claim."""
    rows = tuple((a.about, a.figures, a.verdict, a.test) for a in ruling.answers)
    marks = [["", _MARKS.get(a.verdict, ""), ""] for a in ruling.answers]
    caption = f"{ruling.words} {ruling.verdict.capitalize()}."
    columns = ("what", "figures", "verdict", "test")
    return Table(caption, columns, rows, marks, True, (22, 44, 15, 27))


def claim_rows(rulings: Sequence[Ruling]) -> list[tuple[str, ...]]:
    """Return every answer as text and plain numbers, for a CSV file; headings first."""
    head = ("claim", "about", "verdict", "estimate", "ci_low", "ci_high", "figures", "test")
    rows = [
        (r.words, a.about, a.verdict, *tables.plain_numbers(a.estimate), a.figures, a.test)
        for r in rulings
        for a in r.answers
    ]
    return [head, *rows]


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
    condition: Condition, metric: str, name: str, teachers: Sequence[str] = TEACHER_POLICIES
) -> str:
    """Return which policy a role means by the mean of a metric; "" if there is none."""
    if name not in (FLOOR, BEST_TEACHER):
        return name
    among = PASSIVE if name == FLOOR else teachers
    names = [one for one in condition.policies if one in among and condition.measured(metric, one)]
    if not names:
        return ""
    means = [values.mean() for values in condition.matrices(names, metric)]
    return names[int(np.argmax(means) if HIGHER_IS_BETTER[metric] else np.argmin(means))]


def _means(metric: str, matrices: Mapping[str, Floats]) -> str:
    """Return the mean of each matrix (S, H) by its name."""
    return ", ".join(f"{n} {tables.number(metric, float(m.mean()))}" for n, m in matrices.items())


def _sizes(condition: Condition, matrices: Mapping[str, Floats]) -> str:
    """Return how many heaps and training seeds stand behind policies' values (S, H)."""
    seeds = [(name, len(values)) for name, values in matrices.items() if name in condition.learnt]
    heaps = f"{next(iter(matrices.values())).shape[1]} heaps"
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
