"""Variants of objects, of other proportions and colours: many more for training to see."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.model import TEXEL_ROWS, ObjectModel, texel_weights

_STRETCH, _GROWTH = 0.2, 0.2
"""Std of the logarithm of how much each axis, and the whole, is stretched."""

_LONGEST, _SHORTEST = 0.32, 0.025
"""Greatest and least diagonal of a variant [m]: what still lies in a heap."""


def variant(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """Return an object like another one, stretched, with its colours changed or painted anew.

    It is only to be seen: what physics reads of it stays the other's.
    """
    stretch = np.exp(_STRETCH * rng.standard_normal(3) + _GROWTH * rng.standard_normal())
    vertices = model.vertices * stretch
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    vertices = vertices * (np.clip(diagonal, _SHORTEST, _LONGEST) / diagonal)
    texels = _tinted(model.texels, rng) if rng.random() < 0.4 else _painted(vertices, model, rng)
    return replace(model, vertices=vertices, texels=texels, content_hash="variant")


def _tinted(texels: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return colours whose channels are mixed, and which are lighter or darker, as paler ones."""
    mix = np.eye(3)[rng.permutation(3)] + 0.15 * rng.standard_normal((3, 3))
    found = texels @ mix.T * rng.uniform(0.6, 1.2) + rng.uniform(-25, 25)
    return np.asarray(np.clip(found, 0, 255), np.uint8)


def _painted(
    vertices: NDArray[np.float64], model: ObjectModel, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return texels (F, T, 3) of a pattern in space: plain, bands, spots, or a label around."""
    points = np.einsum("tk,fkd->ftd", texel_weights(TEXEL_ROWS, 1 / 3), vertices[model.faces])
    palette = (
        rng.uniform(20, 255, (4, 3))
        if rng.random() < 0.75
        else rng.uniform(20, 255, (4, 1)) * [1, 1, 1]
    )
    size = np.ptp(vertices, axis=0).max()
    kind = rng.integers(5)
    which = np.zeros(points.shape[:2], np.intp)
    if kind == 1:
        wave = points @ _direction(rng) * (2 * np.pi * rng.uniform(0.7, 4.0) / size)
        which = (np.sin(wave + rng.uniform(0, 6)) > rng.uniform(-0.7, 0.7)).astype(np.intp)
    elif kind >= 2:
        field = np.zeros(points.shape[:2])
        for _ in range(5):
            wave = points @ _direction(rng) * (2 * np.pi * rng.uniform(0.5, 3.5) / size)
            field += np.sin(wave + rng.uniform(0, 6))
        which = np.digitize(field, np.sort(rng.normal(0, 1.2, kind - 1)))
    if rng.random() < 0.5:
        along = points @ _direction(rng) / size
        middle = rng.uniform(-0.4, 0.4)
        which[np.abs(along - middle) < rng.uniform(0.05, 0.25)] = 3
    found = palette[which] + 4 * rng.standard_normal(points.shape)
    return np.asarray(np.clip(found, 0, 255), np.uint8)


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    found = rng.standard_normal(3)
    return np.asarray(found / np.linalg.norm(found))
