"""Scenes that several tests share."""

import numpy as np
import pytest

from mechsearch.camera import Camera, look_at

pytest.importorskip("torch")


@pytest.fixture
def overhead():
    """A small camera, 0.8 m above the table."""
    return Camera(160, 120, 552.5, 552.5, 79.5, 59.5, look_at((0, 0, 0.8), (0, 0, 0), (0, 1, 0)))


@pytest.fixture
def bumpy():
    """A depth image of a table at 0.8 m with some boxes."""
    rng = np.random.default_rng(0)
    depth = np.full((120, 160), 0.8, np.float32)
    for _ in range(12):
        r, c = rng.integers(0, 100), rng.integers(0, 140)
        depth[r : r + 20, c : c + 15] = rng.uniform(0.7, 0.78)
    return depth
