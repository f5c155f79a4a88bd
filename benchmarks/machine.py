"""Where figures are measured, without names of machines."""

import os
import platform
import resource
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = {"mujoco-core": "MuJoCo", "embreex": "embreex", "torch": "PyTorch"}


def describe() -> str:
    """Return processor, cores, memory and versions."""
    parts = [_processor(), f"{cores()} cores", f"{_memory():.0f} GB"]
    parts.append(f"Python {platform.python_version()}")
    for package, title in _PACKAGES.items():
        try:
            parts.append(f"{title} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(parts)


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def peak_memory() -> float:
    """Return the most memory that this process has held [MB]."""
    status = Path("/proc/self/status")
    if status.is_file():
        # A new process inherits its parent's peak in `getrusage`, and not here.
        line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return float(line.split()[1]) / 1e3
    # Kilobytes on most systems, bytes on macOS.
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    if facts.is_file():
        for line in facts.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
