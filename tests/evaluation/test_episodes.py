from pathlib import Path

import numpy as np
import pytest

from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation, GraspRecord
from mechsearch.types import MechSearchError


def assert_same(left: EpisodeRecord, right: EpisodeRecord) -> None:
    for name in EpisodeRecord.__dataclass_fields__:
        a, b = getattr(left, name), getattr(right, name)
        if name == "reward_terms":
            assert list(a) == list(b)
            for term in a:
                np.testing.assert_array_equal(a[term], b[term], strict=True)
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, strict=True)
        else:
            assert a == b


@pytest.fixture
def evaluation(make_episode) -> Evaluation:
    ragged = (
        make_episode(1, length=4),
        make_episode(2, length=1, count=15, end="uncovered"),
        make_episode(3, length=0, end="failure: NaN"),
        make_episode(4, length=7, policy="zigzag å"),
        make_episode(5, grasp=GraspRecord(0.0, 0.75, 0.875, "", "wrong object")),
    )
    return Evaluation({"seed": 3, "nested": {"a": [1, 2.5, None]}}, ragged)


def test_loading_gives_back_what_was_saved(tmp_path: Path, evaluation: Evaluation) -> None:
    path = tmp_path / "deep" / "random.npz"
    episodes.save_episodes(path, evaluation)
    loaded = episodes.load_episodes(path)
    assert loaded.header == evaluation.header
    assert len(loaded.episodes) == 5
    for left, right in zip(evaluation.episodes, loaded.episodes, strict=True):
        assert_same(left, right)


def test_the_same_episodes_give_the_same_bytes(tmp_path: Path, evaluation: Evaluation) -> None:
    episodes.save_episodes(tmp_path / "a.npz", evaluation)
    episodes.save_episodes(tmp_path / "b.npz", episodes.load_episodes(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_every_single_damaged_byte_of_the_poses_is_refused_or_harmless(
    tmp_path: Path, evaluation: Evaluation
) -> None:
    path = tmp_path / "a.npz"
    episodes.save_episodes(path, evaluation)
    whole = bytearray(path.read_bytes())
    for place in range(40, len(whole), 97):
        torn = whole.copy()
        torn[place] ^= 0x10
        path.write_bytes(torn)
        try:
            loaded = episodes.load_episodes(path)
        except MechSearchError:
            continue
        for left, right in zip(evaluation.episodes, loaded.episodes, strict=True):
            assert_same(left, right)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY", b"not an archive"])
def test_a_file_that_is_no_evaluation_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(MechSearchError, match=r"a\.npz is damaged"):
        episodes.load_episodes(path)


def test_an_array_file_or_a_pickle_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(MechSearchError, match="no evaluation"):
        episodes.load_episodes(tmp_path / "other.npz")
    np.savez(tmp_path / "pickle.npz", text=np.array([{}], dtype=object))
    with pytest.raises(MechSearchError, match="no evaluation"):
        episodes.load_episodes(tmp_path / "pickle.npz")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="no evaluation at"):
        episodes.load_episodes(tmp_path / "absent.npz")
    with pytest.raises(MechSearchError, match="is a folder"):
        episodes.load_episodes(tmp_path)


def test_nothing_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="no episode"):
        episodes.save_episodes(tmp_path / "a.npz", Evaluation({}, ()))
    assert list(tmp_path.iterdir()) == []


def test_arrays_of_another_length_are_refused(make_episode) -> None:
    with pytest.raises(MechSearchError, match=r"poses of the episode on heap 7 is \(3, 5, 7\)"):
        make_episode(7, poses=np.zeros((3, 5, 7)))
    with pytest.raises(MechSearchError, match="idleness"):
        make_episode(7, reward_terms={"idleness": np.zeros(3)})
    with pytest.raises(MechSearchError, match="target 5 is not one of 5"):
        make_episode(7, target=5)


def test_rewards_are_the_sum_of_the_terms(make_episode) -> None:
    terms = {"a": np.array([1.0, 2.0]), "b": np.array([-0.5, -0.5])}
    np.testing.assert_allclose(make_episode(length=2, reward_terms=terms).rewards, [0.5, 1.5])
