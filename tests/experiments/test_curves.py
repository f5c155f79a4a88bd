import csv

import pytest

from mechsearch.evaluation.episodes import METRICS
from mechsearch.experiments.folder import write_curves
from mechsearch.files import CONFIG_FILE
from mechsearch.training.config import run_config, save_config
from mechsearch.training.log import RunLog


@pytest.mark.parametrize("more", [(), ("graspability_change",)])
def test_every_metric_that_was_logged_on_held_out_heaps_is_a_row(tmp_path, more):
    run = tmp_path / "dual" / "runs" / "method-seed0"
    run.mkdir(parents=True)
    save_config(run_config("method"), run / CONFIG_FILE)
    metrics = (*METRICS, *more)
    scores = {name + end: 0.5 for name in metrics for end in ("", "_ci_low", "_ci_high")}
    log = RunLog(run)
    log.write("validation", 1000, scores)
    log.write("held_out", 1000, scores | {"heaps": 50})
    log.close()
    write_curves(tmp_path / "curves.csv", [run])
    rows = list(csv.DictReader((tmp_path / "curves.csv").read_text().splitlines()))
    assert sorted(row["metric"] for row in rows) == sorted(metrics)
    assert {(row["condition"], row["step"], row["mean"]) for row in rows} == {
        ("dual", "1000", "0.5")
    }
