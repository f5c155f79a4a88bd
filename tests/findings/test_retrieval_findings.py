"""What is found of retrieval: how episodes end, who retrieves more, and apart from uncovering."""

from pathlib import Path

import pytest

from mechsearch.evaluation.episodes import RETRIEVAL_METRICS, save_episodes
from mechsearch.findings.analysis import analyse, comparison_table, lead, mode_table, score_tables
from mechsearch.findings.experiment import read_experiment
from mechsearch.findings.failure_modes import (
    EPISODE_MODES,
    NEVER_GRASPED,
    RETRIEVAL_MODES,
    SUCCESS,
    UNCOVERING_MODES,
    mode_of,
)
from mechsearch.findings.scores import compact, load_scores, read_scored, scores_file
from mechsearch.types import MechSearchError, Outcome
from tests.findings.conftest import episode, grasping


@pytest.mark.parametrize(
    ("outcomes", "mode"),
    [
        (("blocked", "missed", "success"), SUCCESS),
        (("blocked",) * 4 + ("slipped", "missed", "slipped"), "slipped"),
        (("slipped", "missed", "blocked"), "blocked"),
        (("slipped", "used up"), "slipped"),
        (("no seal",), "no seal"),
        (("used up",), NEVER_GRASPED),
        ((), NEVER_GRASPED),
    ],
)
def test_a_failed_retrieval_is_named_after_its_last_grasps(outcomes, mode) -> None:
    assert mode_of(grasping(episode(0, "p", 0.5), *outcomes)).mode == mode


def test_every_outcome_has_a_mode_and_the_old_ones_keep_their_places() -> None:
    assert {*map(str, Outcome)} - {Outcome.FAILURE} <= set(RETRIEVAL_MODES)
    assert EPISODE_MODES[: len(UNCOVERING_MODES)] == UNCOVERING_MODES
    assert len(set(EPISODE_MODES)) == len(EPISODE_MODES)
    assert set(RETRIEVAL_MODES) <= set(EPISODE_MODES)


def test_retrieval_is_compared_by_what_is_retrieved_heap_by_heap(retrievals: Path) -> None:
    condition = read_experiment(retrievals).conditions["single-retrieval"]
    assert condition.subjects == ["persistent"]
    (comparison,) = analyse(read_experiment(retrievals)).comparisons
    first, within = comparison.sentences
    assert first == (
        "In targets retrieved at the first attempt, persistent shows no clear difference from weak "
        "(0, 0 to 0 points)."
    )
    assert within.startswith(
        "In targets retrieved within five attempts, persistent beats weak (+50, "
    )
    assert within.endswith(" points).")
    table = comparison_table(comparison)
    assert len(table.columns) == 1 + len(RETRIEVAL_METRICS)
    assert table.columns[1] == "retrieved at once [points]"
    assert table.rows[0][3].startswith("▲ +50")


def test_tables_of_retrieval_have_its_scores_and_only_the_modes_that_occur(
    retrievals: Path,
) -> None:
    experiment = read_experiment(retrievals)
    condition = experiment.conditions["single-retrieval"]
    assert lead(experiment).startswith("2 policies that retrieve on 12 held-out single heaps, all")
    scores, *by_count, terms = score_tables(condition)
    assert scores.caption == "Scores in retrieval from single heaps"
    assert scores.columns[3:6] == (
        "retrieved at once [%]", "within 3 attempts [%]", "within 5 attempts [%]",
    )  # fmt: skip
    assert [table.columns[1] for table in by_count] == ["5 objects"] * 3
    assert terms.columns == ("policy", "retrieved", "clutter movement", "reward")
    modes = mode_table(condition)
    assert modes.columns == ("policy", "episodes", "success [%]", "slipped [%]")
    assert [row[2].split("\n")[0] for row in modes.rows] == ["100", "50"]


def test_compact_scores_keep_how_retrieval_ended(make_retrieval, tmp_path: Path) -> None:
    path = tmp_path / "weak.npz"
    save_episodes(path, make_retrieval("weak", "slipped", "no seal"))
    compact(path)
    kept = load_scores(scores_file(path))
    assert kept.modes == read_scored(path).modes
    assert {one.mode for one in kept.modes} == {SUCCESS, "no seal"}
    assert kept.retrieves


def test_uncovering_and_retrieval_are_told_apart(loose: Path, retrievals: Path) -> None:
    found = read_experiment(loose, retrievals)
    assert list(found.conditions) == ["single", "single-retrieval"]
    assert [c.heaps for c in found.conditions.values()] == [
        "single heaps", "retrieval from single heaps",
    ]  # fmt: skip
    assert not found.conditions["single"].retrieves
    alone = read_experiment(loose).conditions["single"]
    assert found.conditions["single"].policies.keys() == alone.policies.keys()


def test_a_sweep_s_condition_has_one_aim(write_sweep, make_retrieval, tmp_path: Path) -> None:
    folder = write_sweep(tmp_path / "s", {"single": {"method": 0.5, "idle": 0.0}}, seeds=1)
    path = folder / "single" / "evaluations" / "weak.npz"
    save_episodes(path, make_retrieval("weak", "slipped"))
    with pytest.raises(MechSearchError, match=r"weak\.npz retrieves and .* uncovers targets"):
        read_experiment(folder)
