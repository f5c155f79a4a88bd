"""Claims about prepared objects: centred, light, of the right mass and colour."""

import numpy as np
import pytest
import trimesh

from mechsearch.objects.meshes.prepare import MOST_FACES, Source, prepare, simplified
from mechsearch.objects.meshes.texels import colour_of_name
from mechsearch.objects.model import FRICTION
from mechsearch.objects.ycb.download import SCAN
from mechsearch.types import MechSearchError


def source(path, mesh, mass=0.2, name="thing"):
    mesh.export(path)
    return Source(name, "box", path, mass)


def middle(points):
    return (points.min(axis=0) + points.max(axis=0)) / 2


def test_a_box_far_from_the_origin_is_centred_and_has_the_inertia_of_the_textbook(tmp_path):
    box = trimesh.creation.box((0.06, 0.08, 0.1))
    box.apply_translation((1, 2, 3))
    done = prepare(source(tmp_path / "a.stl", box))
    model = done.model
    assert done.excluded == done.remark == ""
    assert np.ptp(model.vertices, axis=0) == pytest.approx([0.06, 0.08, 0.1], abs=1e-6)
    assert model.vertices.min(axis=0) == pytest.approx([-0.03, -0.04, -0.05], abs=1e-6)
    expected = np.array([0.08**2 + 0.1**2, 0.06**2 + 0.1**2, 0.06**2 + 0.08**2]) * 0.2 / 12
    assert model.inertia == pytest.approx(np.diag(expected), abs=1e-9)
    assert (model.mass, model.friction) == (0.2, FRICTION)
    assert len(model.parts) == 1
    assert model.hull_error < 1e-5
    assert model.radius == pytest.approx(np.sqrt(0.03**2 + 0.04**2 + 0.05**2), abs=1e-6)


def test_the_mesh_and_the_parts_move_together(tmp_path):
    ball = trimesh.creation.icosphere(4, radius=0.04)
    ball.apply_translation((0.3, 0, 0))
    model = prepare(source(tmp_path / "a.stl", ball)).model
    assert middle(model.vertices) == pytest.approx([0, 0, 0], abs=1e-3)
    assert middle(model.parts[0]) == pytest.approx([0, 0, 0], abs=3e-3)


def test_an_open_mesh_is_weighed_by_its_hull(tmp_path):
    box = trimesh.creation.box((0.06, 0.06, 0.06)).subdivide().subdivide().subdivide()
    box.update_faces(np.arange(len(box.faces)) > 0)
    assert not box.is_volume
    model = prepare(source(tmp_path / "a.stl", box)).model
    assert model.inertia == pytest.approx(np.eye(3) * 0.2 * 0.06**2 / 6, rel=1e-4, abs=1e-9)


def test_a_fine_mesh_keeps_its_shape_in_at_most_1500_faces():
    ball = trimesh.creation.icosphere(5, radius=0.04)
    vertices, faces = simplified(ball)
    assert len(ball.faces) > MOST_FACES >= len(faces) > 1000
    slim = trimesh.Trimesh(vertices, faces)
    assert slim.is_volume
    assert slim.volume == pytest.approx(ball.volume, rel=0.01)


def test_a_coarse_mesh_is_cut_finer_without_a_change_of_shape():
    box = trimesh.creation.box((0.06, 0.08, 0.1))
    vertices, faces = simplified(box)
    assert len(faces) == 12 * 4**3
    fine = trimesh.Trimesh(vertices, faces)
    assert fine.volume == pytest.approx(box.volume)
    assert fine.area == pytest.approx(box.area)


def test_preparation_gives_the_same_object_each_time(tmp_path):
    ball = trimesh.creation.icosphere(4, radius=0.04)
    given = source(tmp_path / "a.stl", ball)
    assert prepare(given).model.content_hash == prepare(given).model.content_hash


def test_mass_decides_the_content_hash(tmp_path):
    box = trimesh.creation.box((0.06, 0.08, 0.1))
    light, heavy = (prepare(source(tmp_path / "a.stl", box, mass)).model for mass in (0.2, 0.3))
    assert light.content_hash != heavy.content_hash


def test_an_object_without_colours_has_that_of_its_name(tmp_path):
    model = prepare(source(tmp_path / "a.stl", trimesh.creation.box((0.06, 0.08, 0.1)))).model
    assert (model.texels == colour_of_name("thing")).all()


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf")])
def test_a_mass_that_is_none_is_refused(tmp_path, mass):
    with pytest.raises(MechSearchError, match="mass of thing"):
        prepare(source(tmp_path / "a.stl", trimesh.creation.box((0.1, 0.1, 0.1)), mass))


def test_a_flat_mesh_is_refused_by_name(tmp_path):
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(MechSearchError, match=r"cannot prepare thing from .*flat"):
        prepare(source(tmp_path / "a.obj", sheet))


@pytest.mark.parametrize(
    ("sides", "mass", "reason"),
    [
        ((0.3, 0.05, 0.05), 0.2, "too large: 0.3 x 0.05 x 0.05 m"),
        ((0.2, 0.18, 0.02), 0.2, "too large"),
        ((0.2, 0.16, 0.15), 1.0, "too large"),
        ((60, 80, 100), 0.2, "are its units metres"),
        ((0.02, 0.02, 0.02), 0.02, "too small: 0.02 x 0.02 x 0.02 m"),
        ((0.05, 0.05, 0.05), 0.002, "too light: 2 g"),
        ((0.06, 0.08, 0.1), 414.0, "does not fit its volume of 480 cm3"),
        ((0.16, 0.16, 0.14), 0.01, "does not fit its volume"),
    ],
)
def test_objects_that_cannot_lie_in_a_heap_come_with_the_reason(tmp_path, sides, mass, reason):
    assert reason in prepare(source(tmp_path / "a.stl", trimesh.creation.box(sides), mass)).excluded


@pytest.mark.parametrize(
    ("name", "hulls"), [("003_cracker_box", 3), ("013_apple", 1), ("036_wood_block", 1)]
)
def test_ycb_objects_are_light_centred_and_close_to_their_scan(ycb, name, hulls):
    done = prepare(Source(name, "", ycb / name / SCAN, 0.3))
    model = done.model
    assert done.excluded == ""
    assert len(model.faces) <= MOST_FACES
    assert len(model.parts) <= hulls
    assert model.hull_error < 0.01
    assert np.abs(middle(model.vertices)).max() < 0.01
    assert np.linalg.eigvalsh(model.inertia).min() > 0


def test_an_apple_is_red_and_a_sugar_box_partly_yellow(ycb):
    apple = prepare(Source("013_apple", "", ycb / "013_apple" / SCAN, 0.068)).model
    red, green, blue = apple.texels.reshape(-1, 3).mean(axis=0)
    assert red > 2 * green
    assert red > 2 * blue
