"""`heaps-per-second-5`, `-10`, `-15`: accepted heaps on one core, beside the peer's."""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import peer_drop
from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.heaps.generate import GenerateConfig, generate

PEER = "the same drop in PyBullet 3.2.7"


def measure(settings: Settings) -> Iterator[Figure]:
    """Time our generator and the peer's drops, count by count."""
    number = 60 if settings.full else 20
    for count in (5, 10, 15):
        config = GenerateConfig(
            heaps=number, objects=settings.workload.objects, counts=(count,), seed=11
        )
        seconds = _time_ours(config)
        settings.say(f"heaps-per-second-{count}: {number} heaps in {seconds:.1f} s")
        dropped, accepted, theirs = _time_peer(settings, config, count)
        settings.say(f"  PyBullet: {dropped} drops, {accepted} heaps in {theirs:.1f} s")
        name, note = f"heaps-per-second-{count}", f"{accepted} of the peer's {dropped} accepted"
        ours = number / seconds
        yield Figure(name, ours, "heaps/s", PEER, accepted / theirs, "more", note)


def _time_ours(config: GenerateConfig) -> float:
    with tempfile.TemporaryDirectory() as folder:
        generate(replace(config, heaps=1), Path(folder) / "warm.parquet")
        began = time.perf_counter()
        generate(config, Path(folder) / "heaps.parquet")
        return time.perf_counter() - began


def _time_peer(settings: Settings, config: GenerateConfig, count: int) -> tuple[int, int, float]:
    """Return drops, accepted heaps and seconds of about half a minute's work."""
    objects, rng = settings.workload.object_set, np.random.default_rng(config.seed)
    limit = 90.0 if settings.full else 25.0
    peer_drop.attempt(config, objects, count, rng)
    dropped, accepted = 0, 0
    began = time.perf_counter()
    while accepted < config.heaps and time.perf_counter() - began < limit:
        accepted += peer_drop.attempt(config, objects, count, rng)
        dropped += 1
    return dropped, accepted, time.perf_counter() - began
