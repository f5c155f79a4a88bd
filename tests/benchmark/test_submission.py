import csv
import json
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest

from mechsearch.benchmark import submission as submissions
from mechsearch.benchmark.environment import fixed_task, make_benchmark_env
from mechsearch.benchmark.protocol import (
    BENCHMARK_SPLITS,
    BENCHMARK_TASKS,
    UNSEEN,
    Split,
    environment_ids,
)
from mechsearch.cli import main
from mechsearch.env import Decision
from mechsearch.evaluation.episodes import save_episodes
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan
from mechsearch.geometry import yaw_quaternion
from mechsearch.heaps.dataset import embedded_file, load_heaps
from mechsearch.types import MechSearchError

ROOT = Path(__file__).parents[2]
FOLDER = embedded_file("single").parent
TOLD = {
    "name": "straight", "authors": "A. Tester", "privileged": False, "executed_actions": 0,
    "tried_actions": 0, "training_heaps": (), "training_objects": (), "weights": "",
}  # fmt: skip
SMALL = {"tiny", "blurred", "other"}


@pytest.fixture(scope="module", autouse=True)
def splits():
    """Three household heaps, and three others: an entry each in the table, and nothing more."""
    sets = [load_heaps(embedded_file(name)) for name in ("single", "dual")]
    tiny = Split(embedded_file("single").name, sets[0].hash, "held-out", 3, "household heaps")
    found = {
        "tiny": tiny,
        "blurred": replace(tiny, sensor="stereo", segmenter="shipped"),
        "other": Split(embedded_file("dual").name, sets[1].hash, "held-out", 3, "household heaps"),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, split in found.items():
            patch.setitem(BENCHMARK_SPLITS, name, split)
        yield found


def recorded(split: str = "tiny", **settings):
    plan = EvaluationPlan(
        "teacher-straight", FOLDER / BENCHMARK_SPLITS[split].file, limit=3,
        task=replace(fixed_task("uncover", "single", "overhead"), **settings),
    )  # fmt: skip
    return evaluate_plan(plan)


@pytest.fixture(scope="module")
def straight():
    return submissions.submission_of(recorded(), "uncover", "tiny", TOLD, "overhead")


def forged(submission, card=None, **first):
    """Return a submission with another card, or with something else in its first episode."""
    claim = replace(submission.claims[0], **first)
    return submissions.Submission(
        replace(submission.card, **(card or {})), (claim, *submission.claims[1:]), {}
    )


def test_a_submission_is_read_back_and_played_again_and_entered_once(straight, tmp_path):
    submissions.save_submission(tmp_path / "a.npz", straight)
    read = submissions.load_submission(tmp_path / "a.npz")
    assert read.card == straight.card
    for one, other in zip(read.claims, straight.claims, strict=True):
        assert one.actions.tobytes() == other.actions.tobytes()
        assert one.scores == pytest.approx(other.scores, rel=1e-7)
    results = tmp_path / "results"
    with pytest.raises(MechSearchError, match="was not played again"):
        submissions.enter(read, results)
    main(["benchmark", "submit", str(tmp_path / "a.npz"), "--heaps", str(FOLDER),
          "--results", str(results), "--workers", "1"])  # fmt: skip
    (entered,) = submissions.entered(results)
    assert entered.replay["differing"] == 0
    assert [c.end for c in entered.claims] == [c.end for c in straight.claims]
    with pytest.raises(MechSearchError, match="is a submission already"):
        submissions.enter(entered, results)
    page = submissions.page([entered])
    assert "## `uncover`, `tiny`" in page
    mean = np.mean([claim.scores["reward"] for claim in straight.claims])
    assert f"| straight | A. Tester | {'ee position'}" in page
    assert f"{mean:.1f} (".replace("-", "\N{MINUS SIGN}") in page


def test_what_its_actions_do_not_give_is_refused_by_name(straight):
    first = straight.claims[0]
    other = {"lost": "uncovered", "uncovered": "lost"}.get(first.end, "uncovered")
    scores = dict(first.scores)
    forgeries = [
        ({"scores": {**scores, "reward": scores["reward"] + 0.01}}, "reward .* claimed, .* found"),
        ({"end": other}, f"end '{other}' claimed, '{first.end}' found"),
        ({"scores": {**scores, "uncovered_rate": 1 - scores["uncovered_rate"]}}, "uncovered_rate"),
        ({"scores": {k: v for k, v in scores.items() if k != "reward"}}, "reward nan claimed"),
        ({"actions": first.actions[:-1]}, "goes on after the last recorded action"),
        ({"actions": np.concatenate([first.actions, first.actions[:1]])}, "it is over after"),
        ({"actions": straight.claims[1].actions}, "claimed|goes on|over after"),
        ({"actions": first.actions + np.float32(1.5)}, r"an action of .*expected .*\[-1, 1\]"),
        ({"actions": first.actions * np.float32(np.nan)}, "an action of nan"),
    ]  # fmt: skip
    for change, words in forgeries:
        with pytest.raises(MechSearchError, match=words) as refused:
            submissions.verified(forged(straight, **change), FOLDER)
        assert str(first.heap_seed) in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_split_that_is_seen_otherwise_takes_what_was_seen_so():
    seen = {"sensor": "stereo", "segmenter": "shipped"}
    with pytest.raises(MechSearchError, match=r"acted in another task: .*sensor") as refused:
        submissions.submission_of(recorded(), "uncover", "blurred", TOLD, "overhead")
    assert "segmenter" in str(refused.value)
    with pytest.raises(MechSearchError, match="acted in another task"):
        submissions.submission_of(recorded(**seen), "uncover", "tiny", TOLD, "overhead")
    made = submissions.submission_of(recorded(**seen), "uncover", "blurred", TOLD, "overhead")
    assert submissions.verified(made, FOLDER).replay["differing"] == 0
    env = make_benchmark_env("uncover", "blurred", FOLDER)
    assert (env.config.sensor, env.config.segmenter) == ("stereo", "shipped")
    assert make_benchmark_env("retrieve", "blurred", FOLDER).config.sensor == "stereo"


def test_every_heap_of_the_split_has_one_episode(straight):
    first, *rest = straight.claims
    foreign = replace(first, heap_seed=1)
    cases = [
        (rest, f"heap {first.heap_seed} has no episode"),
        ([foreign, *rest], "heap 1 is not one of the split tiny"),
        ([first, first, *rest], f"heap {first.heap_seed} has more than one episode"),
    ]
    for claims, words in cases:
        with pytest.raises(MechSearchError, match=words):
            submissions.verified(submissions.Submission(straight.card, tuple(claims), {}), FOLDER)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"task": "juggle"}, "unknown task 'juggle'; choose one of uncover, retrieve"),
        ({"split": "huge"}, "unknown split 'huge'; choose one of single"),
        ({"task_version": 99}, "version 99 of the task uncover; this is version 1"),
        ({"heap_set": "0" * 64}, "on the heap set 000000000000; the split tiny is"),
        ({"split": "other"}, "the split other is the heap set"),
        ({"name": "../away"}, "name is '../away'; expected letters"),
        ({"authors": " "}, "names no authors"),
    ],
)
def test_a_card_of_something_else_is_refused(straight, change, words):
    with pytest.raises(MechSearchError, match=words):
        replace(straight.card, **change)


