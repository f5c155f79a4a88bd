"""Actor and critic: one head for each observation key, then two shared layers (paper, III-B, C)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from mechsearch.types import MechSearchError

ACTION_SIZE = 3
Shapes = Mapping[str, tuple[int, ...]]
Tensors = Mapping[str, Tensor]

SHORTEST = 0.2
"""Least length of an action that is a direction with a length; 1 is a whole step."""

CENTROID_GAIN = 8.0
"""What multiplies the mean offset of the visible target [1/m], and the root of its share."""


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes and input scales, alike for actor and critic.

    The paper gives three convolutions of 32 filters and leaves their kernels open. A first stride
    of 4 costs a quarter of three strides of 2 and keeps as many features (8 x 8 x 32 at 64 px).

    Attributes:
        kernels: Kernel sizes of a tower's convolutions [px].
        strides: Their strides [px].
        paddings: Their zero padding [px].
        filters: Channels of every convolution (paper: 32).
        head_units: Width of a head on a vector (paper: 32).
        hidden: Widths of the shared layers (paper: 256, 256).
        layer_norm: Normalise the shared layers before their ReLU, as AC-Teach does.
        output_bound: The last layer starts uniform in plus or minus this (DDPG: 3e-3).
        depth_reference: Depth that the networks see as zero [m]: the table below the camera.
        depth_gain: What multiplies the height above that [1/m].
        offset_gain: What multiplies positions and offsets [1/m].
        directions: An action is a direction, of full length: the actor's output is normalised
            instead of squashed by a tanh along each axis (paper).
        lengths: An action that is a direction has a length too, from a fifth to all of a step,
            which is an output of its own: the mean of opposite directions shortens nothing.
        centroid: Where there is a position image, the mean of its offsets and how many there are
            are one more vector with a head. A tower would have to learn to divide for that.
    """

    kernels: tuple[int, ...] = (6, 3, 3)
    strides: tuple[int, ...] = (4, 2, 1)
    paddings: tuple[int, ...] = (1, 1, 1)
    filters: int = 32
    head_units: int = 32
    hidden: tuple[int, ...] = (256, 256)
    layer_norm: bool = True
    output_bound: float = 3e-3
    depth_reference: float = 1.0
    depth_gain: float = 10.0
    offset_gain: float = 4.0
    directions: bool = False
    lengths: bool = False
    centroid: bool = False

    def __post_init__(self) -> None:
        if self.lengths and not self.directions:
            raise MechSearchError("lengths are those of directions; expected directions with them")
        if not len(self.kernels) == len(self.strides) == len(self.paddings):
            raise MechSearchError(
                f"kernels {self.kernels}, strides {self.strides} and paddings {self.paddings} "
                "must have one number for each convolution"
            )
        if not self.hidden or min(*self.hidden, self.filters, self.head_units) < 1:
            raise MechSearchError("every layer of a network needs at least one unit")


class Scale(nn.Module):
    """Maps a raw observation to `(x - shift) * gain` in float32; the two travel with weights."""

    shift: Tensor
    gain: Tensor

    def __init__(self, shift: float, gain: float) -> None:
        super().__init__()
        self.register_buffer("shift", torch.tensor(shift))
        self.register_buffer("gain", torch.tensor(gain))

    def forward(self, x: Tensor) -> Tensor:
        """Return the scaled observation, of the same shape."""
        scaled = (x.float() - self.shift) * self.gain
        if x.dim() == 4:
            # Otherwise the first convolution turns them round itself, in both its passes.
            scaled = scaled.contiguous(memory_format=torch.channels_last)
        return scaled


def _scale(key: str, config: NetworkConfig) -> Scale:
    known = {
        "depth": (config.depth_reference, -config.depth_gain),
        "rgb": (127.5, 1 / 127.5),
        "target_label": (0.0, 1.0),
        "clutter_mask": (0.0, 1.0),
    }
    return Scale(*known.get(key, (0.0, config.offset_gain)))


