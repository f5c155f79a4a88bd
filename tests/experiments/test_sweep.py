import hashlib
import json
import lzma
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pytest

pytest.importorskip("torch")

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.cli import main
from mechsearch.env.heap_env import TaskConfig
from mechsearch.env.reward import RewardConfig
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import METRICS, Evaluation, load_episodes, read_summary
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.jobs import Scoring
from mechsearch.experiments.plan import open_plan, read_plan
from mechsearch.experiments.sweep import (
    BEGAN,
    DONE,
    FAILED,
    RUNNING,
    WAITING,
    Journal,
    carry_out,
    status_of,
)
from mechsearch.files import SCORES_SUFFIX, locked, read_record, write_record
from mechsearch.findings.experiment import read_experiment
from mechsearch.findings.scores import load_scores, save_scores
from mechsearch.processes import map_in_order
from mechsearch.training.config import load_config
from mechsearch.types import MechSearchError

TABLES = ("summary.csv", "curves.csv")


@dataclass(frozen=True)
class Quick(ActorCritic):
    """An algorithm of a user's own."""

    warmup: int = 5


def began(path):
    return Counter(
        r["job"] for r in Journal(SweepFolder(path).journal).records() if r["event"] == BEGAN
    )


def states(status):
    return {s.job.name: s.state for s in status.jobs}


def reasons(status):
    return {s.job.name: s.reason for s in status.jobs if s.state == FAILED}


@pytest.fixture(scope="module")
def whole(tiny, tmp_path_factory):
    """A sweep that was never interrupted."""
    path = tmp_path_factory.mktemp("sweeps") / "whole"
    told = []
    return path, carry_out(tiny, path, tell=told.append)


@pytest.fixture
def copy(whole, tmp_path):
    """That sweep's folder once more, to be tampered with."""
    return SweepFolder(Path(shutil.copytree(whole[0], tmp_path / "sweep")))


@pytest.fixture
def few(tiny):
    """References alone: seconds."""
    return replace(tiny, variants=(), seeds=(), references=("idle", "random"))


def test_every_job_is_done_and_every_result_is_where_the_layout_says(whole, tiny):
    path, status = whole
    assert set(states(status).values()) == {DONE}
    names = {file.relative_to(path / "single").as_posix() for file in path.rglob("*.npz")}
    scored = {name for name in names if name.startswith("evaluations")}
    compact = {name for name in scored if name.endswith(SCORES_SUFFIX)}
    *others, plus = sorted(scored - compact, key=lambda name: "plus" in name)
    assert compact == {name.removesuffix(".npz") + SCORES_SUFFIX for name in scored - compact}
    assert sorted(others) == [
        "evaluations/idle.npz",
        "evaluations/method-seed0-60.npz",
        "evaluations/teacher-straight.npz",
    ]
    assert plus.startswith("evaluations/plus-seed0-")
    assert (path / "single/runs/method-seed0/actor.safetensors").exists()
    assert json.loads((path / "sweep.json").read_text())["actions"] == tiny.actions


def test_the_summary_holds_every_metric_of_every_policy_once(whole):
    rows = read_summary(whole[0] / "summary.csv")
    assert Counter(row.variant for row in rows) == dict.fromkeys(
        ("idle", "method", "plus", "teacher-straight"), len(METRICS)
    )
    assert {row.experiment for row in rows} == {"tiny"}


def test_curves_begin_with_the_untrained_actor_and_have_intervals_over_heaps(whole):
    head, *lines = (whole[0] / "curves.csv").read_text().splitlines()
    assert head == "condition,variant,seed,step,metric,mean,ci_low,ci_high,heaps"
    cells = [line.split(",") for line in lines]
    rewards = [c for c in cells if c[1] == "method" and c[4] == "reward"]
    assert [int(c[3]) for c in rewards] == [0, 20, 40, 60]
    assert [int(c[3]) for c in cells if c[1] == "plus" and c[4] == "reward"] == [0, 20, 40, 60]
    assert all(float(c[6]) <= float(c[5]) <= float(c[7]) for c in rewards)
    assert {c[8] for c in cells} == {"2"}
    assert {c[1] for c in cells} == {"method", "plus"}


