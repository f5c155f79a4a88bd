"""Which objects can lie in a heap, and why the others cannot."""

from collections.abc import Callable

import numpy as np
import trimesh

from mechsearch.types import Floats

LONGEST = 0.26
SECOND_LONGEST = 0.17
LARGEST_BOX = 0.004
"""Longest sides [m] and largest bounding box [m^3] of an object in a heap."""

SHORTEST = 0.03
"""An object with no side longer than this [m] is too small to see and to push."""

LIGHTEST = 0.005
"""Contacts with neighbours a hundred times heavier than this [kg] become unstable."""

DENSITY = (20.0, 20_000.0)
"""Mass over hull volume [kg/m^3] that an object may have; outside, mass or scale is wrong."""

FLAGGED_ERROR = 0.005
"""Distance between mesh and convex parts [m] above which an object is flagged, not excluded."""

GROSS_ERROR = 0.02
"""Largest distance between mesh and convex parts [m] that physics can do with."""

DEFORMABLE = {"059_chain": "deformable: a chain"}
"""Objects that are not rigid, by name."""


_oriented_bounds: Callable[..., tuple[Floats, Floats]] = trimesh.bounds.oriented_bounds


def sides(points: Floats) -> Floats:
    """Return the sides (3,) [m] of the smallest box about points (N, 3), longest first."""
    _, extents = _oriented_bounds(points)
    return np.sort(extents)[::-1]


def why_wrong_size(name: str, points: Floats) -> str:
    """Return why a mesh (N, 3) [m] is too large, too small or not rigid, or an empty string."""
    if name in DEFORMABLE:
        return DEFORMABLE[name]
    longest, second, third = sides(points)
    measured = f"{longest:.3g} x {second:.3g} x {third:.3g} m"
    if longest > LONGEST or second > SECOND_LONGEST or longest * second * third > LARGEST_BOX:
        hint = "; are its units metres?" if longest > 2 else ""
        return f"too large: {measured}{hint}"
    if longest < SHORTEST:
        return f"too small: {measured}"
    return ""


def why_wrong_mass(mass: float, volume: float) -> str:
    """Return why a mass [kg] does not fit a volume [m^3], or an empty string."""
    if mass < LIGHTEST:
        return f"too light: {1000 * mass:.3g} g"
    density = mass / volume
    if not DENSITY[0] <= density <= DENSITY[1]:
        return (
            f"its mass of {mass:.4g} kg does not fit its volume of {1e6 * volume:.4g} cm3 "
            f"({density:.3g} kg/m3)"
        )
    return ""


def why_wrong_shape(error: float, remark: str) -> str:
    """Return why convex parts with this error [m] cannot stand for a mesh, or an empty string."""
    if error > GROSS_ERROR:
        cause = f" ({remark})" if remark else ""
        return f"its convex parts are up to {1000 * error:.0f} mm from its mesh{cause}"
    return ""
