from dataclasses import replace

import numpy as np
import pytest

from mechsearch.grasp.grasp_scene import view_of_heap
from mechsearch.grasp.learning.grasp_folder import MANIFEST_FILE, OUTCOMES, GraspFolder
from mechsearch.grasp.learning.labelling import LabelConfig, label_grasps, load_grasps, thumbnail
from mechsearch.grippers import ImageGrasp
from mechsearch.heaps.dataset import HeapSet
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.types import MechSearchError, Outcome

CONFIG = LabelConfig(per_object=4, shard=2)


@pytest.fixture(scope="module")
def heap_set(tmp_path_factory):
    path = tmp_path_factory.mktemp("grasp") / "heaps.parquet"
    return generate(GenerateConfig(heaps=6, counts=(4,), seed=5), path)


@pytest.fixture(scope="module")
def labelled(heap_set, tmp_path_factory):
    return label_grasps(heap_set, "household", CONFIG, tmp_path_factory.mktemp("labels")).path


def test_every_grasp_has_a_label_a_heap_and_an_object(heap_set, labelled):
    grasps = load_grasps(labelled)
    assert grasps.relative.shape[1:] == (96, 96)
    assert grasps.relative.dtype == np.float16
    assert set(grasps.heap.tolist()) == {heap.seed for heap in heap_set.train}
    names = {heap.seed: heap.objects for heap in heap_set.train}
    assert all(o in names[h] for o, h in zip(grasps.object, grasps.heap, strict=True))
    assert grasps.bin.max() < 16
    np.testing.assert_array_equal(
        grasps.success, [OUTCOMES[number] is Outcome.SUCCESS for number in grasps.outcome]
    )
    assert 0 < grasps.success.mean() < 1


def test_labels_do_not_depend_on_workers_or_interruption(heap_set, labelled, tmp_path):
    class CutOffError(Exception):
        pass

    def cut_off(label, done, total):
        if done == 3:
            raise CutOffError

    with pytest.raises(CutOffError):
        label_grasps(heap_set, "household", CONFIG, tmp_path, progress=cut_off)
    assert (tmp_path / "grasps-00000.npz").exists()
    label_grasps(heap_set, "household", CONFIG, tmp_path, workers=2)
    assert (tmp_path / MANIFEST_FILE).read_text() == (labelled / MANIFEST_FILE).read_text()


def test_a_damaged_shard_is_found_and_labelled_again(heap_set, labelled, tmp_path):
    for file in labelled.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    shard = tmp_path / "grasps-00001.npz"
    whole = shard.read_bytes()
    shard.write_bytes(whole[:-10])
    with pytest.raises(MechSearchError, match="missing or damaged"):
        load_grasps(tmp_path)
    label_grasps(heap_set, "household", CONFIG, tmp_path)
    assert shard.read_bytes() == whole


def test_grasps_of_another_kind_are_not_mixed_in(heap_set, labelled):
    with pytest.raises(MechSearchError, match="grasps made from another config"):
        label_grasps(heap_set, "household", replace(CONFIG, seed=9), labelled)


def test_a_folder_without_grasps_is_refused(tmp_path):
    with pytest.raises(MechSearchError, match="no manifest of a grasp set"):
        load_grasps(tmp_path)
    GraspFolder(tmp_path, {})
    (tmp_path / MANIFEST_FILE).write_text('{"format": 1, "shards": {}}')
    with pytest.raises(MechSearchError, match="holds no grasps yet"):
        load_grasps(tmp_path)


def test_what_cannot_be_labelled_is_refused(heap_set, tmp_path):
    for wrong in ({"split": "all"}, {"per_object": 0}, {"geometric": 1.5}):
        with pytest.raises(MechSearchError, match=r"expected|choose"):
            LabelConfig(**wrong)
    empty = HeapSet(tuple(heap_set.train), heap_set.manifest, heap_set.hash)
    with pytest.raises(MechSearchError, match="has 0 held-out heaps"):
        label_grasps(empty, "household", LabelConfig(split="held-out"), tmp_path)


def test_a_thumbnail_shows_the_grasp_in_its_middle(make_box):
    view = view_of_heap(
        [make_box("b", (0.02, 0.02, 0.05))], np.array([[0, 0, 0.025, 1, 0, 0, 0.0]]), 0
    )
    rows, columns = np.nonzero(view.mask)
    grasp = ImageGrasp(float(rows.mean().round()), float(columns.mean().round()), 0.77, 0.0)
    seen = thumbnail(view, grasp).astype(np.float64)
    assert seen[48, 48] == pytest.approx(-0.02, abs=1e-4)
    assert seen[0, 0] == pytest.approx(0.03, abs=1e-4)
    inside = np.argwhere(seen < 0).mean(axis=0)
    np.testing.assert_allclose(inside, [48, 48], atol=0.6)