def test_what_is_finished_is_not_repeated(whole, tiny):
    path, _ = whole
    before = began(path)
    results = [f for f in path.rglob("*") if f.suffix in (".npz", ".safetensors")]
    times = [file.stat().st_mtime_ns for file in results]
    tables = [(path / name).read_bytes() for name in TABLES]
    assert set(states(carry_out(tiny, path)).values()) == {DONE}
    assert began(path) == before == dict.fromkeys(before, 1)
    assert [file.stat().st_mtime_ns for file in results] == times
    assert [(path / name).read_bytes() for name in TABLES] == tables


def test_an_actor_may_be_gone_once_it_is_scored_and_not_before(whole, copy, tiny):
    (copy.run("single", "method-seed0") / "actor.safetensors").unlink()
    tables = [(whole[0] / name).read_bytes() for name in TABLES]
    assert set(states(carry_out(tiny, copy.path)).values()) == {DONE}
    assert [(copy.path / name).read_bytes() for name in TABLES] == tables
    assert began(copy.path) == began(whole[0])
    for scores in copy.evaluations("single").glob("method-*.npz"):
        scores.unlink()
    found = carry_out(tiny, copy.path)
    assert (
        "actor.safetensors is not what the run ended with" in reasons(found)["single/method-seed0"]
    )


def removed(folder, *what):
    """Remove the episodes of the evaluations of some names, and the actors of runs among them."""
    gone = [folder.evaluations("single") / f"{name}.npz" for name in what]
    gone += [folder.run("single", name) / "actor.safetensors" for name in what]
    gone = [file for file in gone if file.exists()]
    for file in gone:
        file.unlink()
    return gone


def test_scores_alone_count_as_done_and_change_nothing(whole, copy, tiny):
    gone = removed(copy, "idle", "method-seed0-60", "method-seed0")
    assert len(gone) == 3
    assert status_of(copy).line == "6 of 6 jobs done"
    tables = [(whole[0] / name).read_bytes() for name in TABLES]
    assert set(states(carry_out(tiny, copy.path)).values()) == {DONE}
    assert [(copy.path / name).read_bytes() for name in TABLES] == tables
    assert began(copy.path) == began(whole[0])
    assert not any(file.exists() for file in gone)


def test_what_was_removed_is_made_again_when_its_job_is_named(whole, copy, tiny):
    gone = removed(copy, "idle", "teacher-straight", "method-seed0-60", "method-seed0")
    again = ["single/scores of idle", "single/scores of method-seed0"]
    assert set(states(carry_out(tiny, copy.path, only=again)).values()) == {DONE}
    for name in ("single/evaluations/idle.npz", "single/runs/method-seed0/actor.safetensors"):
        assert (copy.path / name).read_bytes() == (whole[0] / name).read_bytes(), name
    made, was = (
        load_episodes(path / "single/evaluations/method-seed0-60.npz").episodes
        for path in (copy.path, whole[0])
    )
    assert all((a.poses == b.poses).all() for a, b in zip(made, was, strict=True))
    assert [file.stem for file in gone if not file.exists()] == ["teacher-straight"]
    times = began(copy.path)
    assert times - began(whole[0]) == Counter(again)
    # What is there is not made once more.
    carry_out(tiny, copy.path, only=["single/method-seed0", *again])
    assert began(copy.path) == times