def _tower(shape: tuple[int, ...], config: NetworkConfig) -> list[nn.Module]:
    layers: list[nn.Module] = []
    channels, size = shape[0], min(shape[1:])
    for kernel, stride, padding in zip(
        config.kernels, config.strides, config.paddings, strict=True
    ):
        size = (size + 2 * padding - kernel) // stride + 1
        layers += [nn.Conv2d(channels, config.filters, kernel, stride, padding), nn.ReLU()]
        channels = config.filters
    if size < 1:
        raise MechSearchError(f"images of {shape[1]} x {shape[2]} px are too small for the towers")
    return [*layers, nn.Flatten()]


def _head(key: str, shape: tuple[int, ...], config: NetworkConfig) -> nn.Sequential:
    if len(shape) == 3:
        return nn.Sequential(_scale(key, config), *_tower(shape, config))
    width = int(torch.Size(shape).numel())
    dense = nn.Linear(width, config.head_units)
    return nn.Sequential(_scale(key, config), nn.Flatten(), dense, nn.ReLU())


class Centroid(nn.Module):
    """Where the visible target is, and how large it looks, from its position image."""

    def forward(self, position_image: Tensor) -> Tensor:
        """Return mean offsets [m] and the root of the share of pixels (B, 4); 0 where hidden."""
        offsets = position_image.float()
        seen = (offsets.abs().amax(dim=1) > 0).flatten(1)
        count = seen.sum(1).float()
        mean = offsets.sum((2, 3)) / count.clamp_min(1)[:, None]
        return torch.cat([mean, (count / seen.shape[1]).sqrt()[:, None]], dim=1)


class Encoder(nn.Module):
    """A convolutional tower for each image and a dense head for each vector, concatenated."""

    def __init__(self, shapes: Shapes, config: NetworkConfig) -> None:
        super().__init__()
        self.heads = nn.ModuleDict({k: _head(k, tuple(s), config) for k, s in shapes.items()})
        self.centroid: nn.Module | None = None
        if config.centroid and "position_image" in shapes:
            dense = nn.Linear(4, config.head_units)
            scale = Scale(0.0, CENTROID_GAIN)
            self.centroid = nn.Sequential(Centroid(), scale, dense, nn.ReLU())
        with torch.no_grad():
            # As fast convolutions on a CPU want their images.
            self.to(memory_format=torch.channels_last)
            blank = {key: torch.zeros(1, *shape) for key, shape in shapes.items()}
            self.width = self(blank).shape[1]

    def forward(self, obs: Tensors) -> Tensor:
        """Return features (B, width) of a batch of observations (B, *shape) by key."""
        features = [head(obs[key]) for key, head in self.heads.items()]
        if self.centroid is not None:
            features.append(self.centroid(obs["position_image"]))
        return torch.cat(features, dim=1)


class Trunk(nn.Module):
    """Shared dense layers with ReLU; masks may drop the units of each."""

    def __init__(self, width: int, config: NetworkConfig) -> None:
        super().__init__()
        widths = (width, *config.hidden)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.norms = nn.ModuleList(
            nn.LayerNorm(w) if config.layer_norm else nn.Identity() for w in config.hidden
        )

    def forward(self, x: Tensor, masks: Sequence[Tensor] = ()) -> Tensor:
        """Return the last hidden layer (B, hidden), or (K, B, hidden) under K masks a layer."""
        for i, (layer, norm) in enumerate(zip(self.layers, self.norms, strict=True)):
            x = torch.relu(norm(layer(x)))
            if masks:
                x = x * masks[i]
        return x


def _output(width: int, units: int, bound: float) -> nn.Linear:
    layer = nn.Linear(width, units)
    nn.init.uniform_(layer.weight, -bound, bound)
    nn.init.uniform_(layer.bias, -bound, bound)
    return layer


