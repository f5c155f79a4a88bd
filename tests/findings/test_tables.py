import pytest

from mechsearch.evaluation.episodes import METRICS, Estimate, score, score_by_count
from mechsearch.findings import tables
from mechsearch.findings.tables import MINUS, Table


def scores_of(evaluations):
    return {name: score(evaluation.episodes) for name, evaluation in evaluations.items()}


def test_numbers_are_shown_in_their_unit_with_a_true_minus() -> None:
    assert tables.number("clutter_moved_m", 0.0312) == "3.1"
    assert tables.number("uncovered_rate", 0.675) == "68"
    assert tables.number("reward", -15.04) == f"{MINUS}15.0"
    assert tables.number("reward", 2.0, signed=True) == "+2.0"


@pytest.mark.parametrize("value", [0.0, -0.0, -1e-9, 1e-9])
def test_nothing_has_no_sign(value: float) -> None:
    assert tables.number("reward", value, signed=True) == "0.0"


def test_a_cell_holds_mean_and_interval() -> None:
    assert (
        tables.cell("reward", Estimate(-15, -16.5, -13.5, 9))
        == f"{MINUS}15.0\n{MINUS}16.5 to {MINUS}13.5"
    )
    assert tables.cell("reward", Estimate(-15, float("nan"), float("nan"), 1)) == f"{MINUS}15.0"


def test_every_policy_and_metric_is_in_the_table(evaluations) -> None:
    table = tables.score_table(scores_of(evaluations))
    assert [row[0] for row in table.rows] == list(evaluations)
    assert len(table.columns) == len(METRICS) + 1
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_retrieval_has_columns_where_it_was_measured(evaluations) -> None:
    scores = scores_of(evaluations)
    first = next(iter(scores))
    scores[first] = {**scores[first], "retrieval_after": Estimate(0.25, 0.1, 0.4, 40)}
    table = tables.score_table(scores)
    column = table.columns.index("retrieved at the end [%]")
    assert [row[column] for row in table.rows] == ["25\n10 to 40"] + [""] * (len(scores) - 1)


def test_object_counts_and_reward_terms_have_columns(evaluations) -> None:
    by_count = tables.count_table(
        {name: score_by_count(e.episodes) for name, e in evaluations.items()}, "reward"
    )
    assert by_count.columns == ("policy", "5 objects", "10 objects", "15 objects")
    terms = tables.terms_table(scores_of(evaluations))
    assert terms.columns == ("policy", "visibility", "idleness", "reward")


def test_text_columns_line_up() -> None:
    table = Table("Scores", ("policy", "reward"), (("a", "1\n0 to 2"), ("longer", "2")))
    assert tables.to_text(table).splitlines() == [
        "Scores",
        "",
        "policy  reward",
        "------  ----------",
        "a       1 (0 to 2)",
        "longer  2",
    ]


def test_markdown_has_a_row_a_line_and_intervals_behind_their_means() -> None:
    table = Table(
        "Two.", ("policy", "reward"), (("a", f"{MINUS}1.0\n{MINUS}2.0 to 0.0"), ("b", ""))
    )
    assert tables.to_markdown(table).splitlines() == [
        "Two.",
        "",
        "| policy | reward |",
        "| --- | --- |",
        f"| a | {MINUS}1.0 ({MINUS}2.0 to 0.0) |",
        "| b |  |",
    ]
