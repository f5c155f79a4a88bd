"""Claims about sets from folders, and sets by name."""

import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from mechsearch.objects.catalog import (
    find_meshes,
    load_folder,
    load_object_set,
    read_masses,
    ycb_masses,
)
from mechsearch.objects.meshes import cache, convex
from mechsearch.objects.ycb.download import SCAN
from mechsearch.types import MechSearchError


def write_masses(folder, *rows, header="object,mass_kg"):
    (folder / "masses.csv").write_text("\n".join([header, *rows]) + "\n")


def put(path, sides=(0.06, 0.08, 0.1)):
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(sides).export(path)


@pytest.fixture
def folder(tmp_path):
    """A brick, a plank that is too long, and a cube."""
    put(tmp_path / "brick.obj")
    put(tmp_path / "plank.stl", (0.5, 0.05, 0.02))
    put(tmp_path / "cube.glb", (0.05, 0.05, 0.05))
    write_masses(tmp_path, "brick,0.3", "plank,0.2", "cube,0.1")
    return tmp_path


def test_a_folder_of_meshes_is_a_set_in_order_of_names(folder):
    found = load_folder(folder, workers=1)
    assert list(found.models) == ["brick", "cube"]
    assert found.name == folder.name
    assert found.models["cube"].mass == 0.1
    assert "too large" in found.excluded["plank"]


def test_a_set_is_the_same_from_the_cache_and_for_any_number_of_workers(
    folder, tmp_path_factory, monkeypatch
):
    fresh = load_folder(folder, workers=1).hashes
    assert load_folder(folder, workers=1).hashes == fresh
    monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path_factory.mktemp("other")))
    assert load_folder(folder, workers=2).hashes == fresh


def test_what_is_in_the_cache_is_not_prepared_again(folder, monkeypatch):
    load_folder(folder, workers=1)

    def refuse(*_):
        raise AssertionError("prepared again")

    monkeypatch.setattr("mechsearch.objects.meshes.cache.prepare_into", refuse)
    assert list(load_folder(folder).models) == ["brick", "cube"]


