"""`heaps-4200`, `train-8000-at-0.25`, `train-8000-at-1`: what a user waits for."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks import machine
from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.heaps.dataset import CONDITIONS
from mechsearch.heaps.generate import GenerateConfig, generate

_SETS = {"single": 3000, "dual": 1200}
"""Heaps of the paper's two sets."""

_SAMPLE = 50


def measure_heaps(settings: Settings) -> Iterator[Figure]:
    """Time both of the paper's heap sets, or a fiftieth of each and the rest by its rate."""
    seconds = sum(_time_set(settings, condition, number) for condition, number in _SETS.items())
    sample = sum(_SETS.values()) // _SAMPLE
    note = f"{machine.cores()} workers"
    if not settings.full:
        note += f"; extrapolated from {sample} heaps"
    yield Figure("heaps-4200", seconds / 60, "minutes", note=note)


def _time_set(settings: Settings, condition: str, number: int) -> float:
    """Return the seconds that a set takes, or would take."""
    counts = CONDITIONS[condition]
    heaps = number if settings.full else number // _SAMPLE
    config = GenerateConfig(condition, heaps, settings.workload.objects, seed=2026)
    marks: dict[str, list[tuple[int, float]]] = {}

    def progress(label: str, done: int, total: int) -> None:
        if done == 0:
            settings.say(f"heaps-4200: {total} {label}")
        marks.setdefault(label, []).append((done, time.perf_counter()))

    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        generate(config, Path(folder) / "heaps.parquet", machine.cores(), progress)
        whole = time.perf_counter() - began
    if settings.full:
        return whole
    # Starting the workers is paid once for each object count, however many heaps there are.
    return sum(_extrapolated(times, number // len(counts)) for times in marks.values())


def _extrapolated(marks: list[tuple[int, float]], number: int) -> float:
    """Return the seconds until `number` heaps, from (heaps, time [s]) of fewer."""
    (_, began), (first, first_at), (last, last_at) = marks[0], marks[1], marks[-1]
    return first_at - began + (number - first) * (last_at - first_at) / (last - first)


def measure_training(settings: Settings) -> Iterator[Figure]:
    """Time `mechsearch train method` without evaluation; only when everything is measured."""
    if not settings.full:
        settings.say("train-8000: minutes each; measured with --full")
        return
    for rate in ("0.25", "1"):
        seconds = _time_training(settings, rate)
        settings.say(f"train-8000-at-{rate}: {seconds / 60:.1f} minutes")
        yield Figure(f"train-8000-at-{rate}", seconds / 60, "minutes", note="evaluation left out")


def _time_training(settings: Settings, rate: str) -> float:
    workload = settings.workload
    with tempfile.TemporaryDirectory() as folder:
        heaps = Path(folder) / "heaps.parquet"
        workload.written(workload.heap_set.heaps, heaps)
        command = [
            sys.executable, "-m", "mechsearch", "train", "method", "--heaps", str(heaps),
            "--objects", workload.objects, "--out", f"{folder}/run", "--actions", "8000",
            "--updates-per-action", rate, "--validation-heaps", "0", "--evaluate-every", "8000",
        ]  # fmt: skip
        began = time.perf_counter()
        subprocess.run(command, check=True)
        return time.perf_counter() - began
