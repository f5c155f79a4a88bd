"""Claims about the split of a mesh into convex parts."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from mechsearch.objects.meshes import convex
from mechsearch.objects.meshes.convex import MOST_PARTS, convex_parts, single_hull
from mechsearch.objects.meshes.hull import HULL_VERTICES
from mechsearch.types import MechSearchError


def inside(parts, point):
    planes = [ConvexHull(part).equations for part in parts]
    return any((face[:, :3] @ point + face[:, 3] <= 0).all() for face in planes)


def test_a_box_is_one_hull():
    box = trimesh.creation.box((0.05, 0.1, 0.2))
    found = convex_parts(box, box)
    assert len(found.parts) == 1
    assert found.error < 1e-6
    assert found.remark == ""


def test_an_angle_is_split_into_arms_the_same_each_time(bracket):
    found, again = (convex_parts(bracket, bracket) for _ in range(2))
    assert 2 <= len(found.parts) <= MOST_PARTS
    assert found.error < 0.005
    assert not inside(found.parts, np.array([0.04, 0.04, 0.01]))
    assert all(np.array_equal(a, b) for a, b in zip(found.parts, again.parts, strict=True))


def test_a_cup_stays_open_and_keeps_its_walls(cup):
    found = convex_parts(cup, cup)
    assert 1 < len(found.parts) <= MOST_PARTS
    assert all(len(part) <= HULL_VERTICES for part in found.parts)
    assert not any(inside(found.parts, np.array([0, 0, z])) for z in (0.02, 0.04, 0.058))
    assert inside(found.parts, np.array([0, 0, 0.002]))
    assert found.error < single_hull(cup).error / 3


def test_a_split_that_takes_too_long_leaves_one_hull_and_says_so(bracket):
    found = convex_parts(bracket, bracket, time_limit=0.01)
    assert len(found.parts) == 1
    assert found.remark == "no decomposition in 0.01 s"
    assert found.error > 0.03


def test_a_split_that_crashes_leaves_one_hull_and_says_so(bracket, tmp_path, monkeypatch):
    crash = tmp_path / "crash.py"
    crash.write_text("import os\nos.abort()\n")
    monkeypatch.setattr(convex, "_SCRIPT", crash)
    found = convex_parts(bracket, bracket)
    assert len(found.parts) == 1
    assert "decomposition failed" in found.remark


def test_a_flat_mesh_is_refused():
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(MechSearchError, match="flat"):
        single_hull(sheet)
