from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mechsearch.evaluation.episodes import Estimate
from mechsearch.findings.claims import (
    AS_PRINTED,
    BEST_TEACHER,
    FAILS,
    FLOOR,
    GOALS,
    HOLDS,
    PAPER,
    UNDECIDED,
    UNMEASURED,
    Better,
    Claim,
    Harder,
    Level,
    QuickerMovesMore,
    Rises,
    Ruling,
    ShareOfGap,
    answer_table,
    claim_rows,
    combined,
    overview_table,
    resolved,
    rule,
    verdict,
)
from mechsearch.findings.experiment import Experiment, read_experiment
from mechsearch.findings.tables import MINUS, difference_text, percent

WriteSweep = Callable[..., Path]


@pytest.fixture(scope="module")
def experiment(sweep: Path) -> Experiment:
    return read_experiment(sweep)


@pytest.fixture(scope="module")
def rulings(experiment: Experiment) -> dict[str, Ruling]:
    return {ruling.words: ruling for ruling in rule((*PAPER, *GOALS), experiment)}


def only(rulings: dict[str, Ruling], words: str) -> Ruling:
    (found,) = [ruling for text, ruling in rulings.items() if words in text]
    return found


@pytest.mark.parametrize(
    "words",
    [
        "learns to improve all four metrics",
        "comes close to the teachers",
        "DDPG does not improve",
        "The method moves the clutter less",
        "Dual heaps are harder",
        "teachers are essential",
        "asymmetry of actor and critic is essential",
        "holds up in single heaps",
        "does not hold up in dual heaps",
        "the quicker a policy",
        "plus moves the clutter less than any teacher",
        "improves on its own beginning",
    ],
)
def test_what_is_true_of_the_made_up_policies_holds(rulings: dict[str, Ruling], words: str) -> None:
    assert only(rulings, words).verdict == HOLDS


@pytest.mark.parametrize(
    "words",
    ["more reward than the best teacher", "as much visible", "uncovers 80 %", "85 % of the gap"],
)
def test_what_is_false_of_the_made_up_policies_does_not_hold(
    rulings: dict[str, Ruling], words: str
) -> None:
    assert only(rulings, words).verdict == FAILS


def test_the_opposite_truth_turns_the_verdicts_round(
    write_sweep: WriteSweep, tmp_path: Path
) -> None:
    """DDPG learns, the method does not, and pushes all about."""
    teachers = {f"teacher-{name}": 0.6 for name in ("straight", "zigzag", "spiral")}
    policies = {"method": 0.05, "ddpg": 1.0, "no-teachers": 0.5, "no-asymmetry": 0.6}
    policies |= {"no-pose-input": 0.0, "random": 0.3, "idle": 0.0} | teachers
    gains = {"single": policies, "dual": policies | {"method": 0.9}}
    found = {r.words: r for r in rule(PAPER, read_experiment(write_sweep(tmp_path / "s", gains)))}
    for words in ("learns to improve", "DDPG does not", "moves the clutter less", "are harder"):
        assert only(found, words).verdict == FAILS
    for words in ("teachers are essential", "asymmetry of actor"):
        assert only(found, words).verdict == FAILS


def test_claims_of_the_learner_are_put_to_the_loss_as_printed_likewise(
    write_sweep: WriteSweep, tmp_path: Path
) -> None:
    """Policies of the same scores by other names get the same verdicts."""
    gains = {"method": 0.5, "no-teachers": 0.1, "random": 0.0, "idle": 0.0}
    gains |= {f"teacher-{name}": 0.6 for name in ("straight", "zigzag", "spiral")}
    gains |= {"as-printed": 0.5, "as-printed-no-teachers": 0.1}
    made = write_sweep(tmp_path / "s", {"single": gains, "dual": gains})
    found = {r.words: r.verdict for r in rule((*PAPER, *AS_PRINTED), read_experiment(made))}
    printed = {w.removeprefix("As printed: "): v for w, v in found.items() if "As printed" in w}
    assert printed == {words: found[words] for words in printed}
    assert {HOLDS, UNMEASURED} <= set(printed.values())


