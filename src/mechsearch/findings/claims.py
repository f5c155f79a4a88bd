"""The paper's claims (section V-B) and this project's goals, as data, with their verdicts."""

from collections.abc import Sequence
from dataclasses import dataclass

from mechsearch.findings.experiment import Experiment
from mechsearch.findings.questions import (
    BEST_TEACHER,
    FAILS,
    FLOOR,
    HOLDS,
    PAPER_TEACHERS,
    UNDECIDED,
    UNMEASURED,
    Answer,
    Better,
    Harder,
    Level,
    Question,
    QuickerMovesMore,
    Rises,
    ShareOfGap,
)
from mechsearch.findings.tables import Table

PAPER_CONDITIONS = ("single", "dual")
PAPER_METRICS = ("reward", "visibility_change", "episode_actions", "graspability_change")
"""What the paper's Figure 4 shows."""

SMALL = 0.1
"""Share of the gap between doing nothing useful and the best teacher that does not matter."""

CLOSE = {"single": 0.60, "dual": 0.45}
"""Share of the gap from which a policy without privileged information is close to the teachers."""


_MARKS = {HOLDS: "better", FAILS: "worse"}


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


def _less_clutter(ours: str, conditions: Sequence[str] = PAPER_CONDITIONS) -> tuple[Question, ...]:
    return tuple(
        Better(condition, "clutter_moved_m", ours, teacher)
        for condition in conditions
        for teacher in PAPER_TEACHERS
    )


def _essential(without: str) -> tuple[Question, ...]:
    return tuple(
        Better(condition, metric, "method", without)
        for condition in PAPER_CONDITIONS
        for metric in ("reward", "visibility_change")
    )


PAPER = (
    Claim(
        "The method learns to improve all four metrics in both conditions.",
        tuple(
            Better(c, metric, "method", FLOOR) for c in PAPER_CONDITIONS for metric in PAPER_METRICS
        ),
    ),
    Claim(
        "It comes close to the teachers without their privileged information: it closes at least "
        "60 % of the gap in reward in single heaps and 45 % in dual heaps.",
        tuple(ShareOfGap(c, "reward", "method", CLOSE[c]) for c in PAPER_CONDITIONS),
    ),
    Claim(
        "DDPG does not improve any metric within the same actions: it closes less than a tenth of "
        "the gap.",
        tuple(
            ShareOfGap(c, metric, "ddpg", SMALL, above=False)
            for c in PAPER_CONDITIONS
            for metric in PAPER_METRICS
        ),
    ),
    Claim("The method moves the clutter less than any teacher.", _less_clutter("method")),
    Claim(
        "Dual heaps are harder than single heaps.",
        tuple(Harder(metric, "method") for metric in PAPER_METRICS),
    ),
    Claim("The teachers are essential.", _essential("no-teachers")),
    Claim("The asymmetry of actor and critic is essential.", _essential("no-asymmetry")),
    Claim(
        "Without the position image the policy holds up in single heaps: it loses less than a "
        "tenth of the gap.",
        (ShareOfGap("single", "reward", "method", SMALL, above=False, lost_by="no-pose-input"),),
    ),
    Claim(
        "Without the position image it does not hold up in dual heaps: it loses more than a tenth.",
        (ShareOfGap("dual", "reward", "method", SMALL, lost_by="no-pose-input"),),
    ),
    Claim(
        "Uncovering in fewer actions has a price: the quicker a policy, the more clutter it moves.",
        tuple(QuickerMovesMore(c) for c in PAPER_CONDITIONS),
    ),
)
"""What the paper says of its experiments."""

GOALS = (
    Claim(
        "The method improves on its own beginning within its first 4,000 actions.",
        tuple(
            Rises(c, metric, "method", within=4000)
            for c in PAPER_CONDITIONS
            for metric in PAPER_METRICS
        ),
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
    rows = []
    for ruling in rulings:
        verdicts = [answer.verdict for answer in ruling.answers]
        counts = ", ".join(
            f"{verdicts.count(kind)} {kind}"
            for kind in (HOLDS, FAILS, UNDECIDED, UNMEASURED)
            if kind in verdicts
        )
        rows.append((ruling.words, ruling.verdict, counts if len(verdicts) > 1 else "one row"))
    marks = [[_MARKS.get(ruling.verdict, ""), ""] for ruling in rulings]
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
    rows: list[tuple[str, ...]] = [
        ("claim", "about", "verdict", "estimate", "ci_low", "ci_high", "figures", "test")
    ]
    for ruling in rulings:
        for answer in ruling.answers:
            estimate = answer.estimate
            numbers = (
                [f"{v:.6g}" for v in (estimate.mean, estimate.ci_low, estimate.ci_high)]
                if estimate
                else ["", "", ""]
            )
            rows.append(
                (ruling.words, answer.about, answer.verdict, *numbers, answer.figures, answer.test)
            )
    return rows
