"""Claims about a corpus of small mesh files, as people bring them: read right, or refused."""

import csv
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mechsearch.objects.meshes.prepare import merge_pieces
from mechsearch.objects.meshes.reading import (
    SUFFIXES,
    ears,
    missing_files,
    read_pieces,
    source_files,
)
from mechsearch.objects.meshes.texels import bake_texels
from mechsearch.types import MechSearchError

CORPUS = Path(__file__).parents[1] / "corpus" / "meshes"


def expected(kind):
    with (CORPUS / "expected.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if bool(row["refused"]) == (kind == "bad")]
    return [pytest.param(row, id=row["file"]) for row in rows]


def newell(path):
    """Area [m^2] and volume [m^3] of an OBJ of plane faces, without triangles.

    A second reader: the vector area of a plane polygon is half the sum of the cross products along
    its border, whatever its shape, and its cone from the origin has a third of base times height.
    """
    text = path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    words = [line.partition("#")[0].split() for line in text.replace("\\\n", " ").split("\n")]
    points = [[float(x) for x in line[1:4]] for line in words if line[:1] == ["v"]]
    area = volume = seen = 0.0
    for line in words:
        seen += line[:1] == ["v"]
        if line[:1] == ["f"]:
            found = [int(word.split("/")[0]) for word in line[1:]]
            corners = np.array([points[k - 1 if k > 0 else int(seen) + k] for k in found])
            vector = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0) / 2
            area += float(np.linalg.norm(vector))
            volume += float(vector @ corners[0]) / 3
    return area, volume


def test_every_mesh_of_the_corpus_has_its_outcome():
    meshes = {path.name for path in CORPUS.iterdir() if path.suffix in SUFFIXES}
    assert meshes == {param.id for kind in ("good", "bad") for param in expected(kind)}


@pytest.mark.parametrize("row", expected("good"))
def test_a_good_file_is_the_closed_surface_it_should_be(row):
    path = CORPUS / row["file"]
    pieces = read_pieces(path)
    mesh = merge_pieces(pieces)
    assert mesh.is_volume
    assert mesh.area == pytest.approx(1e-4 * float(row["area_cm2"]))
    assert mesh.volume == pytest.approx(1e-6 * float(row["volume_cm3"]))
    if path.suffix == ".obj":
        assert newell(path) == pytest.approx((mesh.area, mesh.volume))
    if row["colour"]:
        texels = bake_texels(mesh.vertices, mesh.faces, pieces, "name", 3, 500)
        colours = np.unique(texels.reshape(-1, 3), axis=0)
        assert " ".join(map(str, colours.ravel())) == row["colour"]
    beside = [file.relative_to(CORPUS).as_posix() for file in source_files(path)[1:]]
    assert (" + ".join(beside), " + ".join(missing_files(path))) == (row["beside"], row["missing"])


@pytest.mark.parametrize("row", expected("bad"))
def test_a_bad_file_is_refused_by_name_and_place(row):
    with pytest.raises(MechSearchError) as error:
        read_pieces(CORPUS / row["file"])
    assert row["file"] in str(error.value)
    assert row["refused"] in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["quads", "triangles", "normals", "colours", "name-with-spaces"])
def test_what_a_general_reader_reads_right_has_the_same_corners_in_the_same_order(name):
    path = CORPUS / f"{name}.obj"
    (ours,) = read_pieces(path)
    (theirs,) = trimesh.load_scene(path, process=False).dump()
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)


@pytest.mark.parametrize("forms", [("t\u00e2che", "ta\u0302che"), ("ta\u0302che", "t\u00e2che")])
def test_a_texture_is_found_in_either_form_of_accents(tmp_path, forms):
    named, there = forms
    text = (CORPUS / "name-with-spaces.obj").read_text().replace("name with spaces", named)
    (tmp_path / "a.obj").write_text(text, encoding="utf-8")
    (tmp_path / f"{there}.mtl").write_text(f"newmtl skin\nmap_Kd {named}.png\n", encoding="utf-8")
    (tmp_path / f"{there}.png").write_bytes((CORPUS / "red skin.png").read_bytes())
    assert missing_files(tmp_path / "a.obj") == []
    (piece,) = read_pieces(tmp_path / "a.obj")
    assert piece.visual.material.image.getpixel((0, 0)) == (200, 30, 40)


@pytest.mark.parametrize("seed", range(20))
def test_ears_fill_a_star_of_any_corners(seed):
    """Seen from the origin the corners go round once, so the area is a sum of thin triangles."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 30))
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.9, count)) / count
    points = rng.uniform(0.05, 1, (count, 1)) * np.stack([np.cos(angles), np.sin(angles)], 1)
    after = np.roll(points, -1, axis=0)
    area = float((points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum()) / 2
    triangles = points[ears(points)]
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.det(sides) / 2
    assert len(triangles) == count - 2
    assert areas.min() > -1e-9
    assert areas.sum() == pytest.approx(area)
