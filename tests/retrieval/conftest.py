"""What gets targets into the gripper needs PyTorch."""

import pytest

pytest.importorskip("torch")