def test_compact_scores_of_another_plan_or_actor_are_refused(copy):
    small = copy.evaluations("single") / "idle.scores.npz"
    removed(copy, "idle", "method-seed0-60")
    scored = load_scores(small)
    save_scores(small, replace(scored, header={**scored.header, "heaps": 4}))
    small = copy.evaluations("single") / "method-seed0-60.scores.npz"
    scored = load_scores(small)
    save_scores(small, replace(scored, header={**scored.header, "actor": "another"}))
    found = reasons(status_of(copy))
    assert "idle.scores.npz is not of this sweep: its heaps is 4" in found["single/scores of idle"]
    assert "its actor is 'another'" in found["single/scores of method-seed0"]


def test_a_packed_log_is_the_log(whole, copy, tiny):
    run = copy.run("single", "plus-seed0")
    log = run / "metrics.jsonl"
    packed = run / "metrics.jsonl.xz"
    packed.write_bytes(lzma.compress(log.read_bytes()))
    log.unlink()
    assert set(states(carry_out(tiny, copy.path)).values()) == {DONE}
    assert (copy.path / "curves.csv").read_bytes() == (whole[0] / "curves.csv").read_bytes()
    packed.write_bytes(packed.read_bytes()[:-9])
    assert "metrics.jsonl.xz is damaged" in str(reasons(status_of(copy)))


def test_episodes_in_another_task_are_refused(few, tmp_path):
    carry_out(few, tmp_path / "short")
    task = TaskConfig(max_actions=3, reward=RewardConfig(idleness=1.0))
    plan = replace(few, task=task)
    assert set(states(carry_out(plan, tmp_path / "other")).values()) == {DONE}
    assert read_plan(SweepFolder(tmp_path / "other")).task == task
    header = load_episodes(tmp_path / "other/single/evaluations/idle.npz").header
    assert (header["env"]["max_actions"], header["env"]["reward"]["idleness"]) == (3, 1.0)
    with pytest.raises(MechSearchError, match=r"another plan: task.max_actions was 50 and is 3"):
        carry_out(plan, tmp_path / "short")
    for folder in ("short", "other"):
        (tmp_path / folder / "single/evaluations/idle.scores.npz").unlink()
    os.replace(
        tmp_path / "other/single/evaluations/idle.npz",
        tmp_path / "short/single/evaluations/idle.npz",
    )
    found = reasons(status_of(SweepFolder(tmp_path / "short")))["single/scores of idle"]
    assert "its task is another, max_actions 50 -> 3" in found


def test_options_of_the_command_are_the_plan_s_and_the_task_s(tiny, tmp_path, capsys):
    words = ["sweep", "--out", str(tmp_path / "s"), "--heaps-single", tiny.heaps_single]
    words += ["--conditions", "single", "--variants", "--references", "idle", "--final-heaps", "2"]
    words += ["--curve-heaps", "2", "--grasps", "False", "--workers", "1"]
    main([*words, "--reward.movement", "80", "--max-actions", "4"])
    said = capsys.readouterr().out
    assert "max_actions 50 -> 4, reward.movement 75 -> 80" in said
    plan = read_plan(SweepFolder(tmp_path / "s"))
    assert plan.task == TaskConfig(max_actions=4, reward=RewardConfig(movement=80.0))
    assert (plan.variants, plan.final_heaps, plan.grasps) == ((), 2, False)
    # What is not said is as it was.
    main(["sweep", "--out", str(tmp_path / "s"), "--workers", "1"])
    assert read_plan(SweepFolder(tmp_path / "s")) == plan


def test_an_algorithm_of_a_user_is_trained_and_scored_like_the_others(tiny, tmp_path):
    spec = f"{Quick.__module__}:Quick"
    plan = replace(
        tiny, variants=(spec,), references=(), actions=20, task=TaskConfig(max_actions=9)
    )
    assert set(states(carry_out(plan, tmp_path)).values()) == {DONE}
    assert (tmp_path / "single/evaluations/Quick-seed0-20.scores.npz").exists()
    config = load_config(tmp_path / "single/runs/Quick-seed0/config.json")
    assert (config.name, config.task) == ("Quick", plan.task)
    assert "single,Quick,0,20," in (tmp_path / "curves.csv").read_text()
    assert not read_experiment(tmp_path).missing


