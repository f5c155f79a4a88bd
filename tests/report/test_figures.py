import warnings
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import score
from mechsearch.report.figures import draw_scores, draw_summary, to_svg
from mechsearch.types import MechSearchError


def test_scores_are_drawn_the_same_each_time(evaluations) -> None:
    scores = {name: [score(found.episodes)] for name, found in evaluations.items()}
    drawn = to_svg(draw_scores(scores, ["method"]))
    assert drawn == to_svg(draw_scores(scores, ["method"]))
    assert ElementTree.fromstring(drawn).tag.endswith("svg")


def rows_of(evaluations, **facts: object) -> list[episodes.SummaryRow]:
    method = evaluations["method"]
    return episodes.summary_rows("main", replace(method, header={**method.header, **facts}))


def test_a_summary_has_one_dot_for_every_seed_and_metric(evaluations) -> None:
    one, two = (rows_of(evaluations, training_seed=seed) for seed in range(2))
    dots = [to_svg(draw_summary(rows)).count("<use ") for rows in (one, one + two)]
    assert dots[1] - dots[0] == len(one)


def test_conditions_and_lengths_of_training_are_told_apart(evaluations) -> None:
    rows = rows_of(evaluations)
    rows += rows_of(evaluations, condition="dual")
    rows += rows_of(evaluations, condition="dual", training_actions=8000)
    drawn = to_svg(draw_summary(rows))
    for label in ("single, method, 3,000", "dual, method, 3,000", "dual, method, 8,000"):
        assert f"<!-- {label} -->" in drawn


def test_an_empty_summary_is_refused() -> None:
    with pytest.raises(MechSearchError, match="no rows to draw"):
        draw_summary([])


def test_names_of_all_scripts_are_drawn_as_they_are_or_as_escapes(evaluations) -> None:
    scores = [score(evaluations["method"].episodes)]
    with warnings.catch_warnings():
        # Matplotlib warns of glyphs that are missing.
        warnings.simplefilter("error")
        drawn = to_svg(draw_scores({"чашка": scores, "杯子": scores, "a$b$": scores}))
    for label in ("чашка", r"\u676f\u5b50", "a$b$"):
        assert f"<!-- {label} -->" in drawn
