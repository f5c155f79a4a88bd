import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from mechsearch.env.heap_env import make_env
from mechsearch.files import append_line
from mechsearch.heaps.dataset import (
    check_objects,
    embedded_heaps,
    heap_from_json,
    heap_to_json,
    join_heaps,
    load_heaps,
    open_heaps,
    save_heaps,
)
from mechsearch.heaps.generate import Drop, GenerateConfig, attempt, generate, verify
from mechsearch.objects.catalog import load_object_set
from mechsearch.processes import Failure
from mechsearch.types import MechSearchError

SMALL = GenerateConfig(heaps=4, counts=(5, 6), seed=5)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("heaps") / "small.parquet"
    return path, generate(SMALL, path)


def test_a_set_has_equally_many_heaps_of_each_count_and_half_of_each_is_held_out(small):
    _, heaps = small
    counts = [(heap.count, heap.held_out) for heap in heaps.heaps]
    assert sorted(counts) == [(5, False), (5, True), (6, False), (6, True)]
    assert len({heap.seed for heap in heaps.heaps}) == 4


def test_targets_are_occluded_within_bounds_and_objects_distinct(small):
    for heap in small[1].heaps:
        assert 0.1 <= heap.occlusion <= 0.9
        assert len(set(heap.objects)) == len(heap.objects) == heap.count


def test_what_is_written_is_read_back_exactly(small):
    path, heaps = small
    again = load_heaps(path)
    assert again.hash == heaps.hash
    for a, b in zip(again.heaps, heaps.heaps, strict=True):
        np.testing.assert_array_equal(a.poses, b.poses)
        assert heap_to_json(a) == heap_to_json(b)


def test_verification_restores_every_heap_and_finds_a_moved_one(small):
    _, heaps = small
    assert all(check.passed for check in verify(heaps, "household"))
    moved = replace(heaps.heaps[0], poses=heaps.heaps[0].poses + np.eye(7)[2] * 0.02)
    wrong = replace(heaps, heaps=(moved, *heaps.heaps[1:]))
    assert [check.passed for check in verify(wrong, "household")] == [False, True, True, True]


@pytest.mark.timeout(120)
def test_two_workers_make_the_same_heaps_as_one(small, tmp_path):
    assert generate(SMALL, tmp_path / "two.parquet", workers=2).hash == small[1].hash


def losing(numbers):
    """Return a map whose workers died twice of some attempts at heaps of 5."""

    def mapper(function, inputs, workers, time_limit, instead):
        for drop in inputs:
            lost = drop.count == 5 and drop.number in numbers
            yield instead(drop, Failure("worker died")) if lost else function(drop)

    return mapper


def test_an_attempt_that_kills_two_workers_is_discarded_and_recorded_by_number(small, tmp_path):
    heaps = generate(SMALL, tmp_path / "lost.parquet", mapper=losing({0}))
    assert heaps.manifest["lost_attempts"] == {"5": {"0": "worker died"}}
    assert len(heaps.heaps) == 4
    first = attempt(SMALL, load_object_set("household"), 5, 0)
    assert first is None or first.seed not in {heap.seed for heap in heaps.heaps}
    assert "lost_attempts" not in small[1].manifest


def test_a_lost_attempt_stays_lost_when_a_set_is_continued(tmp_path):
    def cut(label, done, total):
        if done == 2:
            raise InterruptedError

    path = tmp_path / "cut.parquet"
    with pytest.raises(InterruptedError):
        generate(SMALL, path, progress=cut, mapper=losing({0}))
    assert generate(SMALL, path).manifest["lost_attempts"] == {"5": {"0": "worker died"}}


def test_objects_that_always_kill_their_workers_are_an_error_that_says_so(tmp_path):
    with pytest.raises(MechSearchError, match=r"0 of 200 .* 200 drops were lost: worker died"):
        generate(SMALL, tmp_path / "none.parquet", mapper=losing(range(10**6)))
    # Nothing is left that would refuse another set of that name.
    assert [file.suffix for file in tmp_path.iterdir()] == [".lock"]


def test_a_set_that_was_cut_off_is_continued_and_comes_out_the_same(small, tmp_path):
    path = tmp_path / "cut.parquet"

    class CutError(Exception):
        pass

    def cut(label, done, total):
        if done == 2:
            raise CutError

    with pytest.raises(CutError):
        generate(SMALL, path, progress=cut)
    assert not path.exists()
    journal = next(tmp_path.glob(".*.jsonl"))
    before = len(journal.read_text().splitlines())
    journal.write_text(journal.read_text() + '{"torn')
    assert before > 0
    assert generate(SMALL, path).hash == small[1].hash
    assert all(file.suffix == ".lock" for file in tmp_path.glob(".*"))