def test_a_card_without_a_field_and_a_damaged_file_are_refused(straight, tmp_path):
    path = tmp_path / "a.npz"
    submissions.save_submission(path, straight)
    with np.load(path) as file:
        arrays = dict(file)
    text = json.loads(arrays["text"].tobytes())
    del text["card"]["privileged"], text["card"]["weights"]
    arrays["text"] = np.frombuffer(json.dumps(text).encode(), np.uint8)
    np.savez(tmp_path / "b.npz", **arrays)
    with pytest.raises(MechSearchError, match="lacks privileged, weights"):
        submissions.load_submission(tmp_path / "b.npz")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(MechSearchError, match="damaged or no submission"):
        submissions.load_submission(path)


def test_nothing_is_entered_where_one_of_two_is_taken(straight, tmp_path, capsys):
    files = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path, name in zip(files, ("taken", "new"), strict=True):
        submissions.save_submission(path, forged(straight, {"name": name}))
    taken = tmp_path / "results" / "uncover" / "tiny" / "taken.npz"
    taken.parent.mkdir(parents=True)
    taken.write_bytes(b"something")
    with pytest.raises(SystemExit):
        main(["benchmark", "submit", str(files[1]), str(files[0]), "--heaps", str(FOLDER),
              "--results", str(tmp_path / "results"), "--workers", "1"])  # fmt: skip
    assert "taken.npz is a submission already" in capsys.readouterr().err
    assert [path.name for path in taken.parent.iterdir()] == ["taken.npz"]


