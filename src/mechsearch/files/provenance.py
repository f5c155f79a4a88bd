"""What bits depend on besides data and seed: versions, processor, threads."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

PACKAGES = ("mechsearch", "numpy", "scipy", "torch", "mujoco-core", "embreex")


def fingerprint(threads: int = 1) -> dict[str, str]:
    """Return the versions of everything that computes, the processor's kind and the threads.

    Two results with the same fingerprint, data and seed are the same bytes; with others they are
    the same but for rounding.
    """
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    found = {name: _version(name) for name in PACKAGES}
    return found | {
        "python": platform.python_version(),
        "system": platform.system(),
        "processor": platform.machine(),
        "processor model": _model(),
        "vector units": " ".join((*simd["baseline"], *simd.get("found", ()))),
        "threads": str(threads),
    }


def crossed(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return in what two fingerprints differ, in words, such as "torch 2.4.0 instead of 2.3.1"."""
    names = dict.fromkeys((*before, *now))
    return [
        f"{name} {now.get(name, 'not recorded')} instead of {before.get(name, 'not recorded')}"
        for name in names
        if before.get(name) != now.get(name)
    ]


def mixed(found: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return a sentence for each way in which compared results were not computed alike.

    Args:
        found: Fingerprints by the name of the result; the first is what the others are held to.
    """
    reference = next(iter(found.values()), {})
    names: dict[str, list[str]] = {}
    for name, own in found.items():
        differences = ", ".join(crossed(reference, own))
        if differences:
            names.setdefault(differences, []).append(name)
    return [
        f"{', '.join(who)} came about with {differences}, so that this comparison crosses machines "
        "or versions: bits differ by rounding."
        for differences, who in names.items()
    ]


def _model() -> str:
    """Return the processor's maker, family and model: BLAS and libm choose their code by them."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").partition("\n\n")[0].splitlines()
    except OSError:
        return platform.processor() or "unknown"
    told = {name.strip(): value.strip() for name, _, value in (x.partition(":") for x in lines)}
    names = ("vendor_id", "cpu family", "model")
    return " ".join(told[n] for n in names if n in told) or platform.processor() or "unknown"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"
