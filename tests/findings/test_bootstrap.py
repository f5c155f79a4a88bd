import numpy as np
import pytest
from scipy import stats

from mechsearch.findings.bootstrap import (
    estimated,
    percentile_interval,
    replicates,
    stretched,
)
from mechsearch.types import MechSearchError


def coverage(
    rng: np.random.Generator, seeds: int, heaps: int, of_seed: float, of_heap: float, rest: float
) -> float:
    """Share of simulated experiments whose interval has the true mean, 0, in it."""
    covered = 0
    for _ in range(400):
        values = (
            of_seed * rng.normal(size=(seeds, 1))
            + of_heap * rng.normal(size=(1, heaps))
            + rest * rng.normal(size=(seeds, heaps))
        )
        means = replicates([values], rng, samples=800)[0]
        found = percentile_interval(float(values.mean()), means, heaps)
        covered += found.ci_low <= 0 <= found.ci_high
    return covered / 400


def test_with_one_seed_the_interval_is_nearly_student_s() -> None:
    values = np.random.default_rng(1).normal(3, 2, size=(1, 60))
    found = estimated([values])
    half = stats.t.ppf(0.975, 59) * values.std(ddof=1) / np.sqrt(60)
    assert found.mean == pytest.approx(values.mean())
    assert found.ci_low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.ci_high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_effects_are_stretched_by_hand_computed_factors() -> None:
    """Seeds at 0 and 2 without heap effects: sqrt(2) t(1) / z = 1.414 * 12.706 / 1.960 = 9.168."""
    values = np.array([[0.0, 0.0], [2.0, 2.0]])
    np.testing.assert_allclose(stretched(values), [[-8.168, -8.168], [10.168, 10.168]], atol=1e-3)


def test_two_seeds_that_disagree_widen_the_interval_over_one() -> None:
    rng = np.random.default_rng(2)
    heap = rng.normal(size=(1, 100))
    alike = estimated([np.vstack([heap, heap])])
    apart = estimated([np.vstack([heap - 1, heap + 1])])
    assert apart.ci_high - apart.ci_low > 5 * (alike.ci_high - alike.ci_low)


def test_a_constant_shift_on_the_same_heaps_has_no_width() -> None:
    """Pairing: what heaps have in common cancels in every draw, not on average only."""
    easy_or_hard = np.random.default_rng(3).normal(0, 10, size=(1, 50))
    drawn = replicates([easy_or_hard + 0.5, easy_or_hard], np.random.default_rng(0))
    np.testing.assert_allclose(drawn[0] - drawn[1], 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("seeds", "of_seed", "of_heap", "rest"),
    [(1, 0.0, 1.0, 0.0), (5, 1.0, 0.3, 0.5), (5, 0.1, 1.0, 1.0), (3, 1.0, 1.0, 1.0)],
)
def test_simulated_experiments_are_covered_as_often_as_promised(
    seeds: int, of_seed: float, of_heap: float, rest: float
) -> None:
    share = coverage(np.random.default_rng(seeds), seeds, 40, of_seed, of_heap, rest)
    assert 0.91 <= share <= 0.995


def test_without_the_correction_five_seeds_would_be_covered_too_rarely() -> None:
    rng, covered = np.random.default_rng(4), 0
    for _ in range(400):
        values = rng.normal(size=5)
        means = values[rng.integers(0, 5, (800, 5))].mean(axis=1)
        low, high = np.percentile(means, [2.5, 97.5])
        covered += low <= 0 <= high
    assert covered / 400 < 0.9


def test_what_is_undefined_in_many_draws_has_no_interval() -> None:
    means = np.r_[np.full(50, np.nan), np.linspace(0, 1, 950)]
    assert np.isnan(percentile_interval(0.5, means, 10).ci_low)
    assert not np.isnan(percentile_interval(0.5, means[45:], 10).ci_low)


def test_a_single_heap_has_no_interval() -> None:
    assert np.isnan(estimated([np.ones((3, 1))]).ci_low)


def test_other_heaps_and_empty_tables_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(MechSearchError, match=r"\(1, 3\), \(1, 4\); expected the same heaps"):
        replicates([np.ones((1, 3)), np.ones((1, 4))], rng)
    with pytest.raises(MechSearchError, match="at least one seed"):
        replicates([np.ones((0, 3))], rng)
