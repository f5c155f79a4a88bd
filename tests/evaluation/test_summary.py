import multiprocessing
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import METRICS, Evaluation, SummaryRow
from mechsearch.types import MechSearchError

HEADER = "experiment,condition,variant,seed,actions,metric,mean,ci_low,ci_high\n"
HEADER_OF = {
    "condition": "single",
    "name": "random",
    "seed": 0,
    "trained": False,
    "training_seed": None,
    "training_actions": 0,
}
ROW = SummaryRow("main", "single", "method", 0, 8000, "reward", -15.25, -16.5, -14.0)


def test_there_is_one_row_for_each_metric(make_episode) -> None:
    evaluation = Evaluation(HEADER_OF, (make_episode(1), make_episode(2)))
    rows = episodes.summary_rows("main", evaluation)
    assert tuple(row.metric for row in rows) == METRICS
    assert all(row.ci_low <= row.mean <= row.ci_high for row in rows)


def test_the_file_is_plain_csv(tmp_path: Path) -> None:
    episodes.merge_summary(tmp_path / "summary.csv", [ROW])
    text = (tmp_path / "summary.csv").read_text()
    assert text == HEADER + "main,single,method,0,8000,reward,-15.25,-16.5,-14\n"


def test_merging_replaces_rows_of_the_same_name_and_keeps_the_others(tmp_path: Path) -> None:
    path = tmp_path / "summary.csv"
    other_seed = replace(ROW, seed=1)
    episodes.merge_summary(path, [other_seed, ROW])
    merged = episodes.merge_summary(path, [replace(ROW, mean=-15.0)])
    assert merged == [replace(ROW, mean=-15.0), other_seed]
    assert episodes.read_summary(path) == merged


names = st.text("ab,;\"' -é", min_size=1, max_size=8)
numbers = st.floats(-1e6, 1e6).map(lambda value: float(f"{value:.6g}"))
table = st.lists(
    st.builds(
        SummaryRow,
        names,
        names,
        names,
        st.integers(0, 3),
        st.integers(0, 9000),
        st.sampled_from(METRICS),
        numbers,
        numbers,
        numbers,
    ),
    max_size=6,
)


@settings(max_examples=30, deadline=None)
@given(table, table)
def test_merging_is_idempotent_and_sorted(tmp_path_factory, first: list, second: list) -> None:
    path = tmp_path_factory.mktemp("summary") / "summary.csv"
    episodes.merge_summary(path, first)
    once = episodes.merge_summary(path, second)
    before = path.read_bytes()
    assert episodes.merge_summary(path, second) == once == sorted(once, key=lambda row: row.key)
    assert path.read_bytes() == before
    assert episodes.read_summary(path) == once
    assert {row.key for row in once} == {row.key for row in first + second}


def test_an_interval_that_does_not_exist_survives_the_file(tmp_path: Path) -> None:
    nothing = float("nan")
    episodes.merge_summary(tmp_path / "s.csv", [replace(ROW, ci_low=nothing, ci_high=nothing)])
    assert all(row.ci_low != row.ci_low for row in episodes.read_summary(tmp_path / "s.csv"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "begins with nothing"),
        ("a,b\n", "begins with a,b; expected experiment,condition"),
        (HEADER + "main,single,method,zero,0,reward,1,1,1\n", "line 2 of"),
        (HEADER + "main,single\n", "line 2 of"),
    ],
)
def test_a_file_that_is_no_summary_is_refused_and_kept(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "summary.csv"
    path.write_text(text)
    with pytest.raises(MechSearchError, match=message):
        episodes.merge_summary(path, [ROW])
    assert path.read_text() == text
    assert [file for file in tmp_path.iterdir() if file.suffix != ".lock"] == [path]


def test_a_missing_summary_is_named(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="no summary at"):
        episodes.read_summary(tmp_path / "summary.csv")


def merge_rows(path: Path, seed: int) -> None:
    for actions in range(15):
        episodes.merge_summary(path, [replace(ROW, seed=seed, actions=actions)])


def test_processes_that_merge_at_once_lose_no_row(tmp_path: Path) -> None:
    path = tmp_path / "summary.csv"
    context = multiprocessing.get_context("spawn")
    crew = [context.Process(target=merge_rows, args=(path, seed)) for seed in range(2)]
    for process in crew:
        process.start()
    for process in crew:
        process.join()
    assert [process.exitcode for process in crew] == [0] * 2
    assert len(episodes.read_summary(path)) == 30