class Actor(nn.Module):
    """The policy: images and end-effector position to an action (paper, section III-B)."""

    def __init__(self, shapes: Shapes, config: NetworkConfig) -> None:
        super().__init__()
        self.shapes = {key: tuple(shape) for key, shape in shapes.items()}
        self.config = config
        self.encoder = Encoder(shapes, config)
        self.trunk = Trunk(self.encoder.width, config)
        units = ACTION_SIZE + config.lengths
        self.output = _output(config.hidden[-1], units, config.output_bound)

    @property
    def keys(self) -> tuple[str, ...]:
        """Observation keys that the actor reads."""
        return tuple(self.shapes)

    def raw(self, obs: Tensors) -> Tensor:
        """Return the last layer's output (B, 3 or 4), which `squash` makes an action."""
        out: Tensor = self.output(self.trunk(self.encoder(obs)))
        return out

    def squash(self, raw: Tensor) -> Tensor:
        """Return actions (B, 3) in [-1, 1] from `raw` output."""
        if not self.config.directions:
            return torch.tanh(raw)
        actions = nn.functional.normalize(raw[:, :ACTION_SIZE], dim=-1)
        if self.config.lengths:
            # Long at first, as most actions of teachers are.
            longer = torch.sigmoid(4 * raw[:, ACTION_SIZE:] + 2)
            actions = actions * (SHORTEST + (1 - SHORTEST) * longer)
        return actions

    def excess(self, raw: Tensor) -> Tensor:
        """Return how far raw output is from where it is best to learn, a mean over the batch."""
        if self.config.directions:
            # The gradient of a direction falls with the length of what is normalised.
            raw = raw[:, :ACTION_SIZE].norm(dim=-1) - 1
        return raw.square().mean()

    def forward(self, obs: Tensors) -> Tensor:
        """Return actions (B, 3) in [-1, 1]; 1 is the longest step along a workspace axis."""
        return self.squash(self.raw(obs))


class Critic(nn.Module):
    """The value of an action; dropout makes it a belief (paper, III-C; AC-Teach).

    Which keys it reads decides what it is: positions alone for the asymmetric critic, the actor's
    own keys (with towers of its own) for the symmetric one.
    """

    def __init__(self, shapes: Shapes, config: NetworkConfig, dropout: float) -> None:
        super().__init__()
        if not 0 <= dropout < 1:
            raise MechSearchError(f"dropout is {dropout}; expected a share in [0, 1)")
        self.shapes = {key: tuple(shape) for key, shape in shapes.items()}
        self.config = config
        self.kept = round(256 * (1 - dropout))
        self.encoder = Encoder(shapes, config)
        self.trunk = Trunk(self.encoder.width + ACTION_SIZE, config)
        self.output = _output(config.hidden[-1], 1, config.output_bound)

    def draw_masks(self, count: int, batch: int, generator: torch.Generator) -> list[Tensor]:
        """Return dropout masks (count, batch, units), one for each hidden layer.

        A kept unit is scaled up to leave the mean as it was. The probability to keep is rounded
        to a 256th: one random byte decides a unit, eight times cheaper than a random float.
        """
        return [self._mask((count, batch, units), generator) for units in self.config.hidden]

    def _mask(self, shape: tuple[int, int, int], generator: torch.Generator) -> Tensor:
        size = shape[0] * shape[1] * shape[2]
        words = torch.empty(-(-size // 8), dtype=torch.int64)
        words.random_(-(2**63), None, generator=generator)
        keep = words.view(torch.uint8)[:size].view(shape) <= self.kept - 1
        return keep.float().mul_(256 / self.kept)

    def encode(self, obs: Tensors) -> Tensor:
        """Return features (B, width): all that comes before the action."""
        features: Tensor = self.encoder(obs)
        return features

    def value(self, features: Tensor, action: Tensor, masks: Sequence[Tensor] = ()) -> Tensor:
        """Return Q (B,) of actions (B, 3), or K samples of it (K, B) under masks."""
        hidden = self.trunk(torch.cat([features, action], dim=1), masks)
        q: Tensor = self.output(hidden).squeeze(-1)
        return q

    def forward(self, obs: Tensors, action: Tensor, masks: Sequence[Tensor] = ()) -> Tensor:
        """Return `value` of actions (B, 3) in observations (B, *shape)."""
        return self.value(self.encode(obs), action, masks)
