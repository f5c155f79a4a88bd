import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig, TaskConfig
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.evaluation.policies import IdlePolicy, RandomPolicy, make_policy
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate, evaluate_plan, run
from mechsearch.heaps import dataset
from mechsearch.heaps.dataset import Heap
from mechsearch.objects.catalog import load_object_set
from mechsearch.sim.scene import PhysicsConfig, Workspace
from mechsearch.types import MechSearchError

NAMES = ("golf_ball", "sponge", "apple")
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def make_heap(seed: int, count: int = 5, held_out: bool = True) -> Heap:
    rng = np.random.default_rng(seed)
    models = load_object_set("household").models
    poses = []
    y, table = rng.uniform(-0.1, 0.1), 0.0
    # The apple lies on the sponge: it is never in full view.
    for name, x in zip(NAMES, (-0.15, 0.0, 0.0), strict=True):
        height = table - float(models[name].vertices[:, 2].min())
        poses.append([x, y, height + 0.001, *UPRIGHT])
        table = 0.0 if x else height + float(models[name].vertices[:, 2].max())
    return Heap(NAMES, np.array(poses), 1, 0.5, seed, count, "single", held_out)


@pytest.fixture(scope="module")
def heap_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("heaps") / "three.parquet"
    heaps = [make_heap(11), make_heap(12, 10), make_heap(13, 15), make_heap(14, held_out=False)]
    config = {"condition": "single", "objects": "household", "camera": "overhead", "seed": 0}
    hashes = load_object_set("household").hashes
    manifest = {"format": 1, "config": config, "engine": "4", "object_hashes": hashes}
    dataset.save_heaps(path, heaps, manifest | {"acceptance_rate": 1.0})
    return path


@pytest.fixture(scope="module")
def env() -> HeapEnv:
    heaps = [make_heap(11), make_heap(12), make_heap(13)]
    config = HeapEnvConfig(keys=("ee_position",), max_actions=6)
    return HeapEnv(heaps, load_object_set("household"), config)


def same(left: EpisodeRecord, right: EpisodeRecord) -> bool:
    names = ("actions", "ee_positions", "occlusions", "poses", "clutter_moved", "target_moved")
    return left.heap_seed == right.heap_seed and all(
        np.array_equal(getattr(left, name), getattr(right, name)) for name in names
    )


def test_all_policies_start_alike(env: HeapEnv) -> None:
    idle, moving = run(IdlePolicy(), env, [0, 1]), run(RandomPolicy(), env, [0, 1], seed=9)
    for left, right in zip(idle, moving, strict=True):
        np.testing.assert_array_equal(left.ee_positions[0], right.ee_positions[0])
        np.testing.assert_array_equal(left.poses[0], right.poses[0])
        assert left.occlusions[0] == right.occlusions[0]
    assert not np.array_equal(idle[0].ee_positions[0], idle[1].ee_positions[0])


def test_an_episode_does_not_depend_on_those_before_it(env: HeapEnv) -> None:
    forward = run(RandomPolicy(), env, [0, 1, 2], seed=3)
    backward = run(RandomPolicy(), env, [2, 1, 0, 2], seed=3)
    assert [record.heap_seed for record in forward] == [11, 12, 13]
    for left, right in zip(forward, reversed(backward[:3]), strict=True):
        assert same(left, right)
    assert same(backward[0], backward[3])


def test_the_seed_decides_the_policys_randomness(env: HeapEnv) -> None:
    first, second = (run(RandomPolicy(), env, [0], seed=seed)[0] for seed in (0, 1))
    assert not np.array_equal(first.actions, second.actions)


def test_a_policy_is_handed_its_own_keys_alone() -> None:
    seen: list[set[str]] = []

    class Nosy(IdlePolicy):
        keys = ("target_offset",)

        def act(self, obs):
            seen.append(set(obs))
            return super().act(obs)

    task = HeapEnvConfig(keys=("ee_position",), privileged=True, max_actions=2)
    env = HeapEnv([make_heap(11)], load_object_set("household"), task)
    run(Nosy(), env, [0])
    assert seen
    assert all(keys == {"target_offset"} for keys in seen)


def test_what_was_done_and_what_came_of_it_is_recorded(env: HeapEnv) -> None:
    record = run(RandomPolicy(), env, [0], name="random")[0]
    steps = len(record.actions)
    assert record.ee_positions.shape == (steps + 1, 3)
    moves = np.linalg.norm(np.diff(record.ee_positions, axis=0), axis=1)
    assert moves.max() < 0.06
    env.reset(options={"heap": 0, "fixed_start": True})
    rewards = [env.step(action)[1] for action in record.actions]
    np.testing.assert_allclose(record.rewards, rewards)
    assert (record.policy, record.action_limit, record.target) == ("random", 6, 1)


