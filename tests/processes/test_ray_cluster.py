"""A Ray cluster of this machine, two workers, some of which are killed."""

import importlib.util
import itertools
import os
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

if importlib.util.find_spec("ray") is None:
    pytest.skip("no Ray: install mechsearch[ray] to run these tests", allow_module_level=True)

import ray

from mechsearch.cli import main
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan
from mechsearch.heaps.dataset import embedded_heaps, load_heaps, save_heaps
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.processes.ray_cluster import connected, ray_map
from mechsearch.types import MechSearchError

SMALL = GenerateConfig(heaps=8, counts=(5, 6), seed=5)


@pytest.fixture(scope="module", autouse=True)
def cluster():
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    with connected(cpus=2) as processors:
        yield processors


@dataclass(frozen=True)
class Square:
    """Squares numbers; misbehaves on one of them, `times` times over all processes."""

    folder: Path
    how: str = ""
    number: int = -1
    times: int = 1

    def __call__(self, number):
        marks = len(list(self.folder.glob(f"{number}-*")))
        (self.folder / f"{number}-{time.monotonic_ns()}").touch()
        if number == self.number and marks < self.times:
            if self.how == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.how == "hang":
                time.sleep(600)
            raise ValueError(f"{number} is unlucky")
        return number**2

    def tries(self, number):
        return len(list(self.folder.glob(f"{number}-*")))


def test_the_cluster_has_the_processors_asked_for(cluster):
    assert cluster == 2


@pytest.mark.parametrize("how", ["die", "hang", "raise"])
def test_trouble_costs_the_repetition_of_its_input_alone(tmp_path, how):
    square = Square(tmp_path, how, 3)
    results = ray_map(square, itertools.count(), 2, time_limit=3.0)
    assert list(itertools.islice(results, 8)) == [n**2 for n in range(8)]
    results.close()
    assert [square.tries(n) for n in range(8)] == [1 + (n == 3) for n in range(8)]


def test_what_kills_two_workers_is_replaced_as_the_caller_chooses_or_named(tmp_path):
    square = Square(tmp_path, "die", 1, times=9)
    lost = []

    def instead(item, failure):
        lost.append((item, failure.reason))
        return -1

    assert list(ray_map(square, range(4), 2, instead=instead)) == [0, -1, 4, 9]
    assert lost == [(1, "worker died")]
    with pytest.raises(MechSearchError, match="worker died, 2 times, on 1;"):
        list(ray_map(square, range(4), 2))


def test_bad_input_is_raised_at_once(tmp_path):
    def refuse(number):
        raise MechSearchError(f"{number} is bad input")

    with pytest.raises(MechSearchError, match="0 is bad input"):
        list(ray_map(refuse, range(4), 1, instead=lambda *_: 0))


def pids_of_workers():
    """Return the processes that this machine's actors run in."""
    pids = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if path.read_bytes().startswith(b"ray::RemoteFunction"):
                pids.append(int(path.parent.name))
    return pids


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc to find workers")
def test_heaps_are_the_serial_ones_though_a_worker_is_killed_midway(tmp_path):
    while pids_of_workers():
        time.sleep(0.1)
    before, after = [], []

    def kill(label, done, total):
        if done == 2 and not before:
            before.extend(pids_of_workers())
            os.kill(before[0], signal.SIGKILL)
        after[:] = pids_of_workers()
        # The other worker may have done the rest before the new one is up.
        deadline = time.monotonic() + 60
        while done == total and len(after) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
            after[:] = pids_of_workers()

    heaps = generate(SMALL, tmp_path / "ray.parquet", 2, kill, ray_map)
    assert len(before) == len(after) == 2
    assert set(after) & set(before) == {before[1]}
    assert heaps.hash == generate(SMALL, tmp_path / "serial.parquet").hash


def test_episodes_are_the_serial_ones(tmp_path):
    embedded = embedded_heaps("single")
    save_heaps(tmp_path / "heaps.parquet", embedded.held_out[:4], embedded.manifest)
    plan = EvaluationPlan("teacher-straight", tmp_path / "heaps.parquet")
    ours, serial = evaluate_plan(plan, 2, mapper=ray_map), evaluate_plan(plan)
    assert ours.header == serial.header
    for left, right in zip(ours.episodes, serial.episodes, strict=True):
        np.testing.assert_array_equal(left.poses, right.poses)
        np.testing.assert_array_equal(left.rewards, right.rewards)


def test_the_commands_take_ray_and_relative_paths(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--heaps", "4", "--counts", "4", "--seed", "3"]
    main(["heaps", "generate", "--out", "ray.parquet", *words, "--ray"])
    main(["heaps", "generate", "--out", "one.parquet", *words, "--workers", "1"])
    assert load_heaps(Path("ray.parquet")).hash == load_heaps(Path("one.parquet")).hash
    main(["evaluate", "idle", "--heaps", "ray.parquet", "--out", "scores", "--ray", "--brief"])
    assert "left out" not in capsys.readouterr().out
    assert Path("scores/idle.npz").exists()


def test_other_versions_on_a_machine_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr("mechsearch.processes.ray_cluster.version", lambda name: "0.0")
    with pytest.raises(MechSearchError, match=r"numpy .* \(here 0.0\)"):
        list(ray_map(Square(tmp_path), range(2), 1))
