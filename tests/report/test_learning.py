from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from mechsearch.findings.analysis import analyse, tradeoff_rows
from mechsearch.findings.experiment import (
    CURVE_COLUMNS,
    Condition,
    Experiment,
    Run,
    learning_curve,
    read_experiment,
)
from mechsearch.report import figures
from mechsearch.report.figures import draw_tradeoff


@pytest.fixture(scope="module")
def experiment(sweep: Path) -> Experiment:
    return read_experiment(sweep)


def run(seed: int, rewards: dict[int, float]) -> Run:
    records = [{"step": step, "reward": reward} for step, reward in rewards.items()]
    return Run("method", seed, {"held_out": records})


def test_a_curve_is_the_mean_over_seeds_at_the_steps_that_all_have() -> None:
    runs = [run(0, {0: 1.0, 100: 2.0, 200: 9.0}), run(1, {0: 3.0, 100: 6.0})]
    found = learning_curve(runs, "reward", "held_out")
    assert found is not None
    np.testing.assert_array_equal(found.steps, [0, 100])
    np.testing.assert_array_equal(found.seeds, [[1, 2], [3, 6]])
    assert [estimate.mean for estimate in found.means] == [2, 4]
    half = stats.t.ppf(0.975, 1) * np.std([2, 6], ddof=1) / np.sqrt(2)
    assert found.means[1].ci_high == pytest.approx(4 + half)


def test_a_step_that_was_scored_again_counts_once_and_the_last_time() -> None:
    records = [{"step": 0, "reward": 1.0}, {"step": 100, "reward": 2.0}]
    again = Run("method", 0, {"held_out": [*records, {"step": 100, "reward": 5.0}]})
    found = learning_curve([again], "reward", "held_out")
    assert found is not None
    np.testing.assert_array_equal(found.seeds, [[1, 5]])


def test_without_runs_there_is_no_curve() -> None:
    assert learning_curve([], "reward", "held_out") is None


def test_curves_are_of_held_out_heaps_where_there_are_any(experiment: Experiment) -> None:
    assert experiment.scored_on == "held_out"


def test_figures_have_a_panel_for_each_metric_and_condition(experiment: Experiment) -> None:
    figure = figures.draw_learning(experiment)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert len(titles) == 8
    assert titles[:2] == ["single: reward", "dual: reward"]
    assert titles[-1] == "dual: graspability gained"
    assert len(figures.draw_ablation(experiment).axes) == 4


def test_a_variant_without_a_curve_has_its_final_score_beside_the_curves_of_others(
    experiment: Experiment,
) -> None:
    axes = figures.draw_learning(experiment).axes
    _, labels = axes[6].get_legend_handles_labels()
    assert {"method", "ddpg", "plus, final"} <= set(labels)
    # Three seeds and their mean, of each of method and ddpg.
    assert len([line for line in axes[6].lines if len(line.get_xdata()) == 3]) == 8


def test_final_scores_without_any_curve_stand_where_curves_end(
    write_sweep: Callable[..., Path], tmp_path: Path
) -> None:
    folder = write_sweep(tmp_path / "s", {"single": {"plus": 0.5, "idle": 0.0}})
    axes = figures.draw_learning(read_experiment(folder)).axes
    actions = {x for line in axes[3].lines if line.get_marker() == "D" for x in line.get_xdata()}
    low, high = axes[3].get_xlim()
    assert low == 0
    assert max(actions) < high < 1.2 * axes[0].get_xlim()[1]


def test_every_seed_the_mean_and_every_teacher_are_drawn(experiment: Experiment) -> None:
    ax = figures.draw_learning(experiment).axes[0]
    curves = [line for line in ax.lines if len(line.get_xdata()) == 3]
    # Three seeds and their mean, of each of method, plus and ddpg.
    assert len(curves) == 12
    words = [text.get_text() for text in ax.texts]
    assert {"teacher-spiral", "teacher-straight", "teacher-zigzag", "idle"} <= set(words)


def test_what_was_not_measured_is_said_in_its_panel(
    write_sweep: Callable[..., Path], tmp_path: Path
) -> None:
    folder = write_sweep(tmp_path / "s", {"single": {"method": 0.5, "idle": 0.0}}, grasps=False)
    panel = figures.draw_learning(read_experiment(folder)).axes[3]
    assert [text.get_text() for text in panel.texts] == ["not measured"]


def test_bands_stay_within_the_panel(experiment: Experiment) -> None:
    """Where a figure is printed without clipping they would be drawn over its neighbours."""
    for ax in figures.draw_learning(experiment).axes:
        low, high = ax.get_ylim()
        for band in ax.collections:
            heights = band.get_paths()[0].vertices[:, 1]
            assert low - 1e-9 <= heights.min() <= heights.max() <= high + 1e-9


def test_rows_have_every_value_of_every_seed(experiment: Experiment) -> None:
    head, *rows = analyse(experiment).numbers["learning"]
    assert head == CURVE_COLUMNS
    # Two conditions, three seeds, three steps: three metrics of six variants, and a fourth of two.
    assert len(rows) == 2 * 3 * 3 * (3 * 6 + 2)
    assert ("single", "method", "1", "held-out heaps", "8000", "reward", "0.91", "", "", "") in rows


def test_rows_have_the_interval_that_a_run_logged() -> None:
    logged = {"step": 5, "reward": 1.0, "reward_ci_low": 0.5, "reward_ci_high": 1.5, "heaps": 50}
    single = Condition("single", {}, {"method": (Run("method", 2, {"held_out": [logged]}),)})
    _, row = analyse(Experiment({}, {"single": single})).numbers["learning"]
    place = ("single", "method", "2", "held-out heaps", "5")
    assert row == (*place, "reward", "1", "0.5", "1.5", "50")


def test_the_tradeoff_has_a_panel_for_each_number_of_objects(experiment: Experiment) -> None:
    figure = draw_tradeoff(experiment.conditions["single"])
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles == ["single, all heaps", "5 objects", "10 objects", "15 objects"]
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in figure.axes}) == 1


def test_tradeoff_points_are_means_over_seeds_and_heaps(experiment: Experiment) -> None:
    head, *rows = tradeoff_rows(experiment)
    assert len(rows) == 2 * 4 * 11 * 2
    found = {tuple(row[:5]): dict(zip(head, row, strict=True)) for row in rows}
    row = found["single", "10", "method", "3", "clutter_moved_m"]
    (values,) = experiment.conditions["single"].matrices(["method"], "clutter_moved_m", 10)
    assert float(row["mean"]) == pytest.approx(values.mean(), rel=1e-5)
    assert row["heaps"] == "10"


def test_a_policy_without_heaps_of_a_size_has_no_point_there(experiment: Experiment) -> None:
    assert experiment.conditions["single"].scores_of("idle", count=7) == {}
