import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.pushes.push import Sight


@pytest.fixture(scope="session")
def camera():
    return preset("overhead", 64)


@pytest.fixture
def env(covered, boxes):
    return HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))


@pytest.fixture
def sight(camera):
    """A target of 4 cm height in the middle, an obstacle beside it, the end effector apart."""
    heights = np.zeros((64, 64))
    target = np.zeros((64, 64), bool)
    target[30:34, 30:34] = True
    heights[target], heights[30:34, 40:44] = 0.04, 0.08
    centre, ee = np.array([0.0, 0.0, 0.04]), np.array([-0.25, 0.1, 0.1])
    return Sight(heights, target, centre, np.array([[0.1, 0.0, 0.08]]), ee, camera)
