import pytest

from mechsearch.evaluation.metrics import METRICS, Estimate
from mechsearch.report import verdicts
from mechsearch.report.tables import MINUS
from mechsearch.report.verdicts import Verdict
from mechsearch.types import MechSearchError


@pytest.mark.parametrize(
    ("metric", "low", "high", "outcome"),
    [
        ("reward", 1, 2, "better"),
        ("reward", -2, -1, "worse"),
        ("reward", -1, 2, "undecided"),
        ("reward", 0, 0, "undecided"),
        ("clutter_moved_m", -2, -1, "better"),
        ("episode_actions", 1, 2, "worse"),
        ("reward", float("nan"), float("nan"), "undecided"),
    ],
)
def test_the_interval_decides_and_direction_depends_on_the_metric(
    metric: str, low: float, high: float, outcome: str
) -> None:
    assert Verdict("a", "b", metric, Estimate((low + high) / 2, low, high, 9)).outcome == outcome


def test_the_sentence_says_whom_it_beats_and_to_whom_it_loses(evaluations) -> None:
    text = verdicts.sentence("method", evaluations)
    assert text.startswith("In reward, method beats random (+")
    assert f"it loses to teacher-spiral ({MINUS}" in text


def test_a_policy_alone_has_no_verdict(evaluations) -> None:
    assert verdicts.sentence("idle", {"idle": evaluations["idle"]}) == ""


def test_standing_is_measured_between_doing_nothing_and_the_best_teacher(evaluations) -> None:
    gap, visibility, clutter = verdicts.standing("method", evaluations)
    assert "(random, " in gap
    assert "the best teacher (teacher-spiral, " in gap
    assert "of the change in visibility of teacher-spiral" in visibility
    assert "less than teacher-spiral" in clutter


def test_the_best_teacher_closes_its_own_gap_entirely(evaluations) -> None:
    gap, visibility, _ = verdicts.standing("teacher-spiral", evaluations)
    assert "teacher-spiral closes 100% (95 % interval 100% to 100%)" in gap
    assert "It reaches 100%" in visibility
    assert "closes 0% (95 % interval 0% to 0%)" in verdicts.standing("random", evaluations)[0]


def test_without_teachers_or_passive_policies_there_is_no_standing(evaluations) -> None:
    some = {name: evaluations[name] for name in ("method", "random")}
    assert verdicts.standing("method", some) == []


def test_the_table_has_a_mark_for_each_difference(evaluations) -> None:
    table, marks = verdicts.verdict_table("method", evaluations)
    assert [row[0] for row in table.rows] == [name for name in evaluations if name != "method"]
    assert all(len(row) == len(METRICS) for row in marks)
    against_idle = dict(zip(METRICS, marks[-1], strict=True))
    assert against_idle["reward"] == "better"
    assert against_idle["clutter_moved_m"] == "worse"


def test_policies_on_other_heaps_are_not_compared(evaluations, make_evaluation) -> None:
    fewer = evaluations | {"idle": make_evaluation("idle", 0.0, heaps=5)}
    with pytest.raises(MechSearchError, match="method ran on 12 heaps and idle on 5"):
        verdicts.standing("method", fewer)
