"""A sweep of seconds on household heaps."""

from importlib import resources

import pytest

from mechsearch.experiments.plan import SweepPlan


@pytest.fixture(scope="session")
def tiny():
    heaps = resources.files("mechsearch.heaps") / "household_single.parquet"
    return SweepPlan(
        experiment="tiny",
        heaps_single=str(heaps),
        conditions=("single",),
        variants=("method", "plus"),
        seeds=(0,),
        actions=60,
        references=("idle", "teacher-straight"),
        curve_heaps=2,
        curve_every=20,
        final_heaps=3,
        grasps=False,
    )
