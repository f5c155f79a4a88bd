"""Processes killed at random times and started again, until their work is done."""

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.heaps.dataset import load_heaps

MECHSEARCH = (sys.executable, "-m", "mechsearch")
LONGEST = 40.0
"""Time after which a process is killed at the latest [s]."""


Command = Callable[[Path], list[str]]
"""Words that do some work in a folder, or go on with it where it was cut off."""


def kill_generation(kills: int) -> dict[str, Any]:
    """Kill `mechsearch heaps generate` again and again; the set must be that of one quiet run."""

    def command(folder: Path) -> list[str]:
        words = ["heaps", "generate", "--heaps", "30", "--seed", "3", "--workers", "2"]
        return [*MECHSEARCH, *words, "--out", str(folder / "heaps.parquet")]

    def visible(folder: Path) -> None:
        path = folder / "heaps.parquet"
        if path.exists():
            load_heaps(path)

    return _kill("heaps generate", kills, [command], ("heaps.parquet",), visible)


def kill_training(kills: int) -> dict[str, Any]:
    """Kill `mechsearch train` likewise, which goes on in mid-episode and is made longer twice.

    Actor, log and last checkpoint must be those of one quiet run to the full length.
    """
    with tempfile.TemporaryDirectory() as shared:
        heaps = Path(shared) / "heaps.parquet"
        words = ["heaps", "generate", "--heaps", "12", "--counts", "4", "--out", str(heaps)]
        subprocess.run([*MECHSEARCH, *words], check=True, capture_output=True)

        def command(actions: int, folder: Path) -> list[str]:
            run = folder / "run"
            if (run / "config.json").exists():
                return [*MECHSEARCH, "train", "--resume", str(run), "--actions", str(actions)]
            words = ["train", "debug", "--heaps", str(heaps), "--out", str(run)]
            return [*MECHSEARCH, *words, "--checkpoint-every", "7", "--actions", str(actions)]

        files = ("actor.safetensors", "metrics.jsonl", "checkpoints/step-00000360.safetensors")
        stages = [partial(command, actions) for actions in (97, 203, 360)]
        return _kill("train", kills, stages, [f"run/{name}" for name in files])


def kill_sweep(kills: int) -> dict[str, Any]:
    """Kill `mechsearch sweep` likewise, workers and all; tables and actors must be the same."""
    heaps = resources.files("mechsearch.heaps") / "household_single.parquet"
    options = {
        "heaps-single": heaps,
        "conditions": "single",
        "variants": "method plus",
        "seeds": 0,
        "actions": 60,
        "references": "idle teacher-straight",
        "curve-heaps": 2,
        "curve-every": 20,
        "final-heaps": 3,
        "grasps": False,
        "workers": 2,
    }
    words = [word for name, value in options.items() for word in (f"--{name}", *str(value).split())]

    def command(folder: Path) -> list[str]:
        return [*MECHSEARCH, "sweep", *words, "--out", str(folder / "sweep")]

    runs = [f"single/runs/{name}-seed0" for name in ("method", "plus")]
    files = ["summary.csv", "curves.csv"]
    files += [f"{run}/{name}" for run in runs for name in ("actor.safetensors", "metrics.jsonl")]
    return _kill("sweep", kills, [command], [f"sweep/{name}" for name in files])


def _kill(
    name: str,
    kills: int,
    stages: Sequence[Command],
    files: Sequence[str],
    visible: Callable[[Path], None] = lambda folder: None,
) -> dict[str, Any]:
    """Compare a quiet run with runs that are killed at random times, `kills` times in all.

    Args:
        name: What is killed, for the record.
        kills: How often.
        stages: Work to do one after another; quietly the last alone.
        files: What must be the same bytes.
        visible: Raises if what is visible after a kill is not whole.
    """
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        quiet = Path(scratch) / "quiet"
        quiet.mkdir()
        began = time.perf_counter()
        subprocess.run(stages[-1](quiet), check=True, capture_output=True)
        whole = time.perf_counter() - began
        expected = _sums(quiet, files)
        done = runs = same = 0
        while done < kills:
            folder = Path(scratch) / f"killed-{runs}"
            folder.mkdir()
            for stage in stages:
                finished = False
                while not finished:
                    limit = (
                        float(rng.uniform(0.2, min(whole / 2, LONGEST))) if done < kills else None
                    )
                    finished = _run(stage(folder), limit)
                    done += not finished
                    visible(folder)
            runs += 1
            same += _sums(folder, files) == expected
            print(f"{name}: {done} kills in {runs} runs, {same} as the quiet one", flush=True)
    return {"kills": done, "runs": runs, "same_bytes": same, "quiet_seconds": whole}


def _run(command: list[str], limit: float | None) -> bool:
    """Return whether a command finished; after its time it is killed, children and all.

    Raises:
        RuntimeError: If it fails by itself.
    """
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )
    try:
        _, error = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return False
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} failed after a kill: {error.decode()[-2000:]}")
    return True


def _sums(folder: Path, files: Sequence[str]) -> list[str]:
    return [hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files]
