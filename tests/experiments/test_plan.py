from dataclasses import replace

import pytest

pytest.importorskip("torch")

from mechsearch.env.heap_env import TaskConfig
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.plan import QUICK, VARIANTS, SweepPlan, open_plan, read_plan
from mechsearch.experiments.sweep import (
    BEGAN,
    ENDED,
    FAILED,
    History,
    Journal,
    chains_of,
    next_wave,
    status,
)
from mechsearch.files import read_record, write_record
from mechsearch.training.config import run_config
from mechsearch.types import MechSearchError


def names(chains):
    return [job.name for chain in chains for job in chain]


def test_the_paper_is_planned_by_default():
    plan = SweepPlan()
    assert plan.variants == VARIANTS
    jobs = names(chains_of(plan, SweepFolder(None)))
    runs = [name for name in jobs if "-seed" in name and "scores" not in name]
    assert len(runs) == 2 * len(VARIANTS) * 5
    assert len([name for name in jobs if "scores" in name]) == 2 * (len(VARIANTS) * 5 + 6)
    assert len(set(jobs)) == len(jobs)


def test_runs_differ_from_their_presets_in_what_is_watched_alone():
    plan = SweepPlan()
    run, preset = plan.config("ddpg", 3), run_config("ddpg")
    schedule = run.schedule
    assert (run.seed, schedule.actions) == (3, 8000)
    assert (schedule.held_out_heaps, schedule.validation_heaps) == (50, 0)
    same = {"seed": 0, "validation_heaps": preset.schedule.validation_heaps}
    assert run.changed(**same, held_out_heaps=0, grasp_network="") == preset
    assert plan.config("plus", 0) == run_config("plus").changed(
        held_out_heaps=50, validation_heaps=0
    )


def test_curves_have_graspability_where_the_plan_names_the_variant_and_measures_grasps():
    plan = replace(SweepPlan(), curve_grasps=("ddpg",), grasp_network="mine.npz")
    found = {variant: plan.config(variant, 0).schedule.grasp_network for variant in VARIANTS}
    assert found.pop("ddpg") == "mine.npz"
    assert set(found.values()) == {""}
    assert replace(plan, grasps=False).config("ddpg", 0).schedule.grasp_network == ""
    assert SweepPlan().config("method", 0).schedule.grasp_network == "shipped"


@pytest.mark.parametrize("plan", [SweepPlan(), QUICK])
def test_every_planned_run_can_be_made_longer_point_by_point_of_its_curve(plan):
    for variant in plan.variants:
        config = plan.config(variant, plan.seeds[0])
        assert config.schedule.actions % config.schedule.evaluate_every == 0
        longer = config.changed(actions=config.schedule.actions + plan.curve_every)
        assert longer.changed(actions=config.schedule.actions) == config


def test_what_others_wait_for_comes_first_and_runs_come_seed_by_seed():
    plan = replace(QUICK, references=("idle",))
    chains = chains_of(plan, SweepFolder(None))
    done, tried, waves = set(), set(), []
    while wave := next_wave(chains, done, tried):
        waves.append(names(wave))
        tried |= set(wave)
        done |= set(waves[-1])
    assert waves[0] == ["single/heaps", "dual/heaps"]
    runs = [name.split("-seed")[1] for name in waves[1] if "-seed" in name]
    assert runs == sorted(runs)
    assert len(waves) == 2
    assert set().union(*waves) == set(names(chains))


