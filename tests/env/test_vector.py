"""Vector environments: Gymnasium's own as the yardstick, and workers that die, hang and raise."""

import copy
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.vector.vector_env import VectorHeapEnv
from mechsearch.types import MechSearchError

SEEDS = (101, 102, 103, 104)


class TroubledEnv(HeapEnv):
    """Misbehaves as TROUBLE says: how, on which heap, at which action (0 is the reset), how often.

    Each time takes one of the files in its folder away.
    """

    def reset(self, *, seed=None, options=None):
        result = super().reset(seed=seed, options=options)
        self._misbehave()
        return result

    def step(self, action):
        result = super().step(action)
        self._misbehave()
        return result

    def _misbehave(self):
        trouble = json.loads(os.environ.get("TROUBLE", "{}"))
        if trouble.get("heap") != self.heap.seed or trouble["at"] != self._actions:
            return
        lives = sorted(Path(trouble["folder"]).iterdir())
        if not lives:
            return
        lives[0].unlink()
        if trouble["how"] == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if trouble["how"] == "hang":
            time.sleep(600)
        raise ValueError("the simulator has a bug")


@pytest.fixture
def trouble(tmp_path, monkeypatch):
    """Return a function that brings trouble into the workers that are started from then on."""

    def bring(how, heap, at, times):
        folder = tmp_path / "lives"
        folder.mkdir(exist_ok=True)
        for i in range(times):
            (folder / str(i)).touch()
        wanted = {"how": how, "heap": heap, "at": at, "folder": str(folder)}
        monkeypatch.setenv("TROUBLE", json.dumps(wanted))

    return bring


@pytest.fixture
def make(covered, boxes):
    """Four alike heaps, episodes of four actions."""
    heaps = [replace(covered, seed=seed) for seed in SEEDS]
    return partial(TroubledEnv, heaps, boxes, HeapEnvConfig(max_actions=4, uncovered_at=0.0))


def actions(steps, envs, seed=0):
    shape = (steps, envs, 3)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def played(envs, steps=10, seed=5):
    """Return everything that an environment tells, reset where it is over."""
    rows = [envs.reset(seed=seed)]
    disabled = envs.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    for batch in actions(steps, envs.num_envs):
        rows.append(envs.step(batch))
        over = rows[-1][2] | rows[-1][3]
        if disabled and over.any():
            rows.append(envs.reset(options={"reset_mask": over}))
    return rows


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
@pytest.mark.parametrize("workers", [1, 2])
def test_episodes_are_those_of_gymnasiums_own_vector_environment(make, mode, workers):
    yardstick = played(SyncVectorEnv([make] * 3, autoreset_mode=AutoresetMode(mode)))
    with closing(VectorHeapEnv(make, 3, workers, autoreset_mode=mode)) as envs:
        assert envs.observation_space.contains(envs.reset()[0])
        rows = played(envs)
    assert len(rows) == len(yardstick)
    for row, expected in zip(rows, yardstick, strict=True):
        assert data_equivalence(row, expected, exact=True)
    assert not multiprocessing.active_children()