def test_episodes_of_another_task_are_no_submission():
    harder = recorded(max_actions=5)
    with pytest.raises(MechSearchError, match="acted in another task: max_actions 50 -> 5"):
        submissions.submission_of(harder, "uncover", "tiny", TOLD, "overhead")
    elsewhere = {**harder.header["env"], "max_actions": 50, "engine": "bullet"}
    other = replace(harder, header={**harder.header, "env": elsewhere})
    with pytest.raises(MechSearchError, match="another task: engine mujoco -> bullet"):
        submissions.submission_of(other, "uncover", "tiny", TOLD, "overhead")
    with pytest.raises(MechSearchError, match="another task than retrieve"):
        submissions.submission_of(harder, "retrieve", "tiny", TOLD, "overhead")


def test_elsewhere_some_may_differ_and_then_the_replay_counts(straight):
    """One of three differs: more than a tenth. Of the same ones, none is left to differ."""
    elsewhere = {"fingerprint": {**straight.card.fingerprint, "vector units": "none"}}
    short = {"actions": straight.claims[0].actions[:-1]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(submissions, "DIFFERING", 0.34)
        found = submissions.verified(forged(straight, elsewhere, **short), FOLDER)
        with pytest.raises(MechSearchError, match="goes on after"):
            submissions.verified(forged(straight, **short), FOLDER)
    assert found.replay["differing"] in (0, 1)
    assert found.claims[0].actions.shape[1] == 3
    wrong = {"end": "lost", "scores": {**straight.claims[0].scores, "reward": 9.0}}
    with pytest.raises(MechSearchError, match=r"1 of 3 .*0 may differ, .*instead of none"):
        submissions.verified(forged(straight, elsewhere, **wrong), FOLDER)


def test_who_has_seen_the_unseen_objects_is_refused_by_their_names(straight):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(
            BENCHMARK_SPLITS, "tiny", replace(BENCHMARK_SPLITS["tiny"], unseen=("mug", "bowl"))
        )
        with pytest.raises(MechSearchError, match="training heaps held bowl; docs"):
            replace(straight.card, training_objects=("bowl", "plate"))


def test_the_unseen_objects_follow_their_rule():
    """Of each published category the second of the usable objects and every fourth after it."""
    manifest = json.loads(
        pq.read_schema(ROOT / "results/heaps/ycb_single.parquet").metadata[b"mechsearch"]
    )
    with (ROOT / "src/mechsearch/objects/ycb/masses.csv").open() as file:
        categories = {row["object"]: row["category"] for row in csv.DictReader(file)}
    usable = sorted(manifest["object_hashes"])
    groups = {c: [n for n in usable if categories[n] == c] for c in {*categories.values()}}
    assert sorted(UNSEEN) == sorted(n for names in groups.values() for n in names[1::4])
    assert len(UNSEEN) == 13
    assert all(set(names) - set(UNSEEN) for names in groups.values() if names)


def test_every_split_of_the_repository_is_the_heap_set_that_its_entry_names():
    for name in set(BENCHMARK_SPLITS) - SMALL:
        split = BENCHMARK_SPLITS[name]
        metadata = pq.read_schema(ROOT / "results/heaps" / split.file).metadata
        assert metadata[b"sha256"].decode() == split.heap_set
        used = json.loads(metadata[b"mechsearch"])["object_hashes"]
        assert not split.unseen or set(used) == set(split.unseen)


FIXED = {
    "max_actions": 50, "uncovered_at": 0.02, "start_distance": 0.2, "camera": "overhead",
    "max_grasps": 8, "max_removals": 8, "perturbed": False, "grippers": ("jaws-85",),
    "retrieval": {"retrieved": 1.0, "action": 0.01, "movement": 1.0},
    "physics": {
        "action_steps": 30, "clearance": 0.005, "contact_impedance": (0.95, 0.99),
        "contact_time": 0.01, "deep_penetration": 0.015, "explosion_speed": 8.0, "rest_steps": 14,
        "sleep_speed": 0.003, "solver_iterations": 30, "still_speed": 0.003, "still_spin": 0.05,
        "stops_when_still": True, "time_step": 0.005,
    },
    "pusher": {
        "force": 25.0, "friction": 0.5, "length": 0.2, "mass": 0.3, "radius": 0.012,
        "stiffness": 2000.0,
    },
    "reward": {
        "gain_that_excuses": 0.05, "idle_when": "every action", "idleness": 0.5, "movement": 75.0,
        "still": 0.001, "uncovering": 2.5, "workspace": 0.5,
    },
    "workspace": {"floor": -0.75, "half": 0.3, "high": 0.25, "low": 0.01, "table_half": 0.4},
}  # fmt: skip


def test_a_task_that_changes_gets_a_new_version():
    """Whoever changes one of these must raise the version of the tasks that it concerns."""
    for name, number in (("uncover", 1), ("retrieve", 1)):
        now = asdict(fixed_task(name, "single", "overhead"))
        known = {key: value for key, value in FIXED.items() if key in now}
        same = {
            key: {part: now[key][part] for part in value} if isinstance(value, dict) else now[key]
            for key, value in known.items()
        }
        assert (BENCHMARK_TASKS[name].version, same) == (number, known)


def test_the_registered_ids_make_the_heaps_of_their_split(monkeypatch):
    assert set(environment_ids()) >= {"mechsearch/BenchmarkUncoverSingle-v1"}
    assert set(environment_ids()) - set(gymnasium.registry) == {
        name for name, made in environment_ids().items() if made["split"] in SMALL
    }
    env = make_benchmark_env("uncover", "tiny", FOLDER)
    chosen = load_heaps(embedded_file("single")).choose("held-out", 3)
    heaps = load_heaps(embedded_file("single")).heaps
    assert [h.seed for h in env.heaps] == [heaps[i].seed for i in chosen]
    env = make_benchmark_env("retrieve", "tiny", FOLDER, grippers=("jaws-56",))
    assert env.config.grippers == ("jaws-56",)
    monkeypatch.setitem(
        BENCHMARK_SPLITS, "tiny", replace(BENCHMARK_SPLITS["tiny"], heap_set="0" * 64)
    )
    with pytest.raises(MechSearchError, match="the split tiny is the heap set"):
        make_benchmark_env("uncover", "tiny", FOLDER)


def test_the_committed_table_is_what_the_committed_submissions_give():
    found = list(submissions.entered(ROOT / "results" / "benchmark"))
    assert found
    assert (ROOT / "docs" / "benchmark-table.md").read_text() == submissions.page(found)


@pytest.mark.parametrize(
    ("policy", "change", "words"),
    [
        ("idle", {"task": "retrieve"}, "idle .* name the heap sets by --training-heaps"),
        ("uncover", {}, "uncover has learnt, .* --training-heaps"),
        ("idle", {"authors": ""}, "idle names no authors"),
        ("nobody", {}, "unknown policy 'nobody'"),
    ],
)
def test_who_cannot_enter_is_told_before_anything_is_played(policy, change, words, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setattr(submissions, "evaluate_plan", None)
    entrant = submissions.Entrant(**({"task": "uncover", "split": "tiny", "authors": "A"} | change))
    with pytest.raises(MechSearchError, match=words):
        submissions.act(policy, entrant, FOLDER)


def test_a_policy_of_another_goal_is_told_so(monkeypatch):
    monkeypatch.setattr(submissions, "evaluate_plan", None)
    entrant = submissions.Entrant("retrieve", "tiny", "A", training_heaps=(embedded_file("dual"),))
    with pytest.raises(MechSearchError, match="idle uncovers; expected a policy for the task retr"):
        submissions.act("idle", entrant, FOLDER)


def test_a_policy_that_runs_is_what_it_recorded_elsewhere(straight, tmp_path):
    entrant = submissions.Entrant("uncover", "tiny", "A. Tester", name="straight")
    acted = submissions.act("teacher-straight", entrant, FOLDER)
    assert acted.card == straight.card
    assert [c.scores for c in acted.claims] == [c.scores for c in straight.claims]
    save_episodes(tmp_path / "few.npz", replace(few := recorded(), episodes=few.episodes[:2]))
    with pytest.raises(
        MechSearchError, match="has no episode in the split tiny; expected one episode"
    ):
        submissions.act(str(tmp_path / "few.npz"), entrant, FOLDER)


def test_the_commands_list_run_and_table(tmp_path, capsys):
    main(["benchmark", "list", "--heaps", str(FOLDER)])
    said = capsys.readouterr().out
    for name, split in BENCHMARK_SPLITS.items():
        line = next(line for line in said.splitlines() if line.startswith(f"{name} "))
        assert split.heap_set[:12] in line
        assert line.endswith("yes" if name in SMALL else "no")
    made, results, out = tmp_path / "idle.npz", tmp_path / "results", tmp_path / "table.md"
    main(["benchmark", "run", "idle", "--task", "uncover", "--split", "tiny", "--authors", "A",
          "--heaps", str(FOLDER), "--out", str(made), "--workers", "1"])  # fmt: skip
    main(["benchmark", "submit", str(made), "--heaps", str(FOLDER), "--results", str(results),
          "--workers", "1"])  # fmt: skip
    main(["benchmark", "table", "--results", str(results), "--out", str(out)])
    # Fifty actions of half a point each, on every heap.
    assert (
        "| idle | A | ee position | none | not available | \N{MINUS SIGN}25.0 (" in out.read_text()
    )
    stray = results / "retrieve" / "tiny" / "idle.npz"
    stray.parent.mkdir(parents=True)
    stray.write_bytes((results / "uncover" / "tiny" / "idle.npz").read_bytes())
    with pytest.raises(MechSearchError, match="it belongs in"):
        list(submissions.entered(results))


class GraspsTheMiddle:
    """Grasps from above, at the middle of the table, again and again."""

    goal, keys = "retrieve", ("ee_position",)

    def reset(self, rng):
        self._rng = rng

    def act(self, obs):
        turn = yaw_quaternion(self._rng.uniform(0, np.pi))
        return Decision.grasp([*self._rng.uniform(-0.05, 0.05, 2), 0.03, *turn]).vector()


def test_lifts_are_played_again_and_one_that_was_not_is_refused(splits, tmp_path):
    plan = EvaluationPlan(GraspsTheMiddle(), FOLDER / splits["tiny"].file, limit=3)
    told = {**TOLD, "name": "middle"}
    made = submissions.submission_of(evaluate_plan(plan), "retrieve", "tiny", told, "overhead")
    assert made.card.grippers == ("jaws-85",)
    submissions.save_submission(tmp_path / "a.npz", made)
    read = submissions.load_submission(tmp_path / "a.npz")
    found = submissions.verified(read, FOLDER)
    assert [c.actions.tobytes() for c in found.claims] == [c.actions.tobytes() for c in made.claims]
    failed = next(i for i, c in enumerate(made.claims) if c.end == "budget")
    lifted = replace(
        made.claims[failed],
        end="retrieved",
        scores={**made.claims[failed].scores, "retrieved_within_5": 1.0},
    )
    claims = (*made.claims[:failed], lifted, *made.claims[failed + 1 :])
    words = "end 'retrieved' claimed, 'budget' found, retrieved_within_5 1 claimed, 0 found"
    with pytest.raises(MechSearchError, match=words):
        submissions.verified(replace(made, claims=claims), FOLDER)
    bent = replace(lifted, actions=made.claims[failed].actions + np.eye(9)[2])
    with pytest.raises(MechSearchError, match="is out of reach"):
        submissions.verified(replace(made, claims=(bent, *made.claims[1:])), FOLDER)
