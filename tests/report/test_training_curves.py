import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.findings.experiment import Condition, Experiment, Run, read_experiment, read_run
from mechsearch.report import figures
from mechsearch.report.figures import to_svg
from mechsearch.types import MechSearchError


@pytest.fixture
def run_directory(tmp_path: Path) -> Path:
    (tmp_path / "config.json").write_text(json.dumps({"name": "method", "seed": 4}))
    score = {"reward": -20.0, "visibility_change": 0.1, "uncovered_rate": 0.3}
    lines = []
    for step in (100, 200, 300):
        values = score | {"clutter_moved_m": step / 1e4, "end": "lost"}
        lines.append({"step": step, "kind": "validation", **values})
        lines.append(
            {
                "step": step,
                "kind": "episode",
                "return": -step / 10,
                "q_start": -1.0,
                "return_start": -2.0,
                "saturated": 0.1,
                "chosen_actor": 0.6,
                "chosen_spiral": 0.4,
            }
        )
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (tmp_path / "metrics.jsonl").write_text(text + '{"step": 400, "kind": "validat')
    return tmp_path


def test_a_log_is_read_by_kind_without_its_torn_last_line(run_directory: Path) -> None:
    run = read_run(run_directory)
    assert (run.name, run.seed) == ("method", 4)
    steps, values = run.series("validation", "clutter_moved_m")
    np.testing.assert_array_equal(steps, [100, 200, 300])
    np.testing.assert_array_equal(values, [0.01, 0.02, 0.03])
    assert len(run.series("validation", "absent")[0]) == 0
    assert "end" not in run.keys("validation")


def test_curves_are_drawn_as_svg_the_same_each_time(run_directory: Path) -> None:
    run = read_run(run_directory)
    experiment = Experiment(None, {"single": Condition("single", {}, {"method": (run,)})})
    drawn = [
        to_svg(figures.draw_curves(experiment, figures.RUN_METRICS, ["method"], 2.5))
        for _ in range(2)
    ]
    assert drawn[0] == drawn[1]
    assert ElementTree.fromstring(drawn[0]).tag.endswith("svg")
    assert experiment.scored_on == "validation"
    assert figures.draw_training(run) is not None


@pytest.mark.parametrize(("kind", "told"), [("held_out", True), ("validation", False)])
def test_curves_stand_beside_scores_of_the_same_kind_of_heaps(sweep, kind, told) -> None:
    """Curves on validation heaps are alone; others say on how many heaps each line was scored."""
    (condition, *_) = read_experiment(sweep).conditions.values()
    record = {"step": 100, "reward": -20.0, "heaps": 7}
    run = Run("method", 0, {kind: [record, {**record, "step": 200}]})
    experiment = Experiment(None, {"single": replace(condition, runs={"method": (run,)})})
    (ax, *_) = (figure := figures.draw_curves(experiment, ["reward"], ["method"], 2.5)).axes
    assert ax.get_xlabel() == "training actions; curves on 7 heaps"
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    heaps = len(condition.scored[0].heaps)
    both = [f"final score, {heaps} heaps", f"does not learn, {heaps} heaps"]
    assert words == (["method", *both] if told else ["method"])
    assert ("idle" in [text.get_text() for text in ax.texts]) is told


def test_a_run_that_logged_nothing_has_no_curves(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{}")
    run = read_run(tmp_path)
    assert figures.draw_training(run) is None


def push_run(folder: Path, fits: int) -> Run:
    (folder / "config.json").write_text('{"name": "plus"}')
    lines: list[dict[str, object]] = [
        {"step": 20, "kind": "episode", "executed": done, "return": -done, "pushes": 3}
        for done in (8, 21)
    ]
    found = {"loss": 0.5, "pushes": 60, "at_once": -6.0, "by_occlusion": 5.0, "executed": 21}
    lines += [{"step": 20, "kind": "fit", **found, "simulated": 250}] * fits
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return read_run(folder)


def test_pushes_are_drawn_over_what_was_executed_and_fits_beside_them(
    tmp_path: Path,
) -> None:
    figure = figures.draw_training(push_run(tmp_path, fits=1))
    assert figure is not None
    panels = {ax.get_title(loc="left"): ax.lines for ax in figure.axes}
    assert len(panels) == 6
    (returns,) = panels["return of each episode"]
    np.testing.assert_array_equal(returns.get_xdata(), [8, 21])
    np.testing.assert_array_equal(returns.get_ydata(), [-8, -14.5])
    counted = {line.get_label(): list(line.get_ydata()) for line in panels["actions"]}
    assert counted == {"executed": [21], "simulated": [250]}


def test_pushes_are_drawn_before_the_first_fit_too(tmp_path: Path) -> None:
    assert figures.draw_training(push_run(tmp_path, fits=0)) is not None


def test_a_folder_without_a_run_and_a_damaged_log_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="no training configuration at"):
        read_run(tmp_path)
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "metrics.jsonl").write_text("not json\n")
    with pytest.raises(MechSearchError, match=r"line 1 of .*metrics.jsonl is damaged"):
        read_run(tmp_path)


def test_a_running_mean_looks_back_only() -> None:
    means = figures.running_mean(np.array([1.0, 3.0, 5.0, 7.0]), 2)
    np.testing.assert_allclose(means, [1, 2, 4, 6])


@settings(deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=6).map(sorted))
def test_labels_keep_their_order_and_their_distance(heights: list[float]) -> None:
    placed = figures.spaced(heights, 0.1)
    assert (np.diff(placed) > 0.1 - 1e-9).all()
    assert sum(placed) == pytest.approx(sum(heights), abs=1e-6)
    if len(heights) > 1 and np.diff(heights).min() >= 0.1:
        np.testing.assert_allclose(placed, heights)