def test_equal_policies_are_undecided(write_sweep: WriteSweep, tmp_path: Path) -> None:
    policies = {"method": 0.5, "no-teachers": 0.505}
    experiment = read_experiment(write_sweep(tmp_path / "s", {"single": policies}))
    answer = Better("single", "reward", "method", "no-teachers").ask(experiment)
    assert answer.verdict == UNDECIDED


def test_a_difference_is_the_mean_over_heaps_and_seeds(experiment: Experiment) -> None:
    answer = Better("single", "clutter_moved_m", "method", "teacher-spiral").ask(experiment)
    condition = experiment.conditions["single"]
    ours, theirs = condition.matrices(["method", "teacher-spiral"], "clutter_moved_m")
    assert answer.estimate is not None
    assert answer.estimate.mean == pytest.approx(ours.mean() - theirs.mean())
    assert answer.test == "paired difference, 30 heaps, 3 seeds"


def test_the_share_of_the_gap_is_as_computed_by_hand(experiment: Experiment) -> None:
    answer = ShareOfGap("single", "reward", "method", 0.6).ask(experiment)
    condition = experiment.conditions["single"]
    floor = resolved(experiment.condition("single"), "reward", FLOOR)
    best = resolved(experiment.condition("single"), "reward", BEST_TEACHER)
    ours, low, high = (
        float(np.mean(values)) for values in condition.matrices(["method", floor, best], "reward")
    )
    assert floor == "random"
    assert answer.estimate is not None
    assert answer.estimate.mean == pytest.approx((ours - low) / (high - low))


def test_the_best_teacher_closes_its_own_gap_and_the_floor_none(experiment: Experiment) -> None:
    best = resolved(experiment.condition("single"), "episode_actions", BEST_TEACHER)
    floor = resolved(experiment.condition("single"), "episode_actions", FLOOR)
    for name, share in ((best, 1.0), (floor, 0.0)):
        answer = ShareOfGap("single", "episode_actions", name, 0.5).ask(experiment)
        assert answer.estimate is not None
        assert answer.estimate.mean == pytest.approx(share)
        assert answer.estimate.ci_low == pytest.approx(share)


def test_a_curve_is_held_against_its_own_beginning(experiment: Experiment) -> None:
    """Seeds rise by 0.9, 0.91 and 0.92 in 8,000 actions, half of it in 4,000."""
    answer = Rises("single", "reward", "method", 5000).ask(experiment)
    assert answer.estimate is not None
    assert answer.estimate.mean == pytest.approx(0.455)
    assert "after 4,000 actions" in answer.figures
    assert answer.verdict == HOLDS
    assert Rises("single", "reward", "method", 3000).ask(experiment).verdict == UNMEASURED
    assert Rises("single", "episode_actions", "method", 8000).ask(experiment).verdict == HOLDS


def test_without_a_gap_nothing_is_decided(write_sweep: WriteSweep, tmp_path: Path) -> None:
    policies = {"method": 0.5, "teacher-spiral": 0.1, "random": 0.3, "idle": 0.0}
    experiment = read_experiment(write_sweep(tmp_path / "s", {"single": policies}))
    answer = ShareOfGap("single", "reward", "method", 0.6).ask(experiment)
    assert answer.verdict == UNDECIDED
    assert "there is no gap" in answer.figures


def test_one_seed_is_said_to_cover_heaps_only(write_sweep: WriteSweep, tmp_path: Path) -> None:
    policies = {"method": 0.5, "idle": 0.0}
    folder = write_sweep(tmp_path / "s", {"single": policies, "dual": policies}, seeds=1)
    experiment = read_experiment(folder)
    for question in (Better("single", "reward", "method", "idle"), Harder("dual")):
        assert "1 seed: the interval covers heaps only" in question.ask(experiment).test


