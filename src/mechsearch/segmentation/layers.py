"""Layers of the segmentation network, and how networks of this room are asked."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

COLOUR_CHANNELS = 6
"""Channels of `colours_of`."""


class Residual(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.one, self.two = (
            Convolution(channels, channels),
            Convolution(channels, channels, act=False),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, C, H, W) as large as those given."""
        return torch.relu(x + self.two(self.one(x)))


class Convolution(nn.Module):
    """A convolution, its normalisation and a rectifier."""

    def __init__(
        self, before: int, after: int, side: int = 3, stride: int = 1, act: bool = True
    ) -> None:
        super().__init__()
        self.conv = nn.Conv2d(before, after, side, stride, side // 2, bias=False)
        self.norm: nn.BatchNorm2d | nn.Identity = nn.BatchNorm2d(after)
        self.act = act

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, after, H / stride, W / stride) of those given (B, before, H, W)."""
        x = self.norm(self.conv(x))
        return torch.relu(x) if self.act else x

    def fold(self) -> None:
        """Have the convolution normalise as well; nothing is learnt afterwards."""
        if isinstance(self.norm, nn.BatchNorm2d):
            self.conv, self.norm = fuse_conv_bn_eval(self.conv, self.norm), nn.Identity()


def colours_of(seen: Tensor) -> Tensor:
    """Return colours (B, 6, H, W) of what is seen (B, 6, H, W): as they are, and by their sum."""
    rgb = seen[:, :3]
    sums = (rgb + 0.5).sum(1, keepdim=True)
    return torch.cat([rgb, 4 * (rgb + 0.5) / (sums + 0.1) - 4 / 3], dim=1)


def doubled(x: Tensor) -> Tensor:
    """Return features (B, C, 2 H, 2 W), each pixel repeated."""
    return functional.interpolate(x, scale_factor=2, mode="nearest")


@contextmanager
def asked_alike() -> Iterator[None]:
    """Ask a network with one thread: another number of them gives other bits."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(threads)
