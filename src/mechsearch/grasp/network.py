"""FC-GQ-CNN: one convolutional network that rates parallel-jaw grasps all over a depth image.

The architecture is that of Satish, Mahler and Goldberg (2019), 633,200 parameters. What it sees is
a depth image minus the gripper's depth; what it says is, for 16 closing directions around every
fourth pixel, how likely a grasp there succeeds.
"""

from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from mechsearch.files import read_arrays
from mechsearch.files.tensors import Archive, fill, load_archive, save_archive
from mechsearch.grippers import ANGLES
from mechsearch.types import Array, MechSearchError

Network = TypeVar("Network", bound=nn.Module)

_KIND = "mechsearch grasp network"
_CONVOLUTIONS = ("conv1_1", "conv1_2", "conv2_1", "conv2_2", "fc3", "fc4", "fc5")

SHIPPED_GRASP_NETWORK = Path(__file__).with_name("parallel_jaw.safetensors")
"""The network that is used unless another is named; `parallel_jaw.json` is its card."""


class GraspNetwork(nn.Module):
    """The network; see the module's text."""

    mean: Tensor
    std: Tensor

    def __init__(self, mean: float = 0.0101, std: float = 0.05) -> None:
        """Initialise weights as Kaiming does.

        Args:
            mean: Of image depth minus gripper depth over the training set [m].
            std: Likewise its standard deviation [m].
        """
        super().__init__()
        self.register_buffer("mean", torch.tensor(mean))
        self.register_buffer("std", torch.tensor(std))
        self.conv1_1 = nn.Conv2d(1, 16, 9)
        self.conv1_2 = nn.Conv2d(16, 16, 5)
        self.conv2_1 = nn.Conv2d(16, 16, 5)
        self.conv2_2 = nn.Conv2d(16, 16, 5)
        self.fc3 = nn.Conv2d(16, 128, 17)
        self.fc4 = nn.Conv2d(128, 128, 1)
        self.fc5 = nn.Conv2d(128, 2 * ANGLES, 1)
        self.pool = nn.MaxPool2d(2, 2, ceil_mode=True)
        for name in _CONVOLUTIONS:
            nn.init.kaiming_normal_(self.get_parameter(f"{name}.weight"), nonlinearity="relu")
            nn.init.zeros_(self.get_parameter(f"{name}.bias"))

    def forward(self, relative: Tensor) -> Tensor:
        """Return logits of failure and success (B, 16, 2, (H - 96) / 4 + 1, (W - 96) / 4 + 1).

        Args:
            relative: Depth minus gripper depth (B, 1, H, W) [m].
        """
        x = torch.relu(self.conv1_1((relative - self.mean) / self.std))
        x = self.pool(torch.relu(self.conv1_2(x)))
        x = torch.relu(self.conv2_1(x))
        x = self.pool(torch.relu(self.conv2_2(x)))
        x = torch.relu(self.fc4(torch.relu(self.fc3(x))))
        logits: Tensor = self.fc5(x)
        return logits.reshape(-1, ANGLES, 2, *logits.shape[2:])

    @torch.inference_mode()
    def quality(self, image: Tensor, depths: Tensor) -> Tensor:
        """Return the quality (D, 16, h, w) in [0, 1] of grasps all over an image.

        Args:
            image: Depth (H, W) [m]; both sides are 96 plus a multiple of 4.
            depths: Of the gripper (D,) [m].
        """
        relative = image[None, None] - depths[:, None, None, None]
        # Half the time of the default layout, on a CPU.
        logits = self(relative.contiguous(memory_format=torch.channels_last))
        return torch.sigmoid(logits[:, :, 1] - logits[:, :, 0])


def load_network(path: Path | None = None) -> GraspNetwork:
    """Return a network from its file: this project's (.safetensors), or a released one (.npz).

    Args:
        path: None takes the shipped network.

    Raises:
        MechSearchError: If the file is missing, damaged, or holds another network.
    """
    path = path or SHIPPED_GRASP_NETWORK
    if path.suffix == ".npz":
        return _from_release(path)
    network = GraspNetwork()
    fill(network, load_archive(path, _KIND).tensors)
    return ready(network)


def ready(network: Network) -> Network:
    """Return the network itself, laid out for quick inference."""
    network.to(memory_format=torch.channels_last)
    return network.eval()


def save_network(path: Path, network: GraspNetwork, meta: dict[str, object]) -> None:
    """Write a network, whole or not at all."""
    save_archive(path, Archive(_KIND, network.state_dict(), meta))


def _from_release(path: Path) -> GraspNetwork:
    if not path.is_file():
        raise MechSearchError(
            f"no network at {path}; expected a .safetensors file of this project, or the released "
            "FC-GQCNN-4.0-PJ weights as .npz"
        )
    arrays, network = read_arrays(path, "released network"), GraspNetwork()
    try:
        network.load_state_dict(_renamed(arrays, network.state_dict()))
    except (ValueError, KeyError, RuntimeError) as error:
        raise MechSearchError(
            f"{path} does not hold the released FC-GQCNN-4.0-PJ weights: {error}"
        ) from None
    return ready(network)


def _renamed(arrays: dict[str, Array], blank: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return released tensors, kept as (height, width, in, out), named and laid out as `blank`."""
    state = {
        "mean": torch.tensor(float(arrays["im_depth_sub_mean"])),
        "std": torch.tensor(float(arrays["im_depth_sub_std"])),
    }
    for layer in _CONVOLUTIONS:
        out, into, height, width = blank[f"{layer}.weight"].shape
        weights = arrays[f"{layer}_weights"].reshape(height, width, into, out)
        state[f"{layer}.weight"] = torch.from_numpy(weights.transpose(3, 2, 0, 1).copy())
        state[f"{layer}.bias"] = torch.from_numpy(arrays[f"{layer}_bias"].copy())
    return state