def test_scores_of_another_actor_than_the_run_ended_with_are_refused(copy):
    run = copy.run("single", "method-seed0")
    scores = copy.evaluations("single") / "method-seed0-60.npz"
    (run / "actor.safetensors").write_bytes(b"made anew")
    finished = read_record(run / "finished.json", "record of a finished run")
    was = finished["actor"]
    finished["actor"] = hashlib.sha256(b"made anew").hexdigest()
    kept = {k: finished[k] for k in ("actor", "metrics", "training_actions")}
    write_record(run / "finished.json", "record of a finished run", kept)
    assert load_episodes(scores).header["actor"] == was
    told = reasons(status_of(copy))
    assert told.keys() == {"single/scores of method-seed0"}
    assert f"its actor is '{was}'; expected '{kept['actor']}'; move it away" in str(told)


def test_scores_of_a_run_that_is_not_over_wait_for_its_actor(whole, copy, tiny):
    (copy.run("single", "method-seed0") / "finished.json").unlink()
    found = states(status_of(copy))
    assert {name for name in found if found[name] == WAITING} == {
        "single/method-seed0",
        "single/scores of method-seed0",
    }
    assert set(states(carry_out(tiny, copy.path)).values()) == {DONE}
    # The run ended with the actor that they are of.
    assert began(copy.path)["single/scores of method-seed0"] == 1
    for name in TABLES:
        assert (copy.path / name).read_bytes() == (whole[0] / name).read_bytes(), name


def test_what_a_kill_kept_from_the_tables_is_entered_later(whole, tiny):
    path, _ = whole
    tables = [(path / name).read_bytes() for name in TABLES]
    for name in TABLES:
        (path / name).unlink()
    carry_out(tiny, path)
    assert [(path / name).read_bytes() for name in TABLES] == tables


KILLED = """
import json, sys
from pathlib import Path
from mechsearch.experiments.sweep import carry_out
from mechsearch.experiments.plan import SweepPlan
from mechsearch.files import record_from_json
if __name__ == "__main__":
    plan = record_from_json(SweepPlan, json.loads(sys.argv[1]))
    carry_out(plan, Path(sys.argv[2]))
"""


def test_a_killed_sweep_goes_on_and_gives_the_same_bytes(whole, tiny, tmp_path):
    script, path = tmp_path / "killed.py", tmp_path / "killed"
    script.write_text(KILLED)
    words = [sys.executable, str(script), json.dumps(asdict(tiny)), str(path)]
    process = subprocess.Popen(words)
    deadline = time.monotonic() + 200
    try:
        while not list(path.glob("single/runs/method-seed0/checkpoints/step-*.safetensors")):
            assert process.poll() is None, "the sweep ended before it was killed"
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert not (path / "single/evaluations/method-seed0-60.npz").exists()
    # The lock has died with its holder.
    status = carry_out(tiny, path)
    assert set(states(status).values()) == {DONE}
    for name in TABLES:
        assert (path / name).read_bytes() == (whole[0] / name).read_bytes(), name
    for run in ("method-seed0", "plus-seed0"):
        for name in ("metrics.jsonl", "actor.safetensors"):
            file = Path("single/runs") / run / name
            assert (path / file).read_bytes() == (whole[0] / file).read_bytes(), file


def test_another_plan_on_the_same_folder_is_refused_and_told_apart(few, tmp_path):
    carry_out(few, tmp_path / "sweep")
    before = (tmp_path / "sweep/sweep.json").read_bytes()
    with pytest.raises(MechSearchError, match=r"another plan: final_heaps was 3 and is 4"):
        carry_out(replace(few, final_heaps=4), tmp_path / "sweep")
    assert (tmp_path / "sweep/sweep.json").read_bytes() == before


