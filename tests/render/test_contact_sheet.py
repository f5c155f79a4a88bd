import dataclasses

import numpy as np
import pytest
from PIL import Image

from mechsearch.camera import Camera, look_at
from mechsearch.objects.assembly import assemble
from mechsearch.objects.household import household
from mechsearch.objects.model import ObjectSet
from mechsearch.objects.paint import band, layers
from mechsearch.objects.primitives import box
from mechsearch.render.body import Body
from mechsearch.render.contact_sheet import contact_sheet, draw_sheet, portrait
from mechsearch.render.renderer import Renderer
from mechsearch.types import MechSearchError

MODELS = household().models
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def few(count, excluded=None):
    return ObjectSet("few", dict(list(MODELS.items())[:count]), excluded or {})


@pytest.mark.parametrize("name", MODELS)
def test_portrait_shows_the_whole_object(name):
    picture = portrait(MODELS[name], 96).astype(int)
    drawn = (np.abs(picture - [240, 240, 238]) > 3).any(axis=2)
    rows, columns = np.nonzero(drawn)
    extent = max(np.ptp(rows), np.ptp(columns))
    assert 0.8 * 96 < extent < 96
    assert not drawn[[0, -1]].any()
    assert not drawn[:, [0, -1]].any()


@pytest.mark.parametrize("name", MODELS)
def test_no_face_seen_from_outside_is_inside_out(name):
    model = MODELS[name]
    corners = model.vertices[model.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    aims = corners[np.random.default_rng(0).integers(len(corners), size=300)].mean(axis=1)
    body = Body(model)
    for eye in np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.6, 0.6]]]):
        directions = (aims - eye).astype(np.float32)
        hits = body.cast(eye, directions, np.eye(3, dtype=np.float32))
        met = hits.triangle >= 0
        towards = np.einsum("nd,nd->n", normals[hits.triangle[met]], directions[met])
        assert met.sum() > 290
        assert (towards < 0).mean() > 0.98


def test_colours_are_seen_where_they_were_painted():
    paint = layers("0000ff", (band("x", 0.01, 1.0), "ff0000"), (band("y", -1.0, -0.02), "00ff00"))
    model = assemble("flag", "block", 1.0, [box(0.1, 0.1, 0.02).painted(paint)])
    camera = Camera(64, 64, 500, 500, 31.5, 31.5, look_at((0, 0, 1.0), (0, 0, 0), (0, 1, 0)))
    frame = Renderer([model]).frame(camera, np.array([[0, 0, 0.01, *UPRIGHT]]), colour=True)
    points = camera.back_project(frame.depth)
    top = (frame.ids == 0) & (points[..., 2] > 0.019)
    sure = np.minimum(np.abs(points[..., 0] - 0.01), np.abs(points[..., 1] + 0.02)) > 0.004
    expected = np.where(points[..., 1] < -0.02, 1, np.where(points[..., 0] > 0.01, 0, 2))
    assert (top & sure).sum() > 1000
    assert (frame.rgb.argmax(axis=2) == expected)[top & sure].all()


def test_sheet_is_a_png_with_a_tile_for_every_object(tmp_path):
    path = tmp_path / "new" / "sheet.png"
    contact_sheet(few(5), path, columns=3, size=96)
    with Image.open(path) as image:
        assert image.format == "PNG"
        pixels = np.asarray(image.convert("RGB")).astype(int)
    vivid = np.ptp(pixels, axis=2) > 40
    width = pixels.shape[1] // 3
    half = pixels.shape[0] // 2
    counts = [
        vivid[row * half : (row + 1) * half, column * width : (column + 1) * width].sum()
        for row in range(2)
        for column in range(3)
    ]
    assert min(counts[:5]) > 100
    assert counts[5] == 0


def test_excluded_objects_are_listed_below():
    reasons = {"chain": "deformable", "plate": "too large: " + "very " * 40 + "large"}
    without, listed = draw_sheet(few(2), 2, 96), draw_sheet(few(2, reasons), 2, 96)
    assert listed.height > without.height + 60
    footer = np.asarray(listed.convert("L"))[without.height :]
    assert (footer < 128).any()


def test_large_hull_error_is_written_in_red():
    model = dataclasses.replace(
        MODELS["sponge"], hull_error=0.0061, texels=np.full_like(MODELS["sponge"].texels, 100)
    )
    sheet = np.asarray(draw_sheet(ObjectSet("bad", {"sponge": model}, {}), 1, 160)).astype(int)
    assert ((sheet[..., 0] - sheet[..., 1]) > 100).any()


def test_set_without_objects_still_makes_a_sheet():
    assert draw_sheet(ObjectSet("none", {}, {"chain": "deformable"}), 8, 96).height > 0


@pytest.mark.parametrize(("columns", "size"), [(0, 160), (8, 10), (-1, 160)])
def test_impossible_layouts_are_refused(tmp_path, columns, size):
    with pytest.raises(MechSearchError, match=f"{columns} columns of {size} px"):
        contact_sheet(few(1), tmp_path / "sheet.png", columns, size)
    assert not list(tmp_path.iterdir())


def test_only_png_names_are_taken(tmp_path):
    with pytest.raises(MechSearchError, match=r"expected a name in \.png"):
        contact_sheet(few(1), tmp_path / "sheet.jpg")
