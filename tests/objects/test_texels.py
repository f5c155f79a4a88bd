"""Claims about colours: those of the original surface, where they were."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from mechsearch.objects.meshes.texels import bake_texels, colour_of_name
from mechsearch.objects.model import texel_weights

RED, BLUE = [200, 0, 0, 255], [0, 0, 200, 255]


def bake(mesh, rows=4, name="thing"):
    vertices, faces = np.array(mesh.vertices), mesh.faces.astype(np.int32)
    return bake_texels(vertices, faces, [mesh], name, rows, 20_000)


@pytest.mark.parametrize("rows", [1, 2, 3, 6])
def test_the_grid_has_its_samples_inside_the_triangle(rows):
    grid = texel_weights(rows, 1 / 3)
    assert len(grid) == rows * (rows + 1) // 2
    assert (grid >= 0).all()
    assert grid.sum(axis=1) == pytest.approx(1)


def test_the_grid_runs_along_the_third_corner_first():
    thirds = texel_weights(2, 1 / 3) * 6
    assert thirds == pytest.approx(np.array([[4, 1, 1], [1, 1, 4], [1, 4, 1]]))


@pytest.mark.parametrize("rows", [1, 2, 5, 6])
def test_cell_i_j_stands_where_the_object_model_says(rows):
    grid = texel_weights(rows, 1 / 3)
    for i in range(rows):
        for j in range(rows - i):
            index = i * rows - i * (i - 1) // 2 + j
            assert grid[index, 1:] == pytest.approx([(i + 1 / 3) / rows, (j + 1 / 3) / rows])


def test_face_colours_stay_on_their_faces():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    top = box.face_normals[:, 2] > 0.5
    box.visual.face_colors = np.where(top[:, None], RED, BLUE)
    middles = bake(box, rows=4)[:, 5]
    assert texel_weights(4, 1 / 3)[5] == pytest.approx([1 / 3] * 3, abs=0.1)
    assert (middles[top] == RED[:3]).all()
    assert (middles[~top] == BLUE[:3]).all()


def test_vertex_colours_are_mixed_between_corners():
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    mesh.visual.vertex_colors = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]]
    texels = bake(mesh, rows=4)[0].astype(float)
    assert texels == pytest.approx(texel_weights(4, 1 / 3) * 255, abs=8)


def textured_square(image):
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    mesh.visual = TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], image=image)
    return mesh


def test_a_texture_has_its_first_row_at_the_top_and_first_column_at_the_left():
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0], pixels[0, 1], pixels[1, 0], pixels[1, 1] = (
        [255, 0, 0],
        [0, 255, 0],
        [0, 0, 255],
        [90, 90, 90],
    )
    texels = bake(textured_square(Image.fromarray(pixels)), rows=6)
    mesh = textured_square(None)
    points = np.einsum("tk,fkd->ftd", texel_weights(6, 1 / 3), mesh.triangles)
    for texel, (x, y, _) in zip(texels.reshape(-1, 3), points.reshape(-1, 3), strict=True):
        assert texel.tolist() == pixels[int(y < 0.5), int(x >= 0.5)].tolist() or (
            min(abs(x - 0.5), abs(y - 0.5)) < 0.02
        )


def test_a_mesh_without_colours_has_one_that_depends_on_its_name_alone():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    texels = bake(box, name="spam")
    assert texels.shape == (12, 1, 3)
    assert (texels == colour_of_name("spam")).all()
    assert colour_of_name("spam").tolist() != colour_of_name("eggs").tolist()


def test_baking_is_the_same_each_time():
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    first, second = (bake(textured_square(Image.fromarray(noise))) for _ in range(2))
    assert (first == second).all()
