"""Claims about mesh files."""

import numpy as np
import pytest
import trimesh

from mechsearch.objects.meshes.prepare import merge_pieces
from mechsearch.objects.meshes.reading import read_pieces, source_files
from mechsearch.types import MechSearchError

OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_an_obj_names_its_material_and_texture(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd -s 1 1 1 skin.png \nmap_Ks gone.png\n")
    (tmp_path / "skin.png").write_bytes(b"x")
    assert [file.name for file in source_files(tmp_path / "a.obj")] == [
        "a.obj",
        "a.mtl",
        "skin.png",
    ]


def test_other_formats_are_one_file(tmp_path):
    (tmp_path / "a.stl").write_bytes(b"mtllib a.mtl\n")
    assert source_files(tmp_path / "a.stl") == [tmp_path / "a.stl"]


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".glb"])
def test_every_format_gives_the_same_box(tmp_path, suffix):
    path = tmp_path / f"box{suffix}"
    trimesh.creation.box((0.1, 0.2, 0.3)).export(path)
    mesh = merge_pieces(read_pieces(path))
    assert len(mesh.vertices) == 8
    assert mesh.is_volume
    assert mesh.extents == pytest.approx([0.1, 0.2, 0.3])


def test_the_pieces_of_a_scene_keep_their_places(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 0.5):
        placed = trimesh.transformations.translation_matrix((x, 0, 0))
        scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)), transform=placed)
    scene.export(tmp_path / "two.glb")
    pieces = read_pieces(tmp_path / "two.glb")
    assert len(pieces) == 2
    assert merge_pieces(pieces).bounds[:, 0] == pytest.approx([-0.05, 0.55])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.glb", b"glTF nonsense"),
        ("a.stl", b"\x00" * 90),
        ("a.obj", b""),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.obj", b"\xff\xfe\x00binary"),
    ],
)
def test_a_corrupt_mesh_is_named(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MechSearchError, match=name):
        read_pieces(path)


def test_a_missing_mesh_is_named(tmp_path):
    with pytest.raises(MechSearchError, match=r"no mesh at .*gone"):
        read_pieces(tmp_path / "gone.obj")


def test_joining_merges_corners_that_textures_had_split():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.unmerge_vertices()
    assert len(box.vertices) == 36
    mesh = merge_pieces([box])
    assert len(mesh.vertices) == 8
    assert np.isclose(mesh.volume, 0.001)