class Faulty(IdlePolicy):
    """Goes wrong in one of its methods, as users' policies do."""

    def __init__(self, method: str, gives: object) -> None:
        self._method, self._gives = method, gives

    def _at(self, method: str) -> object:
        if method == self._method and isinstance(self._gives, Exception):
            raise self._gives
        return self._gives

    def reset(self, rng: np.random.Generator) -> None:
        self._at("reset")

    def act(self, obs):
        return self._at("act")


@pytest.mark.parametrize("method", ["reset", "act"])
def test_what_a_users_policy_raises_is_named_with_the_policy_and_kept_as_the_cause(
    heap_file: Path, method: str
) -> None:
    error = ValueError("no such\nthing")
    with pytest.raises(MechSearchError) as found:
        evaluate(Faulty(method, error), heap_file, limit=1)
    assert str(found.value) == "policy Faulty raised ValueError: no such thing"
    assert found.value.__cause__ is error
    assert error.__traceback__ is not None


@pytest.mark.parametrize("action", [None, "up", np.zeros(2)])
def test_an_action_that_is_none_is_named_with_its_policy(heap_file: Path, action: object) -> None:
    with pytest.raises(MechSearchError, match=r"policy Faulty: an action is \(3,\).*got"):
        evaluate(Faulty("act", action), heap_file, limit=1)


def test_a_policy_made_for_a_robot_is_asked_itself(heap_file: Path) -> None:
    """Otherwise a task with another workspace would be refused, and every action checked."""
    task = TaskConfig(max_actions=3, workspace=Workspace(half=0.39))
    made, named = (
        evaluate(policy, heap_file, limit=2, task=task)
        for policy in (make_policy("teacher-spiral"), "teacher-spiral")
    )
    assert made.header["policy"] == "PushTeacher"
    assert all(map(same, made.episodes, named.episodes))


