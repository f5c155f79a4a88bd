from xml.etree import ElementTree

from mechsearch.evaluation import summary
from mechsearch.report.intervals import draw_intervals, draw_summary
from mechsearch.report.tables import scores_of


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