def test_what_failed_is_not_waited_for_for_ever():
    chains = chains_of(replace(QUICK, references=()), SweepFolder(None))
    tried = set()
    first = next_wave(chains, set(), tried)
    assert names(first) == ["single/heaps", "dual/heaps"]
    assert next_wave(chains, {"single/heaps"}, set(first))
    assert not next_wave(chains, set(), set(first))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"variants": ("best",)}, "unknown variant 'best'; choose one of method, ddpg"),
        ({"curve_grasps": ("best",)}, "unknown variant 'best'; choose one of method, ddpg"),
        ({"conditions": ("triple",)}, "unknown condition 'triple'"),
        ({"references": ("idle", "idle")}, "a reference is named twice"),
        ({"seeds": (1, 1)}, r"seeds are \(1, 1\)"),
        ({"seeds": ()}, "no seed is named"),
        ({"conditions": ()}, "no condition is named"),
        ({"actions": 0}, "actions is 0; expected at least 1"),
    ],
)
def test_bad_plans_are_refused(changes, message):
    with pytest.raises(MechSearchError, match=message):
        replace(SweepPlan(), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"final_heaps": 31}, "final_heaps is 31, but .* has 30 held-out heaps"),
        ({"curve_heaps": 31}, "curve_heaps is 31, but .* has 30 held-out heaps"),
        ({"conditions": ("dual",), "swap": True}, "holds single heaps; expected dual ones"),
        ({"heaps_single": "absent.parquet"}, "no heap set at absent.parquet"),
    ],
)
def test_plans_that_do_not_fit_their_heaps_are_refused(tiny, tmp_path, changes, message):
    if changes.pop("swap", False):
        changes = {**changes, "heaps_dual": tiny.heaps_single}
    with pytest.raises(MechSearchError, match=message):
        open_plan(replace(tiny, **changes), SweepFolder(tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_plan_is_read_as_it_was_written_and_heaps_may_move(tiny, tmp_path):
    folder = SweepFolder(tmp_path)
    open_plan(tiny, folder)
    assert read_plan(folder) == tiny
    copy = tmp_path / ".heaps.parquet"
    with open(tiny.heaps_single, "rb") as file:
        copy.write_bytes(file.read())
    open_plan(replace(tiny, heaps_single=str(copy)), folder)


def test_a_plan_of_an_earlier_version_is_of_the_paper_s_task_without_graspability(tiny, tmp_path):
    folder = SweepFolder(tmp_path)
    plan = replace(tiny, curve_grasps=())
    open_plan(plan, folder)
    found = read_record(folder.plan, "plan of a sweep")
    earlier = {k: v for k, v in found.items() if k not in ("task", "curve_grasps")}
    write_record(folder.plan, "plan of a sweep", earlier)
    assert read_plan(folder) == plan
    assert plan.task == TaskConfig()
    open_plan(plan, folder)


def test_any_algorithm_may_be_a_variant_and_two_of_one_name_may_not():
    own = "mechsearch.push_values.algorithm:PushValues"
    plan = replace(SweepPlan(), variants=("debug", "actor-critic", own))
    found = [plan.config(variant, 0).name for variant in plan.variants]
    assert found == ["debug", "actor-critic", "PushValues"]
    with pytest.raises(MechSearchError, match="a variant is named twice in PushValues, PushV"):
        replace(plan, variants=(own, own))


def test_every_run_is_in_the_plan_s_task_and_so_are_generated_heaps():
    task = TaskConfig(max_actions=20)
    plan = replace(SweepPlan(), task=task)
    assert all(plan.config(variant, 1).task == task for variant in plan.variants)
    tilted = replace(plan, task=TaskConfig(camera="tilted"), variants=("plus",))
    assert tilted.config("plus", 0).task == tilted.task
    assert tilted.generated("dual").camera == "tilted"
    with pytest.raises(MechSearchError, match="needs the overhead camera"):
        replace(tilted, variants=("method",))


def test_the_quick_plan_is_smaller_in_everything():
    paper = SweepPlan()
    for name in ("actions", "curve_heaps", "final_heaps"):
        assert getattr(QUICK, name) < getattr(paper, name)
    assert set(QUICK.variants) < set(paper.variants)
    assert set(QUICK.seeds) < set(paper.seeds)


def test_a_torn_line_of_the_journal_is_left_out(tmp_path):
    journal = Journal(tmp_path / "jobs.jsonl")
    journal.write(BEGAN, job="a")
    with journal.path.open("a") as file:
        file.write('{"event": "began", "jo')
    journal.begin(2)
    journal.write(BEGAN, job="b")
    past = History.of(journal.records())
    assert (list(past.running), past.workers) == (["b"], 2)


def test_the_time_left_follows_the_pace_of_the_finished_jobs(tiny, tmp_path):
    plan = replace(tiny, variants=(), seeds=(), references=("idle", "random", "teacher-spiral"))
    jobs = [job for chain in chains_of(plan, SweepFolder(tmp_path)) for job in chain]
    records = [
        {"event": "sweep", "workers": 2},
        {"event": BEGAN, "job": jobs[0].name},
        {"event": ENDED, "job": jobs[0].name, "seconds": 3600.0},
    ]
    found = status(jobs, {jobs[0].name}, {}, History.of(records))
    assert found.hours_left == pytest.approx(1.0)
    records.append({"event": FAILED, "job": jobs[1].name, "reason": "worker died"})
    found = status(jobs, {jobs[0].name}, {}, History.of(records))
    assert found.hours_left == pytest.approx(0.5)
    assert found.line == "1 of 3 jobs done; 1 failed; about 0.5 hours left"
