"""Images of heaps: what they show is the truth, and a folder goes on where it was cut off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.heaps.dataset import embedded_heaps, object_set
from mechsearch.render.renderer import Renderer
from mechsearch.segmentation.images import ImageConfig, load_images, make_images, see_heaps
from mechsearch.segmentation.reference import FULL
from mechsearch.sim import Pusher, pusher_model
from mechsearch.types import MechSearchError

HEAPS = Path("household-single")
CONFIG = ImageConfig(views=1, limit=2, also=(), variants=0, shard=1, without=("apple",))
PLAIN = ImageConfig(1, "all", 3, ("perfect",), randomised=False, also=(), variants=0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("images")
    make_images(HEAPS, "", CONFIG, path)
    return path


def test_masks_and_shares_are_those_of_the_heap(tmp_path):
    seen = see_heaps(HEAPS, "", PLAIN)
    heap_set = embedded_heaps("single")
    models, camera = object_set("household").models, preset("overhead", FULL)
    for index, number in enumerate(heap_set.choose("all", 3)):
        heap = heap_set.heaps[number]
        frame = Renderer([models[name] for name in heap.objects]).frame(camera, heap.poses)
        ids = seen.images.ids[index]
        # The end effector may hide some of them.
        for place, name in enumerate(heap.objects):
            modal = frame.modal(place)
            assert not (ids == place + 1)[~modal].any()
            assert seen.names[seen.images.objects[index, place]] == name
        hidden = seen.images.hidden[index, heap.target]
        shown = frame.modal(heap.target).sum()
        assert hidden == pytest.approx(1 - shown / frame.amodal[heap.target].sum(), abs=1e-6)
        assert seen.images.target[index] == heap.target
        depth = seen.images.seen(index)[1]
        assert np.abs(depth - frame.depth)[ids > 0].max() < 6e-4


def test_objects_left_out_are_in_no_image_and_no_reference(folder):
    seen = load_images([folder])
    assert "apple" not in seen.names
    assert len(seen.images) == 2
    assert (seen.images.objects >= 0).any()
    heaps = embedded_heaps("single")
    used = {heaps.heaps[i].seed: heaps.heaps[i] for i in heaps.choose("train", 2)}
    assert set(seen.images.heap.tolist()) == set(used)


def test_a_folder_that_was_cut_off_goes_on_to_the_same_bytes(folder, tmp_path):
    make_images(HEAPS, "", CONFIG, tmp_path)
    (tmp_path / "images-00001.npz").unlink()
    make_images(HEAPS, "", CONFIG, tmp_path)
    for one, other in zip(*(vars(load_images([f]).images).values() for f in (folder, tmp_path)),
                          strict=True):  # fmt: skip
        np.testing.assert_array_equal(one, other)


def test_folders_are_joined_with_the_objects_of_each(folder):
    once, twice = load_images([folder]), load_images([folder, folder])
    count = len(once.names)
    assert len(twice.images) == 2 * len(once.images)
    assert len(twice.references) == 2 * count
    first, second = np.split(twice.images.objects, 2)
    np.testing.assert_array_equal(second[second >= 0], first[first >= 0] + count)


def test_what_does_not_fit_is_refused(folder, tmp_path):
    with pytest.raises(MechSearchError, match="made from another config; name another folder"):
        make_images(HEAPS, "", replace(CONFIG, seed=1), folder)
    with pytest.raises(MechSearchError, match="manifest of segmentation images"):
        load_images([tmp_path])
    for wrong, words in (
        ({"split": "x"}, "unknown split 'x'"), ({"sensors": ("x",)}, "unknown sensor 'x'"),
        ({"views": 0}, "0 views"),
    ):  # fmt: skip
        with pytest.raises(MechSearchError, match=words):
            ImageConfig(**wrong)


def test_moments_of_episodes_are_shown_as_they_were(tmp_path):
    heap_set = embedded_heaps("single")
    heap = heap_set.heaps[heap_set.choose("all", 1)[0]]
    poses = np.stack([heap.poses] * 2)
    poses[:, :, 0] += 0.05
    tips = np.array([[*poses[0, heap.target, :2], 0.15]] * 2)
    config, courses = replace(PLAIN, limit=0), {heap.seed: (poses, tips)}
    make_images(HEAPS, "", config, tmp_path, courses=courses)
    seen = load_images([tmp_path])
    models, camera = object_set("household").models, preset("overhead", FULL)
    renderer = Renderer([models[name] for name in heap.objects], pusher_model(Pusher()))
    frame = renderer.frame(camera, poses[0], Pusher().pose(tips[0]))
    np.testing.assert_array_equal(seen.images.ids[0], np.maximum(frame.ids + 1, 0))
    assert seen.images.heap.tolist() == [heap.seed]
    # The end effector is in front of the target, but others alone hide it.
    bare = renderer.frame(camera, poses[0])
    whole, shown = frame.amodal[heap.target].sum(), bare.modal(heap.target).sum()
    assert frame.modal(heap.target).sum() < shown
    assert seen.images.hidden[0, heap.target] == pytest.approx(1 - shown / whole, abs=1e-6)
    with pytest.raises(MechSearchError, match="made from another courses; name another folder"):
        make_images(HEAPS, "", config, tmp_path, courses={heap.seed: (poses, tips + 0.1)})
    with pytest.raises(MechSearchError, match="1 of 1 episodes are on no heap of the split all"):
        make_images(HEAPS, "", config, tmp_path / "other", courses={-1: (poses, tips)})
