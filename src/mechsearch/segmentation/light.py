"""Light, table and camera as they differ from place to place: of training images, drawn."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom


def direction(rng: np.random.Generator, widest: float) -> NDArray[np.float64]:
    """Return a direction (3,) at most so far from the vertical [rad]."""
    away, around = rng.uniform(0, widest), rng.uniform(0, 2 * np.pi)
    return np.array([*np.sin(away) * np.array([np.cos(around), np.sin(around)]), np.cos(away)])


def in_other_light(
    rgb: NDArray[np.uint8], table: NDArray[np.bool_], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) on another table (H, W), in another light, by another camera."""
    image = rgb.astype(np.float64)
    if rng.random() < 0.8:
        colour = np.clip(rng.uniform(30, 235) + rng.normal(0, 25, 3), 0, 255)
        coarse = rng.normal(0, rng.uniform(0, 25), (*rng.integers(2, 24, 2), 1))
        size = [len(rgb) / side for side in coarse.shape[:2]]
        texture = zoom(
            coarse, (*size, 1), order=int(rng.integers(2)), grid_mode=True, mode="nearest"
        )
        image[table] = (colour + texture)[table]
    balance = rng.uniform(0.65, 1.25) * np.exp(rng.normal(0, 0.06, 3))
    slope = np.linspace(-1, 1, len(rgb)) * rng.normal(0, 0.12)
    image *= balance * (1 + slope)[:, None, None] * (1 + rng.choice([-1, 1]) * slope)[:, None]
    image = 255 * (np.clip(image, 0, 255) / 255) ** rng.uniform(0.8, 1.25)
    image += rng.uniform(0, 6) * rng.standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)
