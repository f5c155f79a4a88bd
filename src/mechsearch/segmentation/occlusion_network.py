"""The network that estimates how much of an object is hidden; see `occlusion`."""

from collections.abc import Mapping, Sequence
from math import exp
from pathlib import Path

import torch
from torch import Tensor, nn

from mechsearch.files.tensors import Archive, fill, load_archive, save_archive
from mechsearch.segmentation.layers import asked_alike
from mechsearch.segmentation.occlusion import PATCH_CHANNELS, PATCH_NUMBERS, PATCH_SIDE, Occlusion
from mechsearch.types import Array

_KIND = "mechsearch occlusion network"

_SHIPPED = Path(__file__).with_name("occlusion.safetensors")

_WIDE = 32
"""Channels, but for the first convolution's."""


class OcclusionNetwork(nn.Module):
    """Sees a patch and numbers; says whether an object is uncovered, and how much is hidden."""

    mean: Tensor
    deviation: Tensor

    def __init__(self) -> None:
        """Initialise weights at random."""
        super().__init__()
        half = _WIDE // 2
        self.patch = nn.Sequential(
            nn.Conv2d(PATCH_CHANNELS, half, 3, 1, 1), nn.ReLU(),
            nn.Conv2d(half, _WIDE, 4, 2, 1), nn.ReLU(),
            nn.Conv2d(_WIDE, _WIDE, 3, 1, 1), nn.ReLU(),
            nn.Conv2d(_WIDE, _WIDE, 4, 2, 1), nn.ReLU(),
            nn.Conv2d(_WIDE, _WIDE, 4, 2, 1), nn.ReLU(),
            nn.Flatten(), nn.Dropout(0.2),
        )  # fmt: skip
        self.joined = nn.Sequential(
            nn.Linear(_WIDE * (PATCH_SIDE // 8) ** 2 + PATCH_NUMBERS, 64), nn.ReLU(),
            nn.Dropout(0.2), nn.Linear(64, 2),
        )  # fmt: skip
        self.register_buffer("mean", torch.zeros(PATCH_NUMBERS))
        self.register_buffer("deviation", torch.ones(PATCH_NUMBERS))

    def forward(self, patch: Tensor, numbers: Tensor) -> Tensor:
        """Return logits (B, 2) of being uncovered and of the share hidden."""
        scaled = (numbers - self.mean) / self.deviation
        found: Tensor = self.joined(torch.cat([self.patch(patch), scaled], dim=1))
        return found

    def scale(self, numbers: Tensor) -> None:
        """Take mean and standard deviation of numbers (n, 5) as those of what will come."""
        self.mean.copy_(numbers.mean(0))
        self.deviation.copy_(numbers.std(0).clamp(min=1e-3))


class NetworkEstimator:
    """Estimates occlusion by a network; an `OcclusionEstimator`."""

    def __init__(self, network: OcclusionNetwork, calibration: Sequence[float]) -> None:
        """Take a network, and the factor and offset of its logit of being uncovered."""
        self._network = network.eval()
        self._factor, self._offset = calibration

    def estimate(self, patch: Array, numbers: Array) -> Occlusion:
        """Return what is believed of an object; see `OcclusionEstimator`."""
        with asked_alike():
            seen = torch.from_numpy(patch)[None], torch.from_numpy(numbers)[None]
            uncovered, hidden = self._network(*seen)[0].tolist()
        return Occlusion(_chance(hidden), _chance(self._factor * uncovered + self._offset))


def _chance(logit: float) -> float:
    return 1 / (1 + exp(-min(max(logit, -30.0), 30.0)))


def network_estimator(path: Path | None = None) -> NetworkEstimator:
    """Return the estimator that a network is; None takes the one that comes with the package.

    Raises:
        MechSearchError: If the file is missing, damaged or of another network.
    """
    archive = load_archive(path or _SHIPPED, _KIND)
    network = OcclusionNetwork()
    fill(network, archive.tensors)
    return NetworkEstimator(network.requires_grad_(False), archive.meta["calibration"])


def save_occlusion_network(
    path: Path, network: OcclusionNetwork, calibration: Sequence[float], meta: Mapping[str, object]
) -> None:
    """Write a network, its weights in 16 bits, whole or not at all.

    Args:
        path: The file.
        network: To write.
        calibration: Factor and offset of its logit of being uncovered.
        meta: Plain JSON about it.
    """
    tensors = {k: v.half() for k, v in network.state_dict().items()}
    save_archive(path, Archive(_KIND, tensors, {**meta, "calibration": list(calibration)}))
