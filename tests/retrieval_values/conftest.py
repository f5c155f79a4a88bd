"""Whatever learns to retrieve needs PyTorch."""

import pytest

pytest.importorskip("torch")
