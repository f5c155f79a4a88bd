"""Episodes of retrieval: evaluated, recorded, played again and measured."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted import Aimless, Equipped, Scripted

from mechsearch.cli import main
from mechsearch.env.decision import Decision
from mechsearch.env.task import RetrieveConfig
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import Evaluation, RetrievalRecord
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate, evaluate_plan, replay_all
from mechsearch.heaps.dataset import embedded_file
from mechsearch.types import MechSearchError

DOWN = (1.0, 0.0, 0.0, 0.0)
HEAPS = embedded_file("single")


@pytest.fixture(scope="module")
def recorded() -> Evaluation:
    return evaluate(Scripted(), limit=6)


def retrieving(make_episode, decisions, held, outcomes=None, **changes):
    """Return an episode of 5 objects, the last of which is the target."""
    length = len(decisions)
    outcomes = outcomes or tuple("success" if up else "" for up in held)
    return make_episode(
        length=length,
        actions=np.array([decision.vector() for decision in decisions]).reshape(length, 9),
        retrieval=RetrievalRecord(tuple(outcomes), tuple(held)),
        **changes,
    )


PUSH, GRASP, REMOVE = (
    Decision.push([1, 0, 0]), Decision.grasp([0, 0, 0.1, *DOWN]), Decision.remove([0] * 3 + [*DOWN])
)  # fmt: skip


@pytest.mark.parametrize(
    ("decisions", "held", "outcomes", "end", "expected"),
    [
        (
            [PUSH, PUSH, GRASP, REMOVE, GRASP], [(), (), (1,), (0,), (4,)], None, "retrieved",
            {"retrieved_within_1": 0, "retrieved_within_3": 1, "retrieved_within_5": 1,
             "grasp_attempts": 2, "push_actions": 2, "removals": 1, "wrong_objects": 1},
        ),
        (
            [GRASP, GRASP, REMOVE, PUSH], [(2, 4), (), (1, 2), ()],
            ("two objects", "slipped", "success", "used up"), "budget",
            {"retrieved_within_1": 0, "retrieved_within_5": 0, "grasp_attempts": 2,
             "push_actions": 0, "removals": 1, "wrong_objects": 0},
        ),
        (
            [REMOVE], [(4,)], None, "retrieved",
            {"retrieved_within_1": 1, "grasp_attempts": 1, "removals": 0},
        ),
        (
            [GRASP] * 4, [(), (), (), (4,)], None, "retrieved",
            {"retrieved_within_1": 0, "retrieved_within_3": 0, "retrieved_within_5": 1},
        ),
        ([GRASP], [()], ("failure",), "failure: explosion", {"retrieved_within_5": 0}),
    ],
)  # fmt: skip
def test_metrics_are_counted_from_decisions(make_episode, decisions, held, outcomes, end, expected):
    record = retrieving(make_episode, decisions, held, outcomes, end=end)
    measured = episodes.measure(record)
    assert {name: measured[name] for name in expected} == expected
    assert measured["clutter_moved_m"] == record.clutter_moved.sum()
    assert set(episodes.RETRIEVAL_METRICS) <= set(measured)
    assert "uncovered_rate" not in measured


def test_what_lies_in_the_tray_is_told_in_order(make_episode):
    held = [(1,), (0, 2), (4, 3), (3,), (4,)]
    record = retrieving(make_episode, [GRASP, REMOVE, REMOVE, REMOVE, GRASP], held, end="retrieved")
    assert record.removed == (0, 2, 3, 4)
    assert make_episode().removed == ()


def test_records_that_do_not_fit_are_refused(make_episode, tmp_path):
    with pytest.raises(MechSearchError, match=r"actions of the episode.*\(1, 3\); expected \(1, 9"):
        make_episode(length=1, retrieval=RetrievalRecord(("",), ((),)))
    with pytest.raises(MechSearchError, match=r"outcomes of the episode.*\(2,\); expected \(1,\)"):
        retrieving(make_episode, [PUSH], [()], ("", ""))
    mixed = (make_episode(1, length=1), retrieving(make_episode, [PUSH], [()]))
    with pytest.raises(MechSearchError, match="some of the episodes are of retrieval"):
        episodes.save_episodes(tmp_path / "mixed.npz", Evaluation({}, mixed))


def test_a_scripted_policy_retrieves_and_what_it_did_is_recorded(recorded):
    assert recorded.header["goal"] == "retrieve"
    assert recorded.header["env"]["grippers"] == ["jaws-85"]
    assert recorded.header["task_differs"] == []
    ends = {record.end for record in recorded.episodes}
    assert "retrieved" in ends
    for record in recorded.episodes:
        assert record.actions.shape[1] == 9
        assert record.actions.dtype == np.float64
        if record.end == "retrieved":
            assert record.removed == (record.target,)
            assert record.retrieval.outcomes[-1] == "success"


def test_episodes_are_read_back_and_played_again_bit_by_bit(recorded, tmp_path):
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    episodes.save_episodes(first, recorded)
    loaded = episodes.load_episodes(first)
    episodes.save_episodes(second, loaded)
    assert first.read_bytes() == second.read_bytes()
    assert [r.retrieval for r in loaded.episodes] == [r.retrieval for r in recorded.episodes]
    assert all(check.passed for check in replay_all(loaded, HEAPS))
    record = loaded.episodes[0]
    told = replace(record.retrieval, outcomes=("", *["missed"] * (len(record.actions) - 1)))
    changed = Evaluation(loaded.header, (replace(record, retrieval=told),))
    (check,) = replay_all(changed, HEAPS)
    assert check.differences == ("outcomes of decisions, or what came up",)


def test_perturbed_episodes_are_played_again_too():
    evaluation = evaluate(Scripted(), limit=3, task=RetrieveConfig(perturbed=True))
    assert evaluation.header["task_differs"] == ["perturbed False -> True"]
    assert all(check.passed for check in replay_all(evaluation, HEAPS))


def test_the_result_does_not_depend_on_the_number_of_workers(recorded, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    many = evaluate_plan(EvaluationPlan(Scripted(), limit=6), workers=2)
    for name, evaluation in (("one", recorded), ("many", many)):
        episodes.save_episodes(tmp_path / f"{name}.npz", evaluation)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "many.npz").read_bytes()


def test_summary_rows_are_those_of_retrieval(recorded):
    rows = episodes.summary_rows("retrieval", recorded)
    assert tuple(row.metric for row in rows) == episodes.RETRIEVAL_METRICS
    assert {row.variant for row in rows} == {"Scripted"}


def test_the_command_takes_grippers_and_verifies(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    out, summary = tmp_path / "episodes", tmp_path / "summary.csv"
    main(
        ["evaluate", "scripted:Scripted", "--gripper", "jaws-85+suction", "--perturbed",
         "--limit", "2", "--out", str(out), "--summary", str(summary)]
    )  # fmt: skip
    shown = capsys.readouterr().out
    assert "Scores of retrieval" in shown
    assert "retrieved at once [%]" in shown
    assert "perturbed False -> True" in shown
    assert "scripted:Scripted-jaws-85-suction,0,0,retrieved_within_5" in summary.read_text()
    (file,) = out.glob("*.npz")
    assert episodes.load_episodes(file).header["env"]["grippers"] == ["jaws-85", "suction"]
    main(["verify", str(file), "--heaps", str(HEAPS)])
    assert "2 of 2 episodes are as recorded" in capsys.readouterr().out


def test_a_policy_is_told_its_grippers_before_the_first_episode():
    policy = Equipped()
    evaluate(policy, limit=1, grippers=("suction", "jaws-85"))
    assert policy.grippers == ("suction", "jaws-85")
    with pytest.raises(MechSearchError, match="no network for jaws-56"):
        evaluate(policy, limit=1, grippers=("jaws-56",))


@pytest.mark.parametrize(
    ("policy", "settings", "message"),
    [
        ("random", {"grippers": ("jaws-85",)}, "random uncovers, and has no use for jaws-85"),
        (Scripted(), {"grippers": ("claw",)}, "unknown gripper 'claw'; choose one of jaws-56"),
        (Aimless(), {}, "Aimless has the goal 'tidy'; choose one of uncover, retrieve"),
    ],
)
def test_what_does_not_go_together_is_refused(policy, settings, message):
    with pytest.raises(MechSearchError, match=message):
        evaluate(policy, limit=1, **settings)


def test_perturbation_is_for_retrieval(capsys):
    with pytest.raises(SystemExit):
        main(["evaluate", "idle", "--perturbed", "--limit", "1"])
    assert "--perturbed is for policies that retrieve" in capsys.readouterr().err
