from dataclasses import replace
from pathlib import Path

import pytest

from mechsearch.evaluation.episodes import METRICS, Estimate, save_episodes
from mechsearch.findings.analysis import analyse, compare_with_others, comparison_table, outcome
from mechsearch.findings.experiment import Condition, read_experiment
from mechsearch.findings.tables import MINUS


@pytest.fixture(scope="module")
def condition(loose: Path) -> Condition:
    return read_experiment(loose).conditions["single"]


@pytest.mark.parametrize(
    ("metric", "low", "high", "expected"),
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
    metric: str, low: float, high: float, expected: str
) -> None:
    assert outcome(metric, Estimate((low + high) / 2, low, high, 9)) == expected


def test_the_sentence_says_whom_it_beats_and_to_whom_it_loses(condition: Condition) -> None:
    text = compare_with_others(condition, "method").sentences[0]
    assert text.startswith("In reward, method beats idle (+")
    assert f"it loses to teacher-spiral ({MINUS}" in text


def test_a_policy_alone_is_compared_with_nobody(loose: Path) -> None:
    (found,) = analyse(read_experiment(loose / "idle.npz")).comparisons
    assert (found.ours, found.sentences, dict(found.against)) == ("idle", (), {})


def test_a_policy_is_held_between_doing_nothing_and_the_best_teacher(condition: Condition) -> None:
    _, gap, visibility, clutter = compare_with_others(condition, "method").sentences
    assert "(random, " in gap
    assert "the best teacher (teacher-spiral, " in gap
    assert "of the change in visibility of teacher-spiral" in visibility
    assert "less than teacher-spiral" in clutter


def test_the_best_teacher_closes_its_own_gap_entirely(condition: Condition) -> None:
    _, gap, visibility, _ = compare_with_others(condition, "teacher-spiral").sentences
    assert "teacher-spiral closes 100% (100% to 100%)" in gap
    assert "It reaches 100%" in visibility
    assert "closes 0% (0% to 0%)" in compare_with_others(condition, "random").sentences[1]


def test_without_teachers_or_passive_policies_there_is_no_gap(loose: Path) -> None:
    found = read_experiment(loose / "method.npz", loose / "random.npz")
    assert len(compare_with_others(found.conditions["single"], "method").sentences) == 1


def test_the_table_has_a_mark_for_each_difference(condition: Condition) -> None:
    table = comparison_table(compare_with_others(condition, "method"))
    assert [row[0] for row in table.rows] == [n for n in condition.policies if n != "method"]
    assert all(len(row) == len(METRICS) for row in table.marks)
    against = {row[0]: marks for row, marks in zip(table.rows, table.marks, strict=True)}
    against_idle = dict(zip(METRICS, against["idle"], strict=True))
    assert against_idle["reward"] == "better"
    assert against_idle["clutter_moved_m"] == "worse"


def test_seeds_that_disagree_leave_undecided_what_one_seed_would_decide(
    make_evaluation, tmp_path: Path
) -> None:
    """The same interval as for a sweep: it covers the seeds too, where there are several."""
    save_episodes(tmp_path / "idle.npz", make_evaluation("idle", 0.0))
    for seed, gain in enumerate((0.2, 0.9)):
        header = {"trained": True, "training_seed": seed, "training_actions": 3000}
        save_episodes(tmp_path / f"mine-{seed}.npz", make_evaluation("mine", gain, **header))
    one = read_experiment(tmp_path / "mine-0.npz", tmp_path / "idle.npz").conditions["single"]
    both = read_experiment(tmp_path).conditions["single"]
    metric = "visibility_change"
    found = [compare_with_others(c, "mine").against["idle"][metric] for c in (one, both)]
    assert [outcome(metric, difference) for difference in found] == ["better", "undecided"]


def test_another_teacher_is_compared_with_and_changes_no_claim(sweep: Path, loose: Path) -> None:
    """A teacher beyond the paper's three is one more policy, but never its best teacher."""
    experiment = read_experiment(sweep)
    before = analyse(experiment)
    single = experiment.conditions["single"]
    better = [
        replace(
            one,
            header={**one.header, "name": "teacher-new"},
            values={name: values / 2 for name, values in one.values.items()},
        )
        for one in single.policies["teacher-spiral"]
    ]
    more = replace(single, policies={**single.policies, "teacher-new": tuple(better)})
    after = analyse(replace(experiment, conditions={**experiment.conditions, "single": more}))
    assert after.numbers["claims"] == before.numbers["claims"]
    gap = compare_with_others(more, "method").sentences[1]
    assert "the best teacher (teacher-new, " in gap
