"""Small meshes with known shapes, and the real YCB folder where there is one."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh


def box(sides, centre=(0, 0, 0)):
    return trimesh.creation.box(sides, trimesh.transformations.translation_matrix(centre))


def angle_bracket():
    """Two arms of 10 cm along x and y, 2 cm thick and high; the inner corner at (2, 2) cm."""
    along_x = box((0.1, 0.02, 0.02), (0.05, 0.01, 0.01))
    along_y = box((0.02, 0.08, 0.02), (0.01, 0.06, 0.01))
    return trimesh.util.concatenate([along_x, along_y])


@pytest.fixture
def bracket():
    return angle_bracket()


@pytest.fixture
def cup():
    """An open cup with a wall of 4 mm: radius 40 mm, height 60 mm."""
    profile = [(0, 0), (0.04, 0), (0.04, 0.06), (0.036, 0.06), (0.036, 0.004), (0, 0.004)]
    return trimesh.creation.revolve(np.array(profile), sections=16)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch, request):
    """No test reads or fills the user's cache, but those on real objects."""
    if "ycb" not in request.fixturenames:
        monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="session")
def ycb():
    """A folder of YCB objects: MECHSEARCH_YCB, or shared/ycb beside the repository."""
    beside = Path(__file__).parents[3] / "shared" / "ycb"
    folder = Path(os.environ.get("MECHSEARCH_YCB", beside))
    if not folder.is_dir():
        pytest.skip("no YCB objects; name their folder in MECHSEARCH_YCB")
    return folder
