"""Processes killed at random times and started again, until their work is done."""

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.heaps.dataset import load

MECHSEARCH = (sys.executable, "-m", "mechsearch")


def kill_generation(kills: int) -> dict[str, Any]:
    """Kill `mechsearch heaps generate` again and again; the set must be that of one quiet run."""

    def command(folder: Path) -> list[str]:
        words = ["heaps", "generate", "--heaps", "30", "--seed", "3", "--workers", "2"]
        return [*MECHSEARCH, *words, "--out", str(folder / "heaps.parquet")]

    def visible(folder: Path) -> None:
        path = folder / "heaps.parquet"
        if path.exists():
            load(path)

    return _kill("heaps generate", kills, command, visible, ("heaps.parquet",))


def kill_training(kills: int) -> dict[str, Any]:
    """Kill `mechsearch train` likewise; actor, log and checkpoints must be the same bytes."""
    with tempfile.TemporaryDirectory() as shared:
        heaps = Path(shared) / "heaps.parquet"
        words = ["heaps", "generate", "--heaps", "12", "--counts", "4", "--out", str(heaps)]
        subprocess.run([*MECHSEARCH, *words], check=True, capture_output=True)

        def command(folder: Path) -> list[str]:
            run = folder / "run"
            if (run / "config.json").exists():
                return [*MECHSEARCH, "train", "--resume", str(run)]
            words = ["train", "debug", "--heaps", str(heaps), "--out", str(run)]
            return [*MECHSEARCH, *words, "--actions", "360"]

        return _kill(
            "train", kills, command, lambda _: None, ("run/actor.safetensors", "run/metrics.jsonl")
        )


def _kill(
    name: str,
    kills: int,
    command: Callable[[Path], list[str]],
    visible: Callable[[Path], None],
    files: Sequence[str],
) -> dict[str, Any]:
    """Compare a quiet run with runs that are killed at random times, `kills` times in all."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        quiet = Path(scratch) / "quiet"
        quiet.mkdir()
        began = time.perf_counter()
        subprocess.run(command(quiet), check=True, capture_output=True)
        whole = time.perf_counter() - began
        expected = _sums(quiet, files)
        done = runs = same = 0
        while done < kills:
            folder = Path(scratch) / f"killed-{runs}"
            folder.mkdir()
            finished = False
            while not finished:
                limit = float(rng.uniform(0.2, whole / 2)) if done < kills else None
                finished = _run(command(folder), limit)
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
