"""Networks and scenes that several tests share."""

import os
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from mechsearch.camera import Camera, look_at  # noqa: E402
from mechsearch.grasp.network import GraspNetwork, load_network, ready  # noqa: E402


@pytest.fixture(scope="session")
def fcgqcnn_folder():
    """The released network's folder, where there is one."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "fcgqcnn"
    folder = Path(os.environ.get("MECHSEARCH_FCGQCNN", beside))
    if not folder.is_dir():
        pytest.skip("no released weights: set MECHSEARCH_FCGQCNN to their folder to run this test")
    return folder


@pytest.fixture(scope="session")
def released(fcgqcnn_folder):
    return load_network(fcgqcnn_folder / "fc_gqcnn_4_0_pj.npz")


@pytest.fixture(scope="session")
def untrained():
    torch.manual_seed(0)
    return ready(GraspNetwork())


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
