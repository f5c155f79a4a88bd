from xml.etree import ElementTree

import pytest

from mechsearch.evaluation import summary
from mechsearch.evaluation.metrics import score
from mechsearch.report.figures import draw_scores, draw_summary, to_svg
from mechsearch.types import MechSearchError


def test_scores_are_drawn_the_same_each_time(evaluations) -> None:
    scores = {name: [score(found.episodes)] for name, found in evaluations.items()}
    drawn = to_svg(draw_scores(scores, ["method"]))
    assert drawn == to_svg(draw_scores(scores, ["method"]))
    assert ElementTree.fromstring(drawn).tag.endswith("svg")


def test_a_summary_has_one_dot_for_every_seed_and_metric(evaluations) -> None:
    scores = score(evaluations["method"].episodes)
    one = summary.rows("main", "single", "method", 0, 3000, scores)
    two = summary.rows("main", "single", "method", 1, 3000, scores)
    assert to_svg(draw_summary(one + two)).count("<use ") - to_svg(draw_summary(one)).count(
        "<use "
    ) == len(one)


def test_conditions_and_lengths_of_training_are_told_apart(evaluations) -> None:
    scores = score(evaluations["method"].episodes)
    rows = summary.rows("main", "single", "method", 0, 3000, scores)
    rows += summary.rows("main", "dual", "method", 0, 3000, scores)
    rows += summary.rows("main", "dual", "method", 0, 8000, scores)
    drawn = to_svg(draw_summary(rows))
    for label in ("single, method, 3,000", "dual, method, 3,000", "dual, method, 8,000"):
        assert f"<!-- {label} -->" in drawn


def test_an_empty_summary_is_refused() -> None:
    with pytest.raises(MechSearchError, match="no rows to draw"):
        draw_summary([])