def test_more_seeds_that_disagree_make_a_difference_uncertain(
    write_sweep: WriteSweep, tmp_path: Path
) -> None:
    """On the heaps alone both seeds are far above idle; that all seeds would be, two do not say."""
    policies = {"method": 0.2, "idle": 0.0}
    one = read_experiment(write_sweep(tmp_path / "one", {"single": policies}, seeds=1))
    question = Better("single", "visibility_change", "method", "idle")
    assert question.ask(one).verdict == HOLDS
    both = tmp_path / "both"
    write_sweep(both, {"single": policies}, seeds=1)
    other = tmp_path / "other"
    write_sweep(other, {"single": {"method": 0.8}}, seeds=2)
    name = "method-seed1-8000.npz"
    (other / "single" / "evaluations" / name).rename(both / "single" / "evaluations" / name)
    assert question.ask(read_experiment(both)).verdict == UNDECIDED


def test_what_was_not_run_is_not_measured(write_sweep: WriteSweep, tmp_path: Path) -> None:
    policies = {"method": 0.5, "idle": 0.0}
    experiment = read_experiment(write_sweep(tmp_path / "s", {"single": policies}, grasps=False))
    questions = [
        Better("single", "reward", "method", "no-teachers"),
        Better("dual", "reward", "method", FLOOR),
        Better("single", "graspability_change", "method", FLOOR),
        ShareOfGap("single", "reward", "method", 0.6),
        Harder("dual"),
        Level("single", "uncovered_rate", "plus", 0.8),
        QuickerMovesMore("single"),
    ]
    for question in questions:
        assert question.ask(experiment).verdict == UNMEASURED
    for ruling in rule((*PAPER, *GOALS), experiment):
        assert ruling.verdict == UNMEASURED


@pytest.mark.parametrize(
    ("low", "high", "above", "expected"),
    [
        (1, 2, True, HOLDS),
        (-2, -1, True, FAILS),
        (-1, 1, True, UNDECIDED),
        (-2, -1, False, HOLDS),
        (1, 2, False, FAILS),
        (0, 0, True, UNDECIDED),
        (float("nan"), float("nan"), True, UNDECIDED),
    ],
)
def test_the_whole_interval_must_lie_on_one_side(
    low: float, high: float, above: bool, expected: str
) -> None:
    assert verdict(Estimate((low + high) / 2, low, high, 9), 0, above) == expected


def test_a_number_without_an_interval_is_shown_alone() -> None:
    alone = Estimate(0.25, float("nan"), float("nan"), 1)
    assert percent(alone) == "25%"
    assert difference_text("reward", alone) == "+0.2"
    assert percent(Estimate(-0.001, -0.3, 0.2, 9)) == f"0% ({MINUS}30% to 20%)"


def test_a_claim_holds_only_if_all_its_rows_do() -> None:
    assert combined([HOLDS, HOLDS]) == HOLDS
    assert combined([HOLDS, UNDECIDED]) == UNDECIDED
    assert combined([HOLDS, UNDECIDED, UNMEASURED]) == UNMEASURED
    assert combined([HOLDS, UNDECIDED, UNMEASURED, FAILS]) == FAILS


def test_tables_have_a_row_for_each_claim_and_each_question(experiment: Experiment) -> None:
    claim = Claim("It is.", (Level("single", "uncovered_rate", "method", 0.1),) * 2)
    (ruling,) = rule((claim,), experiment)
    table = overview_table([ruling])
    assert table.rows == (("It is.", HOLDS, "2 holds"),)
    assert table.marks == [["better", ""]]
    table = answer_table(ruling)
    assert table.caption == "It is. Holds."
    assert len(table.rows) == len(table.marks) == 2
    rows = claim_rows([ruling])
    assert len({len(row) for row in rows}) == 1
    assert float(rows[1][3]) == pytest.approx(ruling.answers[0].estimate.mean, rel=1e-5)
