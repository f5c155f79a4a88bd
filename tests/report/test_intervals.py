from xml.etree import ElementTree

import pytest

from mechsearch.evaluation import summary
from mechsearch.report.intervals import draw_intervals, draw_summary
from mechsearch.report.tables import scores_of
from mechsearch.types import MechSearchError


def test_scores_are_drawn_the_same_each_time(evaluations) -> None:
    scores = {name: [values] for name, values in scores_of(evaluations).items()}
    drawn = draw_intervals(scores, ["method"])
    assert drawn == draw_intervals(scores, ["method"])
    assert ElementTree.fromstring(drawn).tag.endswith("svg")


def test_a_summary_has_one_dot_for_every_seed_and_metric(evaluations) -> None:
    scores = scores_of(evaluations)
    one = summary.rows("main", "single", "method", 0, 3000, scores["method"])
    two = summary.rows("main", "single", "method", 1, 3000, scores["method"])
    assert draw_summary(one + two).count("<use ") - draw_summary(one).count("<use ") == len(one)


def test_conditions_and_lengths_of_training_are_told_apart(evaluations) -> None:
    scores = scores_of(evaluations)["method"]
    rows = summary.rows("main", "single", "method", 0, 3000, scores)
    rows += summary.rows("main", "dual", "method", 0, 3000, scores)
    rows += summary.rows("main", "dual", "method", 0, 8000, scores)
    drawn = draw_summary(rows)
    for label in ("single, method, 3,000", "dual, method, 3,000", "dual, method, 8,000"):
        assert f"<!-- {label} -->" in drawn


def test_an_empty_summary_is_refused() -> None:
    with pytest.raises(MechSearchError, match="no rows to draw"):
        draw_summary([])
