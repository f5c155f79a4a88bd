import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.evaluation.episodes import save_episodes
from mechsearch.findings.analysis import analyse
from mechsearch.findings.experiment import read_experiment
from mechsearch.findings.scores import (
    compact,
    episode_files,
    load_scores,
    ranked_heaps,
    read_scored,
    save_scores,
    score_episodes,
    scores_file,
)
from mechsearch.report.contents import document
from mechsearch.report.document import to_html
from mechsearch.types import MechSearchError


@pytest.fixture
def episodes(loose: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(loose / "method.npz", tmp_path / "method.npz"))


def test_scores_are_the_same_to_the_last_bit_from_the_compact_file(episodes: Path) -> None:
    assert compact(episodes) == [episodes.with_name("method.scores.npz")]
    measured, kept = score_episodes(episodes), load_scores(scores_file(episodes))
    assert (kept.path, kept.digest, kept.modes) == (episodes, measured.digest, measured.modes)
    assert kept.header == measured.header
    assert list(kept.values) == list(measured.values)
    for name, values in measured.values.items():
        np.testing.assert_array_equal(kept.values[name], values)
    np.testing.assert_array_equal(kept.heaps, measured.heaps)
    np.testing.assert_array_equal(kept.counts, measured.counts)


def test_the_same_scores_are_the_same_bytes(episodes: Path) -> None:
    (path,) = compact(episodes.parent)
    before = path.read_bytes()
    assert compact(episodes.parent) == [path]
    assert path.read_bytes() == before
    assert len(before) < episodes.stat().st_size


def test_a_sweep_without_its_episodes_says_the_same_to_the_letter(
    sweep: Path, tmp_path: Path
) -> None:
    light = Path(shutil.copytree(sweep, tmp_path / "light"))
    written = compact(light)
    assert len(written) == len(episode_files([sweep]))
    for path in episode_files([light]):
        path.unlink()
    assert compact(light) == []
    whole, small = (analyse(read_experiment(folder)) for folder in (sweep, light))
    assert small.numbers == whole.numbers
    assert to_html(document(small, "T")) == to_html(document(whole, "T"))


def test_compact_scores_of_other_episodes_are_refused(episodes: Path, make_evaluation) -> None:
    (path,) = compact(episodes)
    save_episodes(episodes, make_evaluation("method", 0.1))
    with pytest.raises(MechSearchError, match=r"method\.scores\.npz was measured from other"):
        read_scored(episodes)
    compact(episodes)
    assert read_scored(episodes).digest == load_scores(path).digest


def test_a_file_may_be_named_by_either_of_its_names(episodes: Path) -> None:
    (path,) = compact(episodes)
    assert episode_files([episodes, path, episodes.parent]) == [episodes]
    episodes.unlink()
    assert episode_files([episodes]) == episode_files([path]) == [episodes]
    assert read_scored(episodes).name == "method"
    path.unlink()
    with pytest.raises(MechSearchError, match="there is nothing at"):
        episode_files([episodes])


def test_what_is_no_compact_file_is_refused(episodes: Path) -> None:
    (path,) = compact(episodes)
    with pytest.raises(MechSearchError, match="damaged or no compact scores"):
        load_scores(episodes)
    with pytest.raises(MechSearchError, match="no compact scores at"):
        load_scores(path.with_name("absent.scores.npz"))
    path.write_bytes(path.read_bytes()[:200])
    episodes.unlink()
    with pytest.raises(MechSearchError, match=r"method\.scores\.npz is damaged"):
        read_scored(episodes)


def test_scores_that_do_not_fit_together_are_refused(episodes: Path) -> None:
    found = score_episodes(episodes)
    with pytest.raises(MechSearchError, match="one score of each kind on every heap"):
        replace(found, counts=found.counts[1:])
    with pytest.raises(MechSearchError, match="more than one episode on a heap"):
        replace(found, heaps=np.zeros_like(found.heaps))
    lacking = {k: v for k, v in found.header.items() if k not in ("name", "seed")}
    with pytest.raises(MechSearchError, match="does not say its name, seed"):
        replace(found, header=lacking)


def test_later_formats_are_refused_by_their_number(
    episodes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mechsearch.findings.scores.SCORES_FORMAT", 2)
    save_scores(scores_file(episodes), score_episodes(episodes))
    monkeypatch.undo()
    with pytest.raises(MechSearchError, match="scores of format 2; this version reads 1"):
        load_scores(scores_file(episodes))


def test_worst_median_and_best_are_chosen_by_rank() -> None:
    heaps = ranked_heaps([7, 8, 9, 10, 11], [0.0, -3.0, 5.0, 1.0, 2.0])
    assert heaps == {"worst": 8, "median": 10, "best": 9}
