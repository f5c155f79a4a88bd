"""How likely a grasp succeeds, seen in the gripper's own frame: a patch of the height map."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mechsearch.files.tensors import Archive, fill, load_archive, save_archive
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grasp.grasp_view import HeightMap
from mechsearch.grasp.network import ready
from mechsearch.sim import Gripper, SuctionCup, gripper_named
from mechsearch.types import Array, Floats, MechSearchError

GRASP_NUMBERS = 6
"""How many numbers a grasp has beside its patch."""


@dataclass(frozen=True)
class PatchGrid:
    """The cells of a patch, about the grasp centre.

    Attributes:
        rows: Cells along the gripper's y axis.
        columns: Cells along its x axis, the closing direction.
        cell: Side of a cell [m].
    """

    rows: int
    columns: int
    cell: float

    @property
    def square(self) -> bool:
        """Whether both sides are alike."""
        return self.rows == self.columns


JAWS_GRID, SUCTION_GRID = PatchGrid(32, 64, 0.002), PatchGrid(32, 32, 0.002)


@dataclass(frozen=True, eq=False)
class Aligned:
    """What is seen of grasps (K,), each in its gripper's own frame.

    Attributes:
        relative: How far what is seen rises over the plane of the gripper's x and y axes (K, R, C)
            float32 [m].
        target: Whether it is the target (K, R, C).
        numbers: (K, 6) float32: height of the grasp centre over the table [m]; x and y of the
            vertical in the gripper's frame; x and y of the middle of the target's visible part
            [m]; square root of that part's area [m].
    """

    relative: NDArray[np.float32]
    target: NDArray[np.bool_]
    numbers: NDArray[np.float32]


def grid_of(gripper: Gripper | SuctionCup) -> PatchGrid:
    """Return the cells of a gripper's patches."""
    return JAWS_GRID if isinstance(gripper, Gripper) else SUCTION_GRID


def aligned(heights: HeightMap, poses: Floats, grid: PatchGrid) -> Aligned:
    """Return what is seen of grasps (K, 7) in a height map."""
    rotation = rotation_from_quaternion(poses[:, 3:])
    axes, centre = rotation.astype(np.float32), poses[:, :3].astype(np.float32)
    v, u = (
        ((np.arange(count) - (count - 1) / 2) * grid.cell).astype(np.float32)
        for count in (grid.rows, grid.columns)
    )
    x, y, z = (
        centre[:, i, None, None]
        + axes[:, i, 0, None, None] * u
        + axes[:, i, 1, None, None] * v[:, None]
        for i in range(3)
    )
    cells = heights.cells(x, y)
    relative = (heights.height.ravel()[cells] - z) * axes[:, 2, 2, None, None]
    own = heights.place(np.flatnonzero(heights.target))
    middle = np.array([*own.mean(axis=0), 0.0]) - poses[:, :3]
    middle[:, 2] = 0.0
    offset = (middle[:, :, None] * rotation).sum(axis=1)
    numbers = np.column_stack([
        poses[:, 2], rotation[:, 2, :2], offset[:, :2],
        np.full(len(poses), heights.cell * np.sqrt(len(own))),
    ])  # fmt: skip
    return Aligned(relative, heights.target.ravel()[cells], numbers.astype(np.float32))


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