def test_parts_are_received_in_the_order_sent_and_are_the_transitions_of_whole_steps(make):
    batches = actions(6, 3)
    with closing(VectorHeapEnv(make, 3, 2)) as envs:
        envs.reset(seed=5)
        whole = [envs.step(batch) for batch in batches]
        envs.reset(seed=5)
        envs.send(batches[0], range(3))
        for k in range(18 - 3):
            indices, (obs, rewards, _, truncated, infos) = envs.receive(1)
            assert indices.tolist() == [k % 3]
            step = whole[k // 3]
            assert rewards[0] == step[1][k % 3]
            assert truncated[0] == step[3][k % 3]
            assert infos["occlusion"][0] == step[4]["occlusion"][k % 3]
            np.testing.assert_array_equal(obs["depth"][0], step[0]["depth"][k % 3])
            envs.send(batches[k // 3 + 1][[k % 3]], indices)
        indices, last = envs.receive(3)
        assert indices.tolist() == [0, 1, 2]
        assert data_equivalence(last, whole[-1], exact=True)


def own_rows(rows, env):
    """Return what one environment was told, without infos."""
    told = []
    for obs, *rest in rows:
        told.append([obs[key][env] for key in obs] + [part[env] for part in rest[:-1]])
    return told


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("die", "worker died"),
        ("hang", "worker hung"),
        ("raise", "worker raised: ValueError: the simulator has a bug"),
    ],
)
def test_a_failing_worker_costs_one_episode_and_the_others_go_on(make, trouble, how, reason):
    with closing(VectorHeapEnv(make, 4, 2, autoreset_mode="Disabled")) as envs:
        _, info = envs.reset(seed=5)
        calm = [envs.step(batch) for batch in actions(4, 4)]
    heaps = info["heap"].tolist()
    lost = next(i for i in range(4) if heaps.count(heaps[i]) == 1)
    trouble(how, SEEDS[heaps[lost]], at=2, times=1)
    with closing(VectorHeapEnv(make, 4, 2, time_limit=4.0, autoreset_mode="Disabled")) as envs:
        pids = envs.pids
        envs.reset(seed=5)
        first, second = (envs.step(batch) for batch in actions(4, 4)[:2])
        assert second[4]["failure"].tolist() == [reason if i == lost else None for i in range(4)]
        assert second[4]["end"][lost] == f"failure: {reason}"
        assert (second[1][lost], second[2][lost], second[3][lost]) == (0.0, False, True)
        for key in first[0]:
            np.testing.assert_array_equal(second[0][key][lost], first[0][key][lost])
        assert second[4]["occlusion"][lost] == first[4]["occlusion"][lost]
        assert envs.quarantined == {}
        assert sum(a != b for a, b in zip(pids, envs.pids, strict=True)) == (how != "raise")
        mask = np.arange(4) == lost
        envs.reset(options={"reset_mask": mask})
        rest = [envs.step(batch) for batch in actions(4, 4)[2:]]
    for i in set(range(4)) - {lost}:
        assert data_equivalence(own_rows(calm, i), own_rows([first, second, *rest], i), exact=True)


def test_in_the_same_step_mode_a_lost_episode_is_followed_by_the_next(make, trouble):
    trouble("die", SEEDS[0], at=2, times=1)
    with closing(VectorHeapEnv(make, 1)) as envs:
        envs.reset(options={"heap": 0})
        first = envs.step(actions(1, 1)[0])
        obs, rewards, terminated, truncated, info = envs.step(actions(1, 1)[0])
        assert (rewards[0], terminated[0], truncated[0]) == (0.0, False, True)
        assert info["failure"].tolist() == ["worker died"]
        assert info["final_info"]["failure"].tolist() == ["worker died"]
        np.testing.assert_array_equal(info["final_obs"][0]["depth"], first[0]["depth"][0])
        heap, start = info["heap"][0], obs["ee_position"][0]
        np.testing.assert_array_equal(envs.call("state")[0].ee_position.astype(np.float32), start)
        assert envs.get_attr("heap")[0].seed == SEEDS[heap]


def test_a_worker_killed_between_two_steps_costs_one_episode(make):
    with closing(VectorHeapEnv(make, 4, 2, autoreset_mode="Disabled")) as envs:
        envs.reset(seed=1)
        envs.step(actions(1, 4)[0])
        os.kill(envs.pids[0], signal.SIGKILL)
        *_, truncated, info = envs.step(actions(1, 4)[0])
        assert info["failure"].tolist().count("worker died") == truncated.sum() == 1
        assert truncated[[0, 2]].any()


def test_a_heap_that_kills_two_workers_is_quarantined_by_name_and_not_drawn_again(make, trouble):
    trouble("die", SEEDS[2], at=1, times=99)
    with closing(VectorHeapEnv(make, 2, 2)) as envs:
        _, info = envs.reset(seed=0)
        told, drawn = [], []
        for batch in actions(40, 2):
            *_, info = envs.step(batch)
            told += [name for name in info.get("quarantined", []) if name]
            if envs.quarantined and "heap" in info:
                drawn += info["heap"][info["_heap"]].tolist()
        assert envs.quarantined == {SEEDS[2]: "worker died"}
        assert told == [SEEDS[2]]
        assert set(drawn[1:]) == {0, 1, 3}
        with pytest.raises(MechSearchError, match=r"heap 2 \(seed 103\) is quarantined"):
            envs.reset(options={"heap": 2})
        envs.reset(options={"heap": 1})


def test_a_reset_that_kills_once_is_repeated_and_costs_nothing(make, trouble):
    with closing(VectorHeapEnv(make, 1)) as envs:
        obs, info = envs.reset(seed=3)
    trouble("die", SEEDS[info["heap"][0]], at=0, times=1)
    with closing(VectorHeapEnv(make, 1)) as envs:
        assert data_equivalence(envs.reset(seed=3), (obs, info), exact=True)


def test_a_reset_that_kills_twice_quarantines_its_heap_and_draws_another(make, trouble):
    with closing(VectorHeapEnv(make, 1)) as envs:
        _, info = envs.reset(seed=3)
    trouble("raise", SEEDS[info["heap"][0]], at=0, times=99)
    with closing(VectorHeapEnv(make, 1)) as envs:
        _, again = envs.reset(seed=3)
        assert again["heap"] != info["heap"]
        assert again["quarantined"].tolist() == list(envs.quarantined) == [SEEDS[info["heap"][0]]]
        with pytest.raises(MechSearchError, match="is quarantined"):
            envs.reset(options={"heap": info["heap"][0]})


def test_when_every_heap_is_quarantined_the_reason_is_named(covered, boxes, trouble):
    trouble("raise", covered.seed, at=0, times=99)
    with closing(VectorHeapEnv(partial(TroubledEnv, [covered], boxes), 1)) as envs:
        for _ in range(2):
            with pytest.raises(MechSearchError, match=r"all 1 heaps .*1234: .* has a bug"):
                envs.reset()
        with pytest.raises(MechSearchError, match=r"\[0\] are over"):
            envs.step(np.zeros((1, 3)))


def test_misuse_is_refused_before_anything_happens(make):
    with pytest.raises(MechSearchError, match="'NextStep'; choose one of SameStep, Disabled"):
        VectorHeapEnv(make, 2, autoreset_mode=AutoresetMode.NEXT_STEP)
    for wrong in ({"num_envs": 0}, {"num_envs": 2.5}, {"workers": "2"}, {"time_limit": np.nan}):
        with pytest.raises(MechSearchError, match=f"{next(iter(wrong))} is .*above 0"):
            VectorHeapEnv(make, **wrong)
    with pytest.raises(MechSearchError, match="a RetrieveEnv was made; expected a HeapEnv"):
        VectorHeapEnv(partial(RetrieveEnv, *make.args[:2]))
    envs = VectorHeapEnv(make, 2, 1, autoreset_mode="Disabled")
    with pytest.raises(MechSearchError, match=r"\[0, 1\] are over"):
        envs.step(np.zeros((2, 3)))
    envs.reset(seed=[1, None])
    ragged, huge = [[0, 0, 0], [0, 0]], np.full((2, 3), 1e300)
    for wrong in (np.zeros((1, 3)), np.full((2, 3), np.nan), ragged, huge, None, "up"):
        with pytest.raises(MechSearchError, match=r"shape \(2, 3\)"):
            envs.step(wrong)
    for wrong in (2, -1):
        with pytest.raises(MechSearchError, match="choose among 0 to 1"):
            envs.send(np.zeros((1, 3)), [wrong])
    for wrong in ("3", 1.5, [1, 2.5], -1):
        with pytest.raises(MechSearchError, match=r"seed is .*expected a whole number"):
            envs.reset(seed=wrong)
    with pytest.raises(MechSearchError, match="3 seeds"):
        envs.reset(seed=[1, 2, 3])
    for mask in ([True, False], np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        with pytest.raises(MechSearchError, match="reset_mask"):
            envs.reset(options={"reset_mask": mask})
    for options in ({"heap": 9}, {"heap": "3"}, {"heap": True}):
        with pytest.raises(MechSearchError, match=r"heap (is )?\S+(;| does not exist)"):
            envs.reset(options=options)
    with pytest.raises(
        MechSearchError, match="'reset_maks'; choose among heap, fixed_start, reset"
    ):
        envs.reset(options={"reset_maks": np.ones(2, bool)})
    with pytest.raises(MechSearchError, match="neither copied nor pickled"):
        copy.deepcopy(envs)
    with pytest.raises(MechSearchError, match="would change"):
        envs.call("restore", {})
    with pytest.raises(AttributeError, match="colour"):
        envs.get_attr("colour")
    envs.reset(seed=1)
    with pytest.raises(NoAsyncCallError):
        envs.step_wait()
    envs.step_async(np.zeros((2, 3)))
    for pending in (envs.reset, lambda: envs.step_async(np.zeros((2, 3)))):
        with pytest.raises(AlreadyPendingCallError):
            pending()
    envs.close()
    envs.close()
    with pytest.raises(ClosedEnvironmentError):
        envs.reset()
    assert not multiprocessing.active_children()


UNCLOSED = """
import mechsearch

if __name__ == "__main__":
    envs = mechsearch.make_vector_env(num_envs=2, workers=2, keys=("ee_position",))
    envs.reset(seed=0, options={"heap": 2.0})
"""


def test_one_that_is_never_closed_ends_silently_with_the_interpreter(tmp_path):
    (tmp_path / "script.py").write_text(UNCLOSED)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""


@pytest.mark.parametrize("name", ["mechsearch/SingleHeap-v0", "mechsearch/DualHeap-v0"])
def test_make_vec_gives_this_environment_and_gymnasiums_wrappers_take_it(name):
    envs = gymnasium.make_vec(
        name, num_envs=3, workers=2, max_actions=2, privileged=True, render_mode="rgb_array"
    )
    assert isinstance(envs, VectorHeapEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.spec is not None
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    obs, _ = wrapped.reset(seed=0)
    assert obs in envs.observation_space
    assert obs["target_offset"].shape == (3, 3)
    for batch in actions(2, 3):
        obs, _, terminated, truncated, info = wrapped.step(batch)
    assert (terminated | truncated).all()
    assert info["episode"]["l"].tolist() == [2, 2, 2]
    assert [picture.shape for picture in envs.render()] == [(256, 256, 3)] * 3
    wrapped.close()
    assert not multiprocessing.active_children()
