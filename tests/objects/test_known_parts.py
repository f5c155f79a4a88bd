from pathlib import Path

import numpy as np
import pytest

from mechsearch.objects.meshes import convex
from mechsearch.objects.meshes.convex import ConvexParts
from mechsearch.objects.meshes.hull import hull_error
from mechsearch.objects.meshes.prepare import merge_pieces, read_pieces

YCB = Path(__file__).parents[2].parent / "shared" / "ycb"
NAMES = ("024_bowl", "011_banana", "073-b_lego_duplo")


@pytest.mark.parametrize("name", NAMES)
def test_the_parts_of_a_ycb_scan_are_known_and_as_close_to_it_as_they_say(name):
    mesh = YCB / name / "google_16k" / "textured.obj"
    if not mesh.is_file():
        pytest.skip(f"no YCB objects at {YCB.name}")
    known = convex.known_parts()[convex.parts_key(mesh)]
    assert 1 <= len(known.parts) <= convex.MOST_PARTS
    measured = hull_error(merge_pieces(read_pieces(mesh)), list(known.parts))
    assert measured == pytest.approx(known.error, abs=5e-4)


def test_a_mesh_that_differs_in_one_byte_is_unknown(tmp_path):
    mesh = tmp_path / "textured.obj"
    mesh.write_text("v 0 0 0\n")
    first = convex.parts_key(mesh)
    assert first not in convex.known_parts()
    mesh.write_text("v 0 0 1\n")
    assert convex.parts_key(mesh) != first


def test_other_settings_of_the_decomposition_need_other_parts(tmp_path, monkeypatch):
    mesh = tmp_path / "textured.obj"
    mesh.write_text("v 0 0 0\n")
    before = convex.parts_key(mesh)
    monkeypatch.setattr(convex, "THRESHOLD", 0.05)
    assert convex.parts_key(mesh) != before


def test_a_table_holds_what_was_written(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    clouds = [rng.random((n, 3)).astype(np.float32).astype(float) for n in (4, 7, 5)]
    found = {
        "a": ConvexParts((clouds[0],), 0.001, ""),
        "b": ConvexParts((clouds[1], clouds[2]), 0.002, ""),
    }
    convex.write_table(tmp_path / "parts.npz", found)
    monkeypatch.setattr(convex, "KNOWN", tmp_path / "parts.npz")
    table = convex.known_parts.__wrapped__()
    assert {key: one.error for key, one in table.items()} == {"a": 0.001, "b": 0.002}
    for key, one in found.items():
        for part, expected in zip(table[key].parts, one.parts, strict=True):
            np.testing.assert_array_equal(part, expected)
