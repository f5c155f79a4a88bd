"""Claims about object files: whole, checked, and found again by content."""

import importlib.util
import warnings
from functools import partial

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mechsearch.files import cache_folder
from mechsearch.objects.meshes import cache, convex, prepare
from mechsearch.objects.meshes.cache import (
    cache_key,
    cached,
    model_from_npz,
    model_to_npz,
    prepare_into,
)
from mechsearch.objects.meshes.prepare import Source
from mechsearch.objects.model import ObjectModel
from mechsearch.types import MechSearchError


@pytest.fixture
def block(tmp_path):
    path = tmp_path / "block.obj"
    trimesh.creation.box((0.06, 0.08, 0.1)).export(path)
    return Source("block", "box", path, 0.2)


def equal(one: ObjectModel, other: ObjectModel):
    for name in ObjectModel.__dataclass_fields__:
        a, b = getattr(one, name), getattr(other, name)
        pairs = zip(a, b, strict=True) if name == "parts" else [(a, b)]
        assert all(np.array_equal(x, y) for x, y in pairs), name
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype


def test_a_model_comes_back_from_its_file_as_it_was(block, tmp_path):
    model = prepare.prepare(block).model
    model_to_npz(tmp_path / "a.npz", model, "too dear")
    back, remark = model_from_npz(tmp_path / "a.npz")
    equal(model, back)
    assert remark == "too dear"


def test_the_same_model_gives_the_same_bytes(block, tmp_path):
    for name in ("a.npz", "b.npz"):
        model_to_npz(tmp_path / name, prepare.prepare(block).model)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    trimesh.creation.box((0.06, 0.08, 0.1)).export(folder / "a.stl")
    model = prepare.prepare(Source("block", "box", folder / "a.stl", 0.2)).model
    model_to_npz(folder / "a.npz", model)
    return model, (folder / "a.npz").read_bytes(), folder / "flipped.npz"


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_detected_or_harmless(sound, place, bit):
    model, body, path = sound
    at = int(place * len(body))
    path.write_bytes(body[:at] + bytes([body[at] ^ (1 << bit)]) + body[at + 1 :])
    try:
        back, _ = model_from_npz(path)
    except MechSearchError as error:
        assert "flipped.npz is damaged" in str(error)  # noqa: PT017
    else:
        equal(model, back)


@pytest.mark.parametrize("body", [b"", b"PK\x03\x04", b"not a zip"])
def test_a_file_that_is_no_archive_is_damaged(tmp_path, body):
    (tmp_path / "a.npz").write_bytes(body)
    with pytest.raises(MechSearchError, match=r"a\.npz is damaged"):
        model_from_npz(tmp_path / "a.npz")


def test_altered_arrays_do_not_match_their_checksum(block, tmp_path):
    path = tmp_path / "a.npz"
    model_to_npz(path, prepare.prepare(block).model)
    with np.load(path) as file:
        arrays = dict(file)
    arrays["scalars"][0] *= 2
    np.savez(path, **arrays)
    with pytest.raises(MechSearchError, match="checksum differs"):
        model_from_npz(path)


def test_a_damaged_cache_file_is_named_in_a_warning_and_removed(block, tmp_path):
    path = tmp_path / "kept.npz"
    prepare_into(block, path)
    body = bytearray(path.read_bytes())
    body[len(body) // 2] ^= 4
    path.write_bytes(body)
    with pytest.warns(UserWarning, match=r"kept\.npz is damaged.*prepared again"):
        assert cached(path) is None
    assert not path.exists()


def test_a_sound_cache_file_is_read_without_a_warning(block, tmp_path):
    prepare_into(block, tmp_path / "kept.npz")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cached(tmp_path / "kept.npz").model.name == "block"
    assert cached(tmp_path / "other.npz") is None


def test_the_environment_names_the_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("MECHSEARCH_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("MECHSEARCH_CACHE")
    assert cache_folder().name == "mechsearch"


def test_the_key_depends_on_content_and_settings_but_not_on_place(block, tmp_path, monkeypatch):
    key = cache_key(block)
    copy = tmp_path / "copy.obj"
    copy.write_bytes(block.mesh.read_bytes())
    assert cache_key(Source("block", "box", copy, 0.2)) == key
    assert cache_key(Source("block", "box", copy, 0.3)) != key
    assert cache_key(Source("brick", "box", copy, 0.2)) != key
    copy.write_bytes(copy.read_bytes() + b"# more\n")
    assert cache_key(Source("block", "box", copy, 0.2)) != key
    monkeypatch.setattr(cache.prepare, "VERSION", 999)
    assert cache_key(block) != key


@pytest.mark.parametrize(
    "line", ["map_Kd my skin.png", "map_Kd -s 1 1 my skin.png", r"map_Kd C:\scans\my skin.png"]
)
def test_the_key_depends_on_the_texture(tmp_path, line):
    (tmp_path / "a.obj").write_text("mtllib my a.mtl\n")
    (tmp_path / "my a.mtl").write_text(line)
    keys = set()
    for content in (b"one", b"two"):
        (tmp_path / "my skin.png").write_bytes(content)
        keys.add(cache_key(Source("a", "", tmp_path / "a.obj", 1.0)))
    assert len(keys) == 2


def test_what_was_read_otherwise_is_not_taken_and_has_the_same_identity(
    bracket, tmp_path, monkeypatch
):
    bracket.export(tmp_path / "bracket.stl")
    source = Source("bracket", "", tmp_path / "bracket.stl", 0.2)
    calls = []
    monkeypatch.setattr(convex, "convex_parts", lambda *args: calls.append(1) or whole(*args))
    hashes = set()
    for reading in (1, 2, 2):
        monkeypatch.setattr(cache, "READING", reading)
        monkeypatch.setattr(convex, "READING", reading)
        (done,) = cache.prepare_all([source], 1)
        hashes.add(done.model.content_hash)
    assert len(calls) == 2
    assert hashes == {cache_key(source)}


def test_without_a_decomposition_a_mesh_is_refused_by_the_name_of_what_to_install(
    bracket, tmp_path, monkeypatch
):
    bracket.export(tmp_path / "bracket.stl")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match=r"bracket.stl needs CoACD: .*'\.\[meshes\]'"):
        cache.prepare_all([Source("bracket", "", tmp_path / "bracket.stl", 0.2)], 1)


def whole(mesh, simple):
    del simple
    return convex.single_hull(mesh)


def test_the_sources_identify_a_prepared_object(block, tmp_path):
    assert prepare_into(block, tmp_path / "kept.npz") == ""
    assert cached(tmp_path / "kept.npz").model.content_hash == cache_key(block)


def test_one_hull_kept_for_want_of_time_is_another_object(bracket, tmp_path, monkeypatch):
    bracket.export(tmp_path / "bracket.stl")
    source = Source("bracket", "", tmp_path / "bracket.stl", 0.2)
    impatient = partial(convex.convex_parts, time_limit=0.01)
    monkeypatch.setattr(convex, "convex_parts", impatient)
    assert prepare_into(source, tmp_path / "kept.npz") == "no decomposition in 0.01 s"
    done = cached(tmp_path / "kept.npz")
    assert done.model.content_hash != cache_key(source)
    assert done.excluded.endswith("mm from its mesh (no decomposition in 0.01 s)")