def test_a_folder_of_something_else_is_refused(few, tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(MechSearchError, match=r"holds thesis.tex and no sweep.json"):
        carry_out(few, tmp_path)


def test_a_second_sweep_on_a_folder_is_refused_while_the_first_is_at_work(few, tmp_path):
    with locked(SweepFolder(tmp_path).lock), pytest.raises(MechSearchError, match="another sweep"):
        carry_out(few, tmp_path)
    assert set(states(carry_out(few, tmp_path)).values()) == {DONE}


def test_a_foreign_run_directory_is_named_and_the_others_go_on(tiny, tmp_path, capsys):
    plan, sweep = replace(tiny, variants=("method",), references=("idle",)), tmp_path / "sweep"
    carry_out(replace(plan, actions=61), tmp_path / "longer")
    planned(plan, sweep)
    (sweep / "single/runs").mkdir(parents=True)
    run = Path("single/runs/method-seed0")
    os.rename(tmp_path / "longer" / run, sweep / run)
    status = carry_out(plan, sweep)
    assert "a run of another configuration" in reasons(status)["single/method-seed0"]
    assert states(status)["single/scores of method-seed0"] == WAITING
    assert states(status)["single/scores of idle"] == DONE
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", "--out", str(sweep), "--workers", "1"])
    assert stopped.value.code == 1
    said = capsys.readouterr().out
    assert "failed: single/method-seed0: " in said
    assert "waiting: single/scores of method-seed0: needs single/method-seed0" in said
    assert (sweep / "curves.csv").read_text().count("\n") == 1


def planned(plan, path):
    """Write the plan, and do nothing of it."""
    path.mkdir(exist_ok=True)
    open_plan(plan, SweepFolder(path))


def test_a_run_directory_without_its_configuration_is_refused(tiny, tmp_path):
    plan = replace(tiny, variants=("method",), references=())
    planned(plan, tmp_path)
    run = tmp_path / "single/runs/method-seed0"
    run.mkdir(parents=True)
    (run / "actor.safetensors").write_bytes(b"?")
    status = carry_out(plan, tmp_path)
    assert "holds actor.safetensors and no config.json" in reasons(status)["single/method-seed0"]


def test_damaged_and_foreign_episodes_are_named_and_enter_no_table(few, tmp_path):
    carry_out(few, tmp_path)
    place = tmp_path / "single/evaluations"
    damaged = bytearray((place / "idle.npz").read_bytes())
    damaged[len(damaged) // 2] ^= 4
    (place / "idle.npz").write_bytes(bytes(damaged))
    other = load_episodes(place / "random.npz")
    episodes.save_episodes(
        place / "random.npz", Evaluation({**other.header, "heaps": 2}, other.episodes)
    )
    (tmp_path / "summary.csv").unlink()
    found = reasons(carry_out(few, tmp_path))
    assert "damaged" in found["single/scores of idle"]
    assert "its heaps is 2; expected 3" in found["single/scores of random"]
    assert not (tmp_path / "summary.csv").exists()


def test_a_job_that_raises_twice_is_reported_with_its_reason(few, tmp_path, monkeypatch):
    tries = []

    def carry_out_job(self):
        tries.append(self.name)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Scoring, "carry_out", carry_out_job)
    status = carry_out(few, tmp_path)
    assert Counter(tries) == {"single/scores of idle": 2, "single/scores of random": 2}
    assert all("No space left on device" in reason for reason in reasons(status).values())
    monkeypatch.undo()
    assert set(states(carry_out(few, tmp_path)).values()) == {DONE}


def test_a_full_disk_stops_the_sweep_with_a_clear_error(few, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mechsearch.experiments.sweep.append_line", full)
    with pytest.raises(MechSearchError, match=r"has stopped: .*No space left.*goes on from here"):
        carry_out(few, tmp_path)
    monkeypatch.undo()
    assert set(states(carry_out(few, tmp_path)).values()) == {DONE}


@dataclass(frozen=True)
class DeadlyGrasp:
    """Kills its process, as a lack of memory would, the first time or always."""

    folder: Path
    always: bool = False

    def __call__(self, evaluation):
        mark = self.folder / f"{evaluation.header['name']}.killed"
        if self.always or not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Evaluation({**evaluation.header, "grasp_network": "none"}, evaluation.episodes)


def test_a_killed_worker_costs_the_repetition_of_its_job(few, tmp_path):
    plan = replace(few, references=("idle",), grasps=True)
    deadly = DeadlyGrasp(tmp_path)
    status = carry_out(plan, tmp_path / "sweep", 2, map_in_order, deadly)
    assert states(status) == {"single/scores of idle": DONE}
    assert began(tmp_path / "sweep")["single/scores of idle"] == 2


def test_a_job_that_kills_two_workers_is_reported(few, tmp_path):
    plan = replace(few, references=("idle",), grasps=True)
    deadly = DeadlyGrasp(tmp_path, always=True)
    status = carry_out(plan, tmp_path / "sweep", 2, map_in_order, deadly)
    assert reasons(status) == {"single/scores of idle": "worker died"}


def test_the_status_tells_what_is_done_running_and_waiting(few, tmp_path, capsys):
    plan = replace(few, references=("idle", "random", "teacher-spiral"))
    planned(plan, tmp_path)
    journal = Journal(SweepFolder(tmp_path).journal)
    with locked(SweepFolder(tmp_path).lock):
        journal.begin(1)
        journal.write(BEGAN, job="single/scores of random")
        assert states(status_of(SweepFolder(tmp_path))) == {
            "single/scores of idle": WAITING,
            "single/scores of random": RUNNING,
            "single/scores of teacher-spiral": WAITING,
        }
    # Nobody holds the lock: whoever was at it is gone.
    assert set(states(status_of(SweepFolder(tmp_path))).values()) == {WAITING}
    main(["sweep", "--out", str(tmp_path), "--status"])
    assert "0 of 3 jobs done" in capsys.readouterr().out
    carry_out(plan, tmp_path)
    assert status_of(SweepFolder(tmp_path)).line == "3 of 3 jobs done"


def test_a_part_can_be_done_first_and_the_rest_later(few, tmp_path):
    part = carry_out(few, tmp_path, only=["*/scores of r*"])
    assert states(part) == {"single/scores of random": DONE}
    assert status_of(SweepFolder(tmp_path)).line.startswith("1 of 2 jobs done")
    carry_out(few, tmp_path)
    assert began(tmp_path) == {"single/scores of random": 1, "single/scores of idle": 1}


def test_the_scores_of_a_run_that_is_not_there_wait(tiny, tmp_path):
    plan = replace(tiny, references=(), variants=("method",))
    found = carry_out(plan, tmp_path, only=["*scores of method*"])
    assert states(found) == {"single/scores of method-seed0": WAITING}
    assert found.jobs[0].reason == "needs single/method-seed0"


def test_the_scores_of_a_run_that_was_made_before_do_not_wait(tiny, tmp_path):
    plan = replace(tiny, references=(), variants=("method",))
    carry_out(plan, tmp_path, only=["single/method-seed0"])
    found = carry_out(plan, tmp_path, only=["*scores of method*"])
    assert states(found) == {"single/scores of method-seed0": DONE}
    assert began(tmp_path) == {"single/method-seed0": 1, "single/scores of method-seed0": 1}


def test_a_part_that_no_job_is_of_is_refused(few, tmp_path):
    with pytest.raises(MechSearchError, match=r"'dual/\*'.*single/scores of random"):
        carry_out(few, tmp_path, only=["dual/*"])


def test_the_status_of_no_sweep_is_an_error(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", "--out", str(tmp_path / "absent"), "--status"])
    assert stopped.value.code == 2
    assert "no plan of a sweep at" in capsys.readouterr().err
    assert not (tmp_path / "absent").exists()
