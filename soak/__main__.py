"""Run all long tests, or some: `python -m soak actions generation training sweep mutants`."""

import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from benchmarks import machine
from benchmarks.workload import find_workload
from soak.actions import soak
from soak.kills import kill_generation, kill_sweep, kill_training
from soak.mutants import mutate

RESULTS = Path(__file__).with_name("results.json")
KILLS = 30
TESTS = {
    "actions": lambda: soak(find_workload(), 100_000, 1000),
    "generation": lambda: kill_generation(KILLS),
    "training": lambda: kill_training(KILLS),
    "sweep": lambda: kill_sweep(KILLS),
    "mutants": mutate,
}


def main() -> None:
    """Run the tests that are named, and keep their figures."""
    names = sys.argv[1:] or list(TESTS)
    unknown = [name for name in names if name not in TESTS]
    if unknown:
        raise SystemExit(f"unknown {unknown[0]!r}; choose among {', '.join(TESTS)}")
    for name in names:
        found = {**TESTS[name](), "machine": machine.describe()}
        # Read late: another test may have ended meanwhile.
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        results[name] = found
        RESULTS.write_text(json.dumps(results, indent=2) + "\n")
        print(json.dumps({name: results[name]}, indent=2))


if __name__ == "__main__":
    main()
