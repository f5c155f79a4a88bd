from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.cli import main
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, replay_all
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.types import MechSearchError


@pytest.fixture(scope="module")
def heaps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("verify") / "heaps.parquet"
    generate(GenerateConfig(heaps=6, counts=(4,), seed=8), path)
    return path


@pytest.fixture(scope="module")
def recorded(heaps: Path) -> Evaluation:
    return evaluate_plan(EvaluationPlan("teacher-spiral", heaps))


def changed(evaluation: Evaluation, **values: object) -> Evaluation:
    """Return the evaluation with something else in its first episode."""
    first = replace(evaluation.episodes[0], **values)
    return Evaluation(evaluation.header, (first, *evaluation.episodes[1:]))


def test_what_a_file_holds_is_played_again_bit_by_bit(
    heaps: Path, recorded: Evaluation, tmp_path: Path
) -> None:
    episodes.save_episodes(tmp_path / "spiral.npz", recorded)
    found = list(replay_all(episodes.load_episodes(tmp_path / "spiral.npz"), heaps))
    assert len(found) == 3
    assert all(replay.passed for replay in found)


def test_the_least_change_of_any_number_is_found_and_named(
    heaps: Path, recorded: Evaluation
) -> None:
    first = recorded.episodes[0]
    for name in ("occlusions", "poses", "ee_positions", "clutter_moved", "target_moved"):
        values = getattr(first, name).copy()
        values[-1] = np.nextafter(values[-1], 9.0)
        replay = next(iter(replay_all(changed(recorded, **{name: values}), heaps)))
        assert replay.differences == (f"{name} from {len(values) - 1} on",)
    terms = {name: term.copy() for name, term in first.reward_terms.items()}
    terms["uncovering"][0] += 1e-9
    replay = next(iter(replay_all(changed(recorded, reward_terms=terms), heaps)))
    assert replay.differences == ("reward term uncovering from 0 on",)
    replay = next(iter(replay_all(changed(recorded, end="lost"), heaps)))
    assert replay.differences == (f"the end, {first.end!r} instead of 'lost'",)


def test_an_episode_cut_short_is_found(heaps: Path, recorded: Evaluation) -> None:
    first = recorded.episodes[0]
    short = {
        name: getattr(first, name)[:-1]
        for name in (
            "actions",
            "clutter_moved",
            "target_moved",
            "ee_positions",
            "occlusions",
            "poses",
        )
    }
    terms = {name: term[:-1] for name, term in first.reward_terms.items()}
    cut = changed(recorded, **short, reward_terms=terms)
    replay, *others = replay_all(cut, heaps)
    assert replay.differences == ("it goes on after the last recorded action",)
    assert all(other.passed for other in others)


def test_another_heap_set_is_refused(heaps: Path, recorded: Evaluation, tmp_path: Path) -> None:
    generate(GenerateConfig(heaps=2, counts=(3,), seed=9), tmp_path / "others.parquet")
    with pytest.raises(MechSearchError, match="these episodes ran on the heap set"):
        list(replay_all(recorded, tmp_path / "others.parquet"))


def test_the_command_tells_how_many_and_fails_if_one_differs(
    heaps: Path, recorded: Evaluation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    episodes.save_episodes(good, recorded)
    words = ["--heaps", str(heaps), "--workers", "1"]
    main(["verify", str(good), *words])
    assert "3 of 3 episodes are as recorded, bit by bit" in capsys.readouterr().out
    poses = recorded.episodes[0].poses.copy()
    poses[1, 0, 0] += 1e-12
    episodes.save_episodes(bad, changed(recorded, poses=poses))
    with pytest.raises(SystemExit) as stopped:
        main(["verify", str(bad), *words])
    assert stopped.value.code == 1
    said = capsys.readouterr().out
    assert "bits may differ" not in said
    assert "2 of 3 episodes" in said
    assert "poses from 1 on" in said
    header = recorded.header | {"fingerprint": {**recorded.header["fingerprint"], "numpy": "1.0"}}
    episodes.save_episodes(good, Evaluation(header, recorded.episodes))
    main(["verify", str(good), *words])
    assert "instead of 1.0: bits may differ by rounding" in capsys.readouterr().out
