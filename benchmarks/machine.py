"""Where figures are measured, without names of machines."""

import os
import platform
import resource
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


def memory() -> float:
    """Return the memory that this process holds now [MB], or on macOS the most it has held."""
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(row for row in status.read_text().splitlines() if row.startswith("VmRSS"))
        return float(line.split()[1]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    if facts.is_file():
        for line in facts.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
