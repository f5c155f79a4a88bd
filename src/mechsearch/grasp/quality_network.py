"""How likely a grasp succeeds, seen in the gripper's own frame: a patch of the height map."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mechsearch.files.tensors import Archive, fill, load_archive, save_archive
from mechsearch.grasp.network import ready
from mechsearch.grippers import (
    GRASP_NUMBERS,
    GRIPPERS,
    Aligned,
    PatchGrid,
    grid_of,
    gripper_named,
)
from mechsearch.types import Array, Floats, MechSearchError

_KIND = "mechsearch grasp quality network"

_RANGES = ((0.08, 0.04), (0.012, 0.004))
"""How far over or under the grasp anything is told apart [m], and what becomes 1: once from afar,
once closely, as millimetres decide about a seal or a finger's way."""

_NUMBER_SCALES = (0.05, 0.5, 0.5, 0.05, 0.05, 0.1)
"""What becomes 1, of the numbers of `Aligned`."""


class QualityNetwork(nn.Module):
    """A small convolutional network over aligned patches."""

    scales: Tensor

    def __init__(self, gripper: str) -> None:
        """Initialise weights as Kaiming does.

        Args:
            gripper: Whose grasps it rates, by name.

        Raises:
            MechSearchError: If there is no such gripper.
        """
        super().__init__()
        self.gripper = gripper
        self.grid: PatchGrid = grid_of(gripper_named(gripper))
        self.register_buffer("scales", torch.tensor(_NUMBER_SCALES), persistent=False)
        self.conv1 = nn.Conv2d(1 + len(_RANGES), 24, 5, stride=2, padding=2)
        self.conv2 = nn.Conv2d(24, 48, 3, stride=2, padding=1)
        self.conv3 = nn.Conv2d(48, 64, 3, padding=1)
        self.conv4 = nn.Conv2d(64, 64, 3, stride=2, padding=1)
        cells = (self.grid.rows // 8) * (self.grid.columns // 8)
        self.full1 = nn.Linear(64 * cells + GRASP_NUMBERS, 128)
        self.full2 = nn.Linear(128, 64)
        self.full3 = nn.Linear(64, 1)
        for name, weight in self.named_parameters():
            if name.endswith("weight"):
                nn.init.kaiming_normal_(weight, nonlinearity="relu")
            else:
                nn.init.zeros_(weight)

    def forward(self, relative: Tensor, target: Tensor, numbers: Tensor) -> Tensor:
        """Return logits of success (K,); see `Aligned` for what is given."""
        heights = [relative.clamp(-far, far) / scale for far, scale in _RANGES]
        x = torch.stack([*heights, target.to(relative.dtype)], dim=1)
        x = x.contiguous(memory_format=torch.channels_last)
        for layer in (self.conv1, self.conv2, self.conv3, self.conv4):
            x = torch.relu(layer(x))
        x = torch.cat([x.flatten(1), numbers / self.scales], dim=1)
        logits: Tensor = self.full3(torch.relu(self.full2(torch.relu(self.full1(x)))))
        return logits[:, 0]

    @torch.inference_mode()
    def quality(self, seen: Aligned) -> Floats:
        """Return the chance of success (K,) in [0, 1] of grasps."""
        arrays = (seen.relative, seen.target, seen.numbers)
        logits = self(*(torch.from_numpy(np.ascontiguousarray(a)) for a in arrays))
        return np.asarray(torch.sigmoid(logits).double().numpy())


class _Quality(nn.Module):
    """What a network says, as a chance."""

    def __init__(self, network: QualityNetwork) -> None:
        """Take the network."""
        super().__init__()
        self.network = network

    def forward(self, relative: Tensor, target: Tensor, numbers: Tensor) -> Tensor:
        """Return the chance of success (K,); see `Aligned` for what is given."""
        return torch.sigmoid(self.network(relative, target, numbers))


def quality_to_export(spec: str) -> tuple[str, nn.Module, tuple[Tensor, ...], dict[str, Any]]:
    """Return what `training.export` writes: whose grasps it rates, the network, inputs, its facts.

    Args:
        spec: A gripper, whose shipped network it is, or a network's file.

    Raises:
        MechSearchError: If there is neither, or the file is damaged or of another version.
    """
    shipped = spec in GRIPPERS
    path = quality_file(spec) if shipped else Path(spec)
    if not shipped and not path.is_file():
        raise MechSearchError(
            f"no gripper {spec!r}, and no network's file there; choose one of "
            f"{', '.join(GRIPPERS)}, or a file that `mechsearch grasp train --gripper` wrote"
        )
    meta = load_archive(path, _KIND).meta
    gripper = str(meta["gripper"])
    network = load_quality_network(gripper, path)
    rows, columns = network.grid.rows, network.grid.columns
    patches = torch.zeros(2, rows, columns)
    inputs = (patches, patches.bool(), torch.zeros(2, GRASP_NUMBERS))
    return gripper, _Quality(network), inputs, dict(meta)


def quality_file(gripper: str) -> Path:
    """Return the file of a gripper's shipped network."""
    return Path(__file__).with_name(f"{gripper}.safetensors")


def load_quality_network(gripper: str, path: Path | None = None) -> QualityNetwork:
    """Return the network of a gripper.

    Args:
        gripper: By name.
        path: Its file; None takes the shipped one.

    Raises:
        MechSearchError: If there is no such gripper, or the file is missing, damaged, or of
            another gripper or version.
    """
    network = QualityNetwork(gripper)
    path = path or quality_file(gripper)
    archive = load_archive(path, _KIND)
    found = archive.meta.get("gripper")
    if found != gripper:
        raise MechSearchError(f"{path} is a network of the gripper {found!r}; expected {gripper!r}")
    fill(network, archive.tensors)
    return ready(network)


def save_quality_network(path: Path, network: QualityNetwork, meta: dict[str, object]) -> None:
    """Write a network, whole or not at all."""
    whole = {**meta, "gripper": network.gripper}
    save_archive(path, Archive(_KIND, network.state_dict(), whole))


def mirrored(
    relative: Array, target: Array, numbers: Array, symmetry: NDArray[np.integer]
) -> tuple[Array, Array, Array]:
    """Return what grasps look like mirrored; see `Aligned` for what is given and returned.

    Args:
        relative: (K, R, C).
        target: (K, R, C).
        numbers: (K, 6).
        symmetry: Which (K,): 1 mirrors the x axis, 2 the y axis, 4 swaps both, which only square
            patches bear.
    """
    images, values = [relative.copy(), target.copy()], numbers.copy()
    for bit, axis, signed in ((1, 2, [1, 3]), (2, 1, [2, 4])):
        own = np.flatnonzero(symmetry & bit)
        for image in images:
            image[own] = np.flip(image[own], axis)
        values[own[:, None], signed] *= -1
    own = np.flatnonzero(symmetry & 4)
    for image in images:
        if len(own):
            image[own] = image[own].transpose(0, 2, 1)
    values[own] = values[own][:, [0, 2, 1, 4, 3, 5]]
    return images[0], images[1], values
