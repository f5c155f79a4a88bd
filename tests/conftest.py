"""Objects and heaps that most tests share."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mechsearch.heaps.dataset import Heap
from mechsearch.objects.model import ObjectModel, ObjectSet


def box_model(name, sides, mass=0.1):
    box = trimesh.creation.box(sides)
    a, b, c = np.square(sides)
    return ObjectModel(
        name,
        "box",
        np.array(box.vertices),
        box.faces.astype(np.int32),
        np.full((12, 1, 3), 180, np.uint8),
        (np.array(box.vertices),),
        mass,
        np.diag([b + c, a + c, a + b]) * mass / 12,
        0.5,
        0.0,
        name,
    )


@pytest.fixture(scope="session")
def make_box():
    """Makes a box of a name, sides [m] and a mass [kg]."""
    return box_model


@pytest.fixture(scope="session")
def boxes():
    """A 10 cm plate, an 8 cm lid, a 6 cm cube, and small cubes."""
    models = [
        box_model("plate", (0.1, 0.1, 0.02)),
        box_model("lid", (0.08, 0.08, 0.02)),
        box_model("cube", (0.06, 0.06, 0.06)),
        *[box_model(f"small{i}", (0.03, 0.03, 0.03), 0.05) for i in range(4)],
    ]
    return ObjectSet("boxes", {model.name: model for model in models}, {})


def pose(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="session")
def covered(boxes):
    """A cube, three quarters hidden under a lid that lies flat on it, and a small cube apart."""
    del boxes
    poses = np.array([pose(0, 0, 0.03), pose(0.025, 0, 0.07), pose(0.15, 0.1, 0.015)])
    return Heap(("cube", "lid", "small0"), poses, 0, 0.75, 1234, 3, "single", False)


@pytest.fixture(scope="session")
def ycb_folder():
    """The real objects' folder, where there is one."""
    return _folder("ycb", "MECHSEARCH_YCB", "YCB objects")


@pytest.fixture(scope="session")
def fcgqcnn_folder():
    """The released network's folder, where there is one."""
    return _folder("fcgqcnn", "MECHSEARCH_FCGQCNN", "released weights")


def _folder(name, variable, what):
    folder = Path(os.environ.get(variable, Path(__file__).resolve().parents[2] / "shared" / name))
    if not folder.is_dir():
        pytest.skip(f"no {what}: set {variable} to their folder to run this test")
    return folder


@pytest.fixture(scope="session")
def released(fcgqcnn_folder):
    """The released network, where it is."""
    from mechsearch.grasp.network import load_network

    return load_network(fcgqcnn_folder / "fc_gqcnn_4_0_pj.npz")


@pytest.fixture(scope="session")
def untrained():
    """A grasp network that knows nothing."""
    import torch

    from mechsearch.grasp.network import GraspNetwork, ready

    torch.manual_seed(0)
    return ready(GraspNetwork())
