from dataclasses import replace
from pathlib import Path

from mechsearch.findings.analysis import mode_table
from mechsearch.findings.experiment import read_experiment
from mechsearch.findings.failure_modes import HOVERING, SUCCESS, UNCOVERING_MODES, EpisodeMode


def test_the_table_counts_every_episode_once_with_wilson_s_interval(loose: Path) -> None:
    """3 of 10: 30 %, Wilson 10.8 to 60.3 %."""
    single = read_experiment(loose / "method.npz").conditions["single"]
    (scored,) = single.policies["method"]
    modes = (EpisodeMode(SUCCESS, 0),) * 3 + (EpisodeMode(HOVERING, 30),) * 7
    ten = replace(
        scored,
        heaps=scored.heaps[:10],
        counts=scored.counts[:10],
        values={name: values[:10] for name, values in scored.values.items()},
        modes=modes,
    )
    (row,) = mode_table(replace(single, policies={"method": (ten,)})).rows
    shares = dict(zip(UNCOVERING_MODES, row[2:], strict=True))
    assert row[:2] == ("method", "10")
    assert shares[SUCCESS] == "30\n11 to 60"
    assert sum(int(cell.split("\n")[0]) for cell in row[2:]) == 100