def test_heaps_of_another_set_that_was_cut_off_are_not_lost(small, tmp_path):
    path = str(tmp_path / "set.parquet")
    (tmp_path / ".set.attempts.json").write_text(json.dumps({"config": "other"}))
    row = Drop(5, 0, small[1].heaps[0]).row()
    append_line(tmp_path / ".set.attempts.jsonl", row)
    with pytest.raises(MechSearchError, match="another heap set"):
        generate(SMALL, path)
    # Without a heap there is nothing to lose.
    (tmp_path / ".set.attempts.jsonl").unlink()
    append_line(tmp_path / ".set.attempts.jsonl", row | {"heap": None})
    assert generate(SMALL, path).hash == small[1].hash == load_heaps(path).hash


def test_an_attempt_depends_on_its_number_alone():
    objects = load_object_set("household")
    found = [attempt(SMALL, objects, 5, number) for number in (3, 3)]
    assert (found[0] is None) == (found[1] is None)
    if found[0] is not None:
        np.testing.assert_array_equal(found[0].poses, found[1].poses)


def test_dual_heaps_lie_apart_and_hold_distinct_objects():
    heaps = embedded_heaps("dual").heaps
    sides = []
    for heap in heaps:
        assert len(set(heap.objects)) == 2 * heap.count
        first, second = heap.poses[::2, :2].mean(0), heap.poses[1::2, :2].mean(0)
        assert np.linalg.norm(first - second) > 0.15
        sides.append(heap.target % 2)
    assert 0.3 < np.mean(sides) < 0.7


@pytest.mark.parametrize("condition", ["single", "dual"])
def test_the_embedded_heaps_fit_the_embedded_objects(condition):
    env = make_env(condition)
    obs, info = env.reset(seed=0)
    assert obs["depth"].shape == (1, 64, 64)
    assert 0.1 <= info["occlusion"] <= 0.9


def test_every_kind_of_damage_is_found(small, tmp_path):
    path, heaps = small
    data = bytearray(path.read_bytes())
    broken = tmp_path / "broken.parquet"
    broken.write_bytes(data[: len(data) // 2])
    with pytest.raises(MechSearchError, match="damaged"):
        load_heaps(broken)
    table = pq.read_table(path)
    columns = table.to_pydict()
    columns["target"][0] += 1
    pq.write_table(pa.Table.from_pydict(columns, schema=table.schema), broken)
    with pytest.raises(MechSearchError, match="damaged"):
        load_heaps(broken)
    for name in ("absent.parquet", 300 * "n"):
        with pytest.raises(MechSearchError, match="no heap set"):
            load_heaps(tmp_path / name)
    save_heaps(broken, heaps.heaps, {**heaps.manifest, "format": 99})
    with pytest.raises(MechSearchError, match="format 99"):
        load_heaps(broken)


def test_heaps_of_other_objects_are_refused(small, boxes):
    with pytest.raises(MechSearchError, match=r"'household' objects.* by --objects.*'boxes'"):
        check_objects(small[1], boxes)


@pytest.fixture(scope="module")
def of_folder(tmp_path_factory):
    """A folder of three bricks and two damaged meshes, and its heaps, dropped by two workers."""
    folder = tmp_path_factory.mktemp("bricks")
    for name in "abc":
        trimesh.creation.box((0.06, 0.08, 0.1)).export(folder / f"{name}.obj")
    for name in "de":
        (folder / f"{name}.stl").write_bytes(bytes(90))
    rows = "".join(f"{name},0.3\n" for name in "abcde")
    (folder / "masses.csv").write_text("object,mass_kg\n" + rows)
    config = GenerateConfig(heaps=2, counts=(3,), objects=folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MECHSEARCH_CACHE", str(folder / "cache"))
        with pytest.warns(UserWarning, match="e is left out"):
            generate(config, str(folder / "heaps.parquet"), workers=2)
        yield folder


def test_heaps_are_of_what_is_not_damaged_for_workers_too(of_folder):
    path = of_folder / "heaps.parquet"
    heaps, objects = open_heaps(str(path), str(of_folder))
    assert {name for heap in heaps.heaps for name in heap.objects} == set("abc")
    assert list(objects.excluded) == ["d", "e"]


def test_heaps_of_a_folder_say_whose_they_are_and_how_to_name_it(of_folder):
    path = of_folder / "heaps.parquet"
    assert str(of_folder).encode() not in path.read_bytes()
    whose = rf"made with '{of_folder.name}' objects; name them, or the folder .* by --objects"
    with pytest.raises(MechSearchError, match=whose + ": no object set"):
        open_heaps(path)
    with pytest.raises(MechSearchError, match=whose + ": 3 of the 3 recorded objects are missing"):
        list(verify(load_heaps(path), "household"))


@pytest.mark.parametrize("name", ["household-dual", "household_dual", "run/household-dual"])
def test_the_embedded_heaps_have_names(name, small, tmp_path, monkeypatch):
    assert load_heaps(name).hash == embedded_heaps("dual").hash
    monkeypatch.chdir(tmp_path)
    save_heaps("household-dual", small[1].heaps, small[1].manifest)
    assert load_heaps("household-dual").hash == small[1].hash


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"condition": "triple"}, "'triple'.*single, dual"),
        ({"drop": "throw"}, "'throw'.*wall, open"),
        ({"heaps": 4}, "multiple of 3"),
        ({"camera": "side"}, "'side'"),
        ({"counts": (5, 5), "heaps": 4}, "each number once"),
        ({"least": 0.9, "most": 0.1}, "least < most"),
        ({"held_out": "some"}, "'some'.*half, all"),
        ({"retries": -1}, "retries is -1"),
    ],
)
def test_wrong_settings_are_named(settings, words):
    with pytest.raises(MechSearchError, match=words):
        GenerateConfig(**settings)