def test_another_mass_is_another_object_without_another_decomposition(
    bracket, tmp_path, monkeypatch
):
    calls = []
    decompose = convex._decompose
    monkeypatch.setattr(convex, "_decompose", lambda *args: calls.append(1) or decompose(*args))
    bracket.export(tmp_path / "bracket.stl")
    write_masses(tmp_path, "bracket,0.1")
    light = load_folder(tmp_path, workers=1).models["bracket"]
    write_masses(tmp_path, "bracket,0.15")
    heavy = load_folder(tmp_path, workers=1).models["bracket"]
    assert len(calls) == 1
    assert (light.mass, heavy.mass) == (0.1, 0.15)
    assert light.content_hash != heavy.content_hash
    np.testing.assert_allclose(heavy.inertia, 1.5 * light.inertia)
    for one, other in zip(light.parts, heavy.parts, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_damaged_decomposition_is_made_again_and_named(bracket, tmp_path, monkeypatch):
    bracket.export(tmp_path / "bracket.stl")
    write_masses(tmp_path, "bracket,0.1")
    cache = tmp_path / "cache"
    monkeypatch.setenv("MECHSEARCH_CACHE", str(cache))
    first = load_folder(tmp_path, workers=1).models["bracket"]
    (kept,) = (cache / "parts").iterdir()
    kept.write_bytes(kept.read_bytes()[:100])
    write_masses(tmp_path, "bracket,0.15")
    with pytest.warns(UserWarning, match="is damaged.*the mesh is decomposed again"):
        again = load_folder(tmp_path, workers=1).models["bracket"]
    for one, other in zip(first.parts, again.parts, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_script_without_a_main_guard_is_told_what_it_needs(folder, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from pathlib import Path\n"
        "from mechsearch.objects.catalog import load_folder\n"
        f"load_folder(Path({str(folder)!r}), workers=2)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "MechSearchError: worker processes do not start" in done.stderr
    assert "needs `if __name__ == '__main__':`" in done.stderr


def test_the_official_layout_takes_published_masses(tmp_path):
    put(tmp_path / "036_wood_block" / SCAN)
    found = load_folder(tmp_path, workers=1)
    assert found.models["036_wood_block"].mass == 0.729
    assert found.models["036_wood_block"].category == "block"


def test_a_table_in_the_folder_goes_before_the_published_one(tmp_path):
    put(tmp_path / "036_wood_block" / SCAN)
    write_masses(tmp_path, "036_wood_block,0.5,plank", header="object,mass_kg,category")
    model = load_folder(tmp_path, workers=1).models["036_wood_block"]
    assert (model.mass, model.category) == (0.5, "plank")


def test_missing_masses_are_one_error_that_names_the_objects(folder):
    write_masses(folder, "brick,0.3")
    with pytest.raises(MechSearchError, match=r"no mass for cube, plank .*masses\.csv"):
        load_folder(folder)


def test_damaged_meshes_are_found_before_any_is_prepared_and_left_out_by_name(folder, monkeypatch):
    (folder / "cube.glb").write_bytes(b"glTF?")
    (folder / "plank.stl").write_bytes(b"\x00" * 90)
    prepare_into, warned = cache.prepare_into, []

    def count(*args):
        warned.append(len(caught))
        return prepare_into(*args)

    monkeypatch.setattr(cache, "prepare_into", count)
    with pytest.warns(UserWarning, match="left out") as caught:
        found = load_folder(folder, workers=1)
    assert [str(one.message).partition(":")[0] for one in caught] == [
        "cube is left out",
        "plank is left out",
    ]
    assert warned == [2]
    assert list(found.models) == ["brick"]
    assert list(found.excluded) == ["cube", "plank"]
    assert "expected 0 triangles" in found.excluded["plank"]


def test_a_set_of_damaged_meshes_alone_is_refused(tmp_path):
    (tmp_path / "cube.glb").write_bytes(b"glTF?")
    write_masses(tmp_path, "cube,0.1")
    with (
        pytest.warns(UserWarning, match="cube is left out"),
        pytest.raises(MechSearchError, match=r"no object .* \(cube: cannot read the mesh"),
    ):
        load_folder(tmp_path, workers=1)


@pytest.mark.parametrize("hidden", ["._brick.obj", ".draft.stl"])
def test_hidden_files_are_no_objects(folder, hidden):
    (folder / hidden).write_bytes(b"Mac OS X")
    assert list(find_meshes(folder)) == ["brick", "cube", "plank"]


def test_names_meet_their_masses_in_either_form_of_accents_and_any_case(tmp_path):
    put(tmp_path / "ta\u0302che.obj")
    put(tmp_path / "Brick.obj")
    write_masses(tmp_path, "t\u00e2che,0.2", "BRICK,0.3")
    models = load_folder(tmp_path, workers=1).models
    assert {name: model.mass for name, model in models.items()} == {"t\u00e2che": 0.2, "Brick": 0.3}


def test_a_name_may_be_as_long_as_a_file_allows(tmp_path):
    name = 236 * "n"
    put(tmp_path / f"{name}.obj")
    write_masses(tmp_path, f"{name},0.2")
    assert list(load_folder(tmp_path, workers=1).models) == [name]


def test_every_texture_that_is_not_there_is_named_again_each_time(folder):
    (folder / "brick.mtl").write_text("newmtl m\nmap_Kd my skin.png\nmap_Ks gone.png\n")
    obj = folder / "brick.obj"
    obj.write_text("mtllib brick.mtl gone.mtl\nusemtl m\n" + obj.read_text())
    for _ in range(2):
        with pytest.warns(UserWarning, match="is without") as caught:
            load_folder(folder, workers=1)
        said = [str(one.message) for one in caught]
        assert len(said) == 2
        assert "brick is without 'my skin.png'" in said[0]
        assert "brick is without 'gone.mtl'" in said[1]


def test_a_missing_folder_a_file_and_an_empty_folder_are_refused(tmp_path):
    with pytest.raises(MechSearchError, match="does not exist; expected"):
        load_folder(tmp_path / "gone")
    (tmp_path / "file").write_text("")
    with pytest.raises(MechSearchError, match="is not a folder; expected"):
        load_folder(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MechSearchError, match="holds no objects; expected YCB objects"):
        load_folder(tmp_path / "empty")


def test_two_meshes_of_one_name_are_refused(tmp_path):
    put(tmp_path / "a.obj")
    put(tmp_path / "a.stl")
    with pytest.raises(MechSearchError, match=r"a\.obj and a\.stl .*'a'"):
        find_meshes(tmp_path)


def test_a_folder_where_nothing_can_lie_in_a_heap_is_refused_with_reasons(tmp_path):
    put(tmp_path / "ship.stl", (60, 80, 100))
    write_masses(tmp_path, "ship,0.3")
    with pytest.raises(MechSearchError, match=r"no object .*ship: too large.*units metres"):
        load_folder(tmp_path, workers=1)


@pytest.mark.parametrize("value", ["heavy", "", "-1", "0", "nan", "inf"])
def test_a_mass_that_is_no_positive_number_is_named(tmp_path, value):
    write_masses(tmp_path, f"brick,{value}")
    with pytest.raises(MechSearchError, match=r"mass of 'brick' is .*positive number of kilograms"):
        read_masses(tmp_path / "masses.csv")


def test_all_bad_rows_are_one_error_that_names_their_lines(tmp_path):
    rows = ["mug,1,35", "", "can,0.3,", "can,0.4", ",0.2", "jar,light", "cup,0.1"]
    write_masses(tmp_path, *rows)
    with pytest.raises(MechSearchError) as error:
        read_masses(tmp_path / "masses.csv")
    _, *faults = re.split(r"line (?=\d+: )", str(error.value))
    assert [fault[:12] for fault in faults] == [
        *("2: 3 cells, ", "5: 'can' aga", "6: no object", "7: the mass "),
    ]
    assert "decimal comma" in faults[0]
    assert "after line 4" in faults[1]


def test_half_a_decimal_number_is_no_category(tmp_path):
    write_masses(tmp_path, "mug,1,35", header="object,mass_kg,category")
    with pytest.raises(MechSearchError, match=r"line 2: 3 cells.*decimal comma"):
        read_masses(tmp_path / "masses.csv")


@pytest.mark.parametrize("comma", [";", "\t"])
def test_decimal_commas_are_understood_where_cells_are_apart_by_something_else(tmp_path, comma):
    table = "object;mass_kg;category\nmug;1,35;cup\ncan;0.5;\n".replace(";", comma)
    (tmp_path / "masses.csv").write_text("\ufeff" + table, encoding="utf-8")
    found = read_masses(tmp_path / "masses.csv")
    assert {name: row[:2] for name, row in found.items()} == {
        "mug": (1.35, "cup"),
        "can": (0.5, ""),
    }


def test_rows_without_a_mesh_are_named_with_their_lines(folder):
    write_masses(folder, "brick,0.3", "brikc,0.3", "plank,0.2", "cube,0.1", "mug,0.1")
    with pytest.warns(UserWarning, match=r"rows without a mesh: brikc \(line 3\), mug \(line 6\)"):
        load_folder(folder, workers=1)


def test_a_row_without_a_category_keeps_the_published_one_and_the_object_its_hash(tmp_path):
    put(tmp_path / "036_wood_block" / SCAN)
    write_masses(tmp_path, "036_wood_block,0.729")
    model = load_folder(tmp_path, workers=1).models["036_wood_block"]
    assert model.category == "block"
    write_masses(tmp_path, "036_wood_block,0.729,object", header="object,mass_kg,category")
    named = load_folder(tmp_path, workers=1).models["036_wood_block"]
    assert (named.category, named.content_hash) == ("object", model.content_hash)


def test_a_table_without_its_columns_is_refused(tmp_path):
    write_masses(tmp_path, "brick,3", header="name,grams")
    with pytest.raises(MechSearchError, match=r"columns name, grams; expected object,mass_kg"):
        read_masses(tmp_path / "masses.csv")
    (tmp_path / "masses.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MechSearchError, match="cannot read the masses"):
        read_masses(tmp_path / "masses.csv")


def test_the_published_table_has_the_masses_of_the_paper():
    table = ycb_masses()
    expected = {
        "002_master_chef_can": 0.414,
        "010_potted_meat_can": 0.370,
        "021_bleach_cleanser": 1.131,
        "025_mug": 0.118,
        "035_power_drill": 0.895,
        "056_tennis_ball": 0.058,
        "077_rubiks_cube": 0.094,
    }
    assert {name: table[name].mass for name in expected} == expected
    assert all(0.0005 < entry.mass < 2 for entry in table.values())


def test_an_unknown_set_is_refused_with_the_choices():
    for name in ("kitchen", 100 * "kitchen"):
        with pytest.raises(MechSearchError, match=f"'{name}'; choose household, ycb, or a folder"):
            load_object_set(name)


def test_ycb_without_a_download_names_both_ways():
    with pytest.raises(MechSearchError, match=r"mechsearch assets pull ycb`, or pass the folder"):
        load_object_set("ycb")


def test_downloaded_ycb_objects_without_a_published_mass_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path))
    put(tmp_path / "ycb" / "036_wood_block" / SCAN)
    put(tmp_path / "ycb" / "999_novelty" / SCAN)
    found = load_object_set("ycb", workers=1)
    assert (found.name, list(found.models)) == ("ycb", ["036_wood_block"])
    assert found.excluded == {"999_novelty": "no published mass"}


def test_places_may_be_given_as_text(folder):
    assert list(find_meshes(str(folder))) == ["brick", "cube", "plank"]
    assert read_masses(str(folder / "masses.csv"))["brick"].mass == 0.3
    assert list(load_folder(str(folder), workers=1).models) == ["brick", "cube"]


def test_a_folder_is_a_set_by_its_path(folder):
    assert list(load_object_set(str(folder), workers=1).models) == ["brick", "cube"]
    assert not any(model.flagged for model in load_object_set(folder).models.values())


def test_real_ycb_objects_make_a_set(ycb, tmp_path, monkeypatch):
    monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path / "cache"))
    for name in ("013_apple", "029_plate", "036_wood_block", "062_dice"):
        shutil.copytree(ycb / name, tmp_path / "some" / name)
    found = load_object_set(tmp_path / "some", workers=1)
    assert list(found.models) == ["013_apple", "036_wood_block"]
    assert list(found.excluded) == ["029_plate", "062_dice"]