def test_after_a_failed_simulation_the_last_trusted_state_is_recorded(
    env: HeapEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def failure(world) -> str | None:
        calls.append(world)
        return "NaN" if len(calls) == 3 else None

    monkeypatch.setattr("mechsearch.sim.world.World.failure", failure)
    simulated = replace(env.config, physics=PhysicsConfig(clearance=np.inf))
    record = run(IdlePolicy(), HeapEnv(env.heaps, env.objects, simulated), [0])[0]
    assert record.end == "failure: NaN"
    assert len(record.actions) == 3
    np.testing.assert_array_equal(record.poses[3], record.poses[2])
    np.testing.assert_array_equal(record.ee_positions[3], record.ee_positions[2])
    assert record.rewards[2] == 0


def test_held_out_heaps_are_evaluated_and_the_file_says_how(
    heap_file: Path, tmp_path: Path
) -> None:
    task = TaskConfig(max_actions=3)
    done: list[int] = []
    evaluation = evaluate_plan(
        EvaluationPlan("idle", heap_file, task=task), progress=lambda _, i, n: done.append(i)
    )
    assert [record.heap_seed for record in evaluation.episodes] == [11, 12, 13]
    assert done == [1, 2, 3]
    header = evaluation.header
    assert (header["name"], header["condition"], header["trained"]) == ("idle", "single", False)
    assert header["heap_set"] == dataset.load_heaps(heap_file).hash
    assert header["env"]["keys"] == ["ee_position"]
    episodes.save_episodes(tmp_path / "idle.npz", evaluation)
    loaded = episodes.load_episodes(tmp_path / "idle.npz")
    assert loaded.header == header
    assert all(map(same, loaded.episodes, evaluation.episodes))


def test_a_heap_set_that_was_made_anew_is_read_anew(heap_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "heaps.parquet"
    found = dataset.load_heaps(heap_file)
    plan = EvaluationPlan("idle", path, task=TaskConfig(max_actions=1))
    for heaps in (found.heaps[:2], found.heaps[1:3]):
        dataset.save_heaps(path, heaps, found.manifest)
        seeds = [record.heap_seed for record in evaluate_plan(plan).episodes]
        assert seeds == [heap.seed for heap in heaps]


def test_splits_and_limits_choose_heaps_evenly(heap_file: Path) -> None:
    task = TaskConfig(max_actions=1)

    def seeds(**options: object) -> list[int]:
        plan = EvaluationPlan("idle", heap_file, task=task, **options)
        return [record.heap_seed for record in evaluate_plan(plan).episodes]

    assert seeds(split="train") == [14]
    assert seeds(split="all", limit=2) == [11, 13]
    assert seeds(limit=3) == [11, 12, 13]


def test_the_result_does_not_depend_on_the_number_of_workers(heap_file: Path) -> None:
    task = TaskConfig(max_actions=5)
    plan = EvaluationPlan("random", heap_file, task=task)
    one, two = evaluate_plan(plan, workers=1), evaluate_plan(plan, workers=2)
    assert one.header == two.header
    assert len(one.episodes) == 3
    assert all(map(same, one.episodes, two.episodes))


class Killer(IdlePolicy):
    """Idles, but kills its process where the file beside this test's heaps says so."""

    keys = ("target_offset",)

    def act(self, obs):
        folder, height = killing()
        if abs(float(obs["target_offset"][1]) - height) < 1e-5:
            left = len(list(folder.glob("life-*")))
            if left:
                (folder / f"life-{left}").unlink()
                os.kill(os.getpid(), signal.SIGKILL)
        return super().act(obs)


def killing() -> tuple[Path, float]:
    folder = Path(os.environ["KILLER_FOLDER"])
    return folder, float((folder / "height").read_text())


@pytest.fixture
def kill_on_heap_12(
    env: HeapEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[int], EvaluationPlan]:
    """Return a maker of plans whose policy kills its process on heap 12, so many times."""
    monkeypatch.setenv("KILLER_FOLDER", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    task = HeapEnvConfig(keys=("target_offset",), max_actions=2)
    twin = HeapEnv(env.heaps, env.objects, task)
    obs, _ = twin.reset(options={"heap": 1, "fixed_start": True})
    (tmp_path / "height").write_text(str(float(obs["target_offset"][1])))

    def make(heap_file: Path, times: int) -> EvaluationPlan:
        for i in range(times):
            (tmp_path / f"life-{i + 1}").touch()
        return EvaluationPlan(f"{__name__}:Killer", heap_file, name="killer", task=task)

    return make


def test_a_dead_worker_costs_time_only(heap_file: Path, kill_on_heap_12) -> None:
    evaluation = evaluate_plan(kill_on_heap_12(heap_file, 1), workers=2)
    assert [record.heap_seed for record in evaluation.episodes] == [11, 12, 13]
    assert (evaluation.header["heaps"], evaluation.header["quarantined"]) == (3, [])
    calm = evaluate_plan(kill_on_heap_12(heap_file, 0))
    assert all(map(same, evaluation.episodes, calm.episodes))


def test_a_heap_that_kills_two_workers_is_quarantined_and_the_counts_add_up(
    heap_file: Path, kill_on_heap_12
) -> None:
    evaluation = evaluate_plan(kill_on_heap_12(heap_file, 9), workers=2)
    assert [record.heap_seed for record in evaluation.episodes] == [11, 13]
    header = evaluation.header
    assert header["quarantined"] == [{"heap": 12, "reason": "worker died"}]
    assert header["heaps"] == len(evaluation.episodes) + len(header["quarantined"])


def test_when_no_episode_can_be_run_the_reason_is_named(
    heap_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def step(self, action):
        raise ValueError("no physics")

    monkeypatch.setattr(HeapEnv, "step", step)
    with pytest.raises(MechSearchError, match=r"all 3 heaps failed twice; .*11: .*no physics"):
        evaluate_plan(EvaluationPlan("idle", heap_file))


class Unsure(IdlePolicy):
    def act(self, obs):
        raise KeyError("unsure")


def test_what_a_policy_raises_stops_the_evaluation_instead_of_dropping_its_heaps(
    env: HeapEnv,
) -> None:
    with pytest.raises(MechSearchError, match="policy unsure raised KeyError: 'unsure'"):
        run(Unsure(), env, [0], name="unsure")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "test"}, "unknown split 'test'; choose one of held-out, train, all"),
        ({"limit": -1}, "limit is -1"),
        ({"limit": 4}, "4 heaps asked for; .* has 3 held-out heaps"),
        ({"policy": "nobody"}, "unknown policy 'nobody'"),
        ({"heaps": Path("absent.parquet")}, "no heap set at absent.parquet"),
        ({"objects": "no-such-folder"}, "no-such-folder"),
    ],
)
def test_a_plan_that_cannot_be_carried_out_is_refused(
    heap_file: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(MechSearchError, match=message):
        evaluate_plan(EvaluationPlan(**({"policy": "idle", "heaps": heap_file} | options)))