def test_an_existing_set_is_never_overwritten(small):
    with pytest.raises(MechSearchError, match="exists already"):
        generate(SMALL, small[0])


def test_a_heap_survives_json():
    heap = embedded_heaps("single").heaps[0]
    again = heap_from_json(json.loads(json.dumps(heap_to_json(heap))))
    np.testing.assert_array_equal(again.poses, heap.poses)


def test_objects_are_chosen_and_left_out_by_name(small, tmp_path):
    names = tuple(load_object_set("household").models)
    config = replace(SMALL, counts=(3,), heaps=2, only=names[:5], without=names[:1], held_out="all")
    heaps = generate(config, tmp_path / "some.parquet")
    assert set(heaps.manifest["object_hashes"]) == set(names[1:5])
    assert {name for heap in heaps.heaps for name in heap.objects} <= set(names[1:5])
    assert all(heap.held_out for heap in heaps.heaps)
    assert heaps.manifest["config"]["without"] == names[:1]
    # Sets that were made before there was a choice keep their hash.
    assert not {"only", "without", "held_out", "retries"} & set(small[1].manifest["config"])
    with pytest.raises(MechSearchError, match="no anvil; choose among"):
        generate(replace(config, without=("anvil",)), tmp_path / "none.parquet")


def test_what_fell_off_the_table_is_dropped_again_where_a_heap_has_more_chances():
    """This drop is discarded at the first look, and lies at rest with more chances."""
    objects = load_object_set("household")
    crowded = GenerateConfig(counts=(30,), heaps=1, seed=3)
    numbers = (1,)
    before = [attempt(crowded, objects, 30, i) for i in numbers]
    after = [attempt(replace(crowded, retries=3), objects, 30, i) for i in numbers]
    assert sum(heap is not None for heap in after) > sum(heap is not None for heap in before)
    for heap in after:
        if heap is not None:
            assert np.abs(heap.poses[:, :2]).max() < 0.4
            assert heap.poses[:, 2].min() > -0.05


def test_joined_sets_are_one_of_all_their_heaps(small, tmp_path):
    dual = embedded_heaps("dual")
    path = tmp_path / "joined.parquet"
    joined = join_heaps([small[1], dual], path)
    assert load_heaps(path).hash == joined.hash
    assert [h.seed for h in joined.heaps] == [h.seed for h in (*small[1].heaps, *dual.heaps)]
    assert joined.condition == "single+dual"
    assert joined.manifest["parts"] == [small[1].manifest, dual.manifest]
    # A joined set is joined like any other, and remembers the first ones.
    more = replace(dual, heaps=tuple(replace(h, seed=h.seed + 1) for h in dual.heaps))
    both = join_heaps([joined, more], tmp_path / "both.parquet")
    assert (len(both.heaps), both.condition) == (len(joined.heaps) + len(dual.heaps), "single+dual")
    assert both.manifest["parts"] == [small[1].manifest, dual.manifest, dual.manifest]
    for sets, words in (([dual], "exists already"), ([dual, dual], "exists already")):
        with pytest.raises(MechSearchError, match=words):
            join_heaps(sets, path)
    with pytest.raises(MechSearchError, match="1 heap sets given"):
        join_heaps([dual], tmp_path / "one.parquet")
    with pytest.raises(MechSearchError, match="a heap is in two"):
        join_heaps([dual, dual], tmp_path / "twice.parquet")
    tilted = replace(
        dual, manifest={**dual.manifest, "config": {**dual.manifest["config"], "camera": "tilted"}}
    )
    with pytest.raises(MechSearchError, match="the camera 'overhead', another 'tilted'"):
        join_heaps([dual, tilted], tmp_path / "views.parquet")
