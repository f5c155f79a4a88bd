from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.findings.failure_modes import (
    ASTRAY,
    BACK_AND_FORTH,
    DEFINITION,
    FAILED_SIMULATION,
    HOVERING,
    LOST,
    STANDING,
    SUCCESS,
    UNFINISHED,
    longest_run,
    mode_of,
    reversal_share,
)

ACTIONS = 50


def still_episode(moves: np.ndarray, end: str = "action limit") -> EpisodeRecord:
    """Nothing but the end effector moves, by `moves` (T, 3) [m]."""
    length = len(moves)
    poses = np.zeros((length + 1, 3, 7))
    poses[..., 3] = 1
    ee = np.vstack([np.zeros(3), np.cumsum(moves, axis=0)])
    nothing = np.zeros(length)
    return EpisodeRecord(
        1, 3, "single", "method", ("a", "b", "c"), 0, moves.astype(np.float32), ee,
        np.full(length + 1, 0.5), poses, {"idleness": nothing}, nothing, nothing, end, ACTIONS,
    )  # fmt: skip


def to_and_fro(period: int) -> np.ndarray:
    """Moves of 3 cm along x that turn round after every `period` actions."""
    signs = np.where(np.arange(ACTIONS) // period % 2, -1, 1)
    return np.stack([0.03 * signs, np.zeros(ACTIONS), np.zeros(ACTIONS)], axis=1)


def circle() -> np.ndarray:
    angles = np.linspace(0, 6 * np.pi, ACTIONS)
    return 0.02 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)


def touched(record: EpisodeRecord, actions: range) -> EpisodeRecord:
    """Object 1 slides by 5 mm in each of these actions."""
    poses = record.poses.copy()
    for action in actions:
        poses[action + 1 :, 1, 0] += 0.005
    return replace(record, poses=poses)


@pytest.mark.parametrize("period", [1, 2])
def test_turning_round_again_and_again_without_touching_is_back_and_forth(period: int) -> None:
    assert mode_of(still_episode(to_and_fro(period))).mode == BACK_AND_FORTH


def test_moving_about_without_touching_is_hovering() -> None:
    found = mode_of(still_episode(circle()))
    assert (found.mode, found.stretch) == (HOVERING, ACTIONS)


def test_random_commands_are_not_back_and_forth() -> None:
    """They reverse now and then, in a quarter of the turns at most times."""
    rng = np.random.default_rng(0)
    modes = [mode_of(still_episode(rng.uniform(-0.03, 0.03, (50, 3)))).mode for _ in range(200)]
    assert modes.count(BACK_AND_FORTH) < 20


def test_moving_about_far_from_the_target_is_astray() -> None:
    record = still_episode(circle())
    elsewhere = record.ee_positions + np.array([0.3, 0, 0])
    assert mode_of(replace(record, ee_positions=elsewhere)).mode == ASTRAY


def test_an_end_effector_that_hardly_moves_stands_still() -> None:
    assert mode_of(still_episode(0.1 * to_and_fro(1))).mode == STANDING
    assert mode_of(still_episode(np.zeros((ACTIONS, 3)))).mode == STANDING


def test_a_success_is_a_success_however_it_moved() -> None:
    assert mode_of(still_episode(to_and_fro(1), "uncovered")).mode == SUCCESS


def test_lost_targets_and_failed_simulations_are_told_apart() -> None:
    assert mode_of(still_episode(circle(), "lost")).mode == LOST
    assert mode_of(still_episode(circle(), "failure: explosion")).mode == FAILED_SIMULATION


def test_twenty_still_actions_in_a_row_make_a_failure_mode_and_nineteen_do_not() -> None:
    record = still_episode(to_and_fro(1))
    ending = [mode_of(touched(record, range(n, ACTIONS))) for n in (19, 20)]
    assert [found.mode for found in ending] == [UNFINISHED, BACK_AND_FORTH]
    assert [found.stretch for found in ending] == [19, 20]


def test_only_the_longest_still_stretch_is_judged() -> None:
    """It reverses while it pushes, and then circles in the air."""
    moves = np.vstack([to_and_fro(1)[:25], circle()[:25]])
    assert mode_of(touched(still_episode(moves), range(25))).mode == HOVERING


def test_movements_of_a_millimetre_do_not_count_and_larger_ones_do() -> None:
    record = still_episode(circle())
    poses = record.poses.copy()
    for action in range(ACTIONS):
        poses[action + 1 :, 2, 1] += 0.0009
    assert mode_of(replace(record, poses=poses)).mode == HOVERING
    assert mode_of(touched(record, range(ACTIONS))).mode == UNFINISHED


def test_a_turn_of_exactly_120_degrees_reverses() -> None:
    angles = np.radians(120) * np.arange(6)
    turns = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    assert reversal_share(turns, np.radians(120)) == 1
    assert reversal_share(turns, np.radians(121)) == 0
    assert reversal_share(turns[:1], np.radians(90)) == 0


@given(st.lists(st.booleans(), max_size=30))
def test_the_longest_run_is_all_true_and_none_is_longer(flags: list[bool]) -> None:
    start, end = longest_run(np.array(flags, bool))
    assert all(flags[start:end])
    words = "".join("x" if flag else " " for flag in flags).split()
    assert end - start == max(map(len, words), default=0)


def test_the_definition_names_every_threshold() -> None:
    for words in ("1 mm", "20 actions", "5 mm", "25%", "40%", "15 cm", "120°"):
        assert words in DEFINITION
