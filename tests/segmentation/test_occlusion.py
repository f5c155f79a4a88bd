"""What is believed of a target by images, and how an episode ends by it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env import HeapEnv, HeapEnvConfig, RetrieveConfig, TaskConfig, imageless
from mechsearch.evaluation.rollout import evaluate, replay_all
from mechsearch.heaps.dataset import embedded_file
from mechsearch.render.renderer import Renderer
from mechsearch.segmentation import segmenter
from mechsearch.segmentation.images import ImageConfig, see_heaps
from mechsearch.segmentation.occlusion import (
    Occlusion,
    can_be_judged,
    make_estimator,
    patch_of,
    silhouette_areas,
)
from mechsearch.segmentation.reference import render_references
from mechsearch.segmentation.segmenter import SURE, Judge
from mechsearch.types import MechSearchError

FIXED = {"heap": 0, "fixed_start": True}
IDLE = np.zeros(3, np.float32)
CAMERA = preset("overhead", 128)
BLOCK = np.array([[0.0, 0.0, 0.02, 1, 0, 0, 0]])


class Says:
    """Gives one chance after another; beyond the last, none."""

    def __init__(self, *chances):
        self.chances = list(chances)

    def estimate(self, patch, numbers):
        return Occlusion(0.0, self.chances.pop(0) if self.chances else 0.0)


def judged(covered, boxes, monkeypatch, *chances, **more):
    says = Says(*chances)
    monkeypatch.setattr(segmenter, "make_estimator", lambda path: says)
    env = HeapEnv([covered], boxes, HeapEnvConfig(stop="shipped", **more))
    env.reset(options=FIXED)
    return env, says


def ends(env, actions):
    return [env.step(IDLE)[4]["end"] for _ in range(actions)]


def test_an_average_chance_that_is_high_ends_an_episode(covered, boxes, monkeypatch):
    # 0.35 of each look on: 0.035, 0.373, 0.592, 0.735, 0.828.
    env, _ = judged(covered, boxes, monkeypatch, 0.1, *[1.0] * 4)
    assert ends(env, 4) == [None] * 4
    _, _, terminated, truncated, info = env.step(IDLE)
    assert (info["end"], terminated, truncated) == ("stopped", True, False)
    with pytest.raises(MechSearchError, match="over"):
        env.step(IDLE)
    # One doubtful look between costs more looks: 0.592, 0.385, 0.6, 0.74, 0.831.
    env, _ = judged(covered, boxes, monkeypatch, 0.1, 1, 1, 0, *[1.0] * 3)
    assert ends(env, 7) == [None] * 6 + ["stopped"]
    env, _ = judged(covered, boxes, monkeypatch, max_actions=3)
    assert ends(env, 3) == [None, None, "action limit"]


def test_what_looks_uncovered_from_the_first_on_was_not_uncovered(covered, boxes, monkeypatch):
    env, _ = judged(covered, boxes, monkeypatch, *[0.99] * 9, 0.1, *[1.0] * 4)
    assert ends(env, 14) == [None] * 13 + ["stopped"]


def test_a_snapshot_knows_how_sure_the_last_looks_were(covered, boxes, monkeypatch):
    env, says = judged(covered, boxes, monkeypatch, 0.1, *[1.0] * 4)
    assert ends(env, 4) == [None] * 4
    snapshot = env.snapshot()
    assert ends(env, 1) == ["stopped"]
    env.restore(snapshot)
    says.chances = [1.0]
    assert ends(env, 1) == ["stopped"]
    env.reset(options=FIXED)
    says.chances = [1.0]
    assert ends(env, 1) == [None]
    # A trial in the imagination ends where the simulator says so, and asks for no image.
    assert imageless(env).config.stop == "true"
    plain = HeapEnv([covered], boxes)
    plain.reset(options=FIXED)
    assert set(snapshot) - set(plain.snapshot()) == {"sure"}


def test_only_where_asked_the_simulator_does_not_end_an_episode(covered, boxes):
    bare = replace(covered, objects=("cube", "small0"), poses=covered.poses[[0, 2]])
    for stop, expected in (("true", "uncovered"), ("never", None)):
        env = HeapEnv([bare], boxes, HeapEnvConfig(stop=stop))
        env.reset(options=FIXED)
        assert ends(env, 1) == [expected]


def areas_of(references):
    return silhouette_areas(references.mask, references.width)


def block_seen(make_box, visible):
    """Return areas, depth and mask of a block of 12 x 6 x 4 cm of which a part is visible."""
    box = make_box("box", (0.12, 0.06, 0.04))
    frame = Renderer([box]).frame(CAMERA, BLOCK)
    mask = frame.modal(0)
    columns = np.flatnonzero(mask.any(axis=0))
    mask[:, columns[round(visible * len(columns)) :]] = False
    return areas_of(render_references(box, np.eye(3))), frame.depth, mask


@pytest.mark.parametrize("visible", [1.0, 0.5])
def test_numbers_compare_the_visible_part_with_the_known_silhouettes(make_box, visible):
    areas, depth, mask = block_seen(make_box, visible)
    # From the sides a block of these measures shows 4 x 6, 4 x 12 and 6 x 12 cm.
    np.testing.assert_allclose(areas, [0.0024, 0.0048, 0.0072], rtol=0.35)
    _, numbers = patch_of(depth, CAMERA, mask, areas)
    # Seen from near, its sides show too.
    np.testing.assert_allclose(numbers[:3], np.log(0.0072 * visible / areas), atol=0.12)
    assert numbers[3] == pytest.approx(np.log(mask.sum()) - 4, abs=1e-5)
    assert numbers[4] == pytest.approx(0.4, abs=0.01)
    large = CAMERA.resized(512)
    again = patch_of(depth.repeat(4, 0).repeat(4, 1), large, mask.repeat(4, 0).repeat(4, 1), areas)
    np.testing.assert_allclose(again[1], numbers, atol=0.1)


def test_views_of_no_known_width_say_nothing_of_size(make_box):
    views = render_references(make_box("box", (0.1, 0.1, 0.1)))
    unknown = replace(views, width=np.zeros(12, np.float32))
    np.testing.assert_array_equal(areas_of(unknown), [1e-3] * 3)


def test_a_patch_shows_heights_over_the_mask_the_mask_and_holes_about_its_middle(make_box):
    areas, depth, mask = block_seen(make_box, 1.0)
    depth = depth.copy()
    depth[60, 64], depth[61, 64] = 0, np.nan
    height, inside, holes = patch_of(depth, CAMERA, mask, areas)[0]
    # Holes are filled, and marked.
    assert np.abs(height[inside == 1]).max() < 0.02
    assert holes.sum() == 2
    # The table is 4 cm lower, in twentieths of a metre.
    np.testing.assert_allclose(height[:4], -0.8, atol=0.02)
    assert inside.sum() == mask.sum()
    rows, columns = np.nonzero(inside)
    assert abs(rows.mean() - 24) < 1
    assert abs(columns.mean() - 24) < 1


def test_of_a_tiny_mask_or_an_image_of_holes_nothing_is_believed(make_box, monkeypatch):
    monkeypatch.setattr(segmenter, "make_estimator", lambda path: Says(1.0, 1.0, 1.0))
    box, (_, depth, mask) = make_box("box", (0.12, 0.06, 0.04)), block_seen(make_box, 1.0)
    judge, hidden = Judge("shipped", "overhead"), Occlusion(1.0, 0.0)
    assert judge.estimate(box, depth, mask).uncovered == 1.0
    tiny = np.zeros_like(mask)
    tiny[60, 60:65] = True
    assert judge.estimate(box, depth, tiny) == hidden
    assert judge.estimate(box, 0 * depth, mask) == hidden


def test_the_shipped_network_tells_bare_from_covered_objects():
    pytest.importorskip("torch")
    config = ImageConfig(1, "all", 12, ("perfect",), randomised=False, also=(), variants=0)
    seen, judge, rows = see_heaps(Path("household-single"), "", config), make_estimator(), []
    areas = [areas_of(references) for references in seen.references]
    for index, hidden in enumerate(seen.images.hidden):
        _, depth, camera = seen.images.seen(index, CAMERA.width)
        shown = seen.images.shown(index, CAMERA.width)
        for place in np.unique(shown[shown > 0]) - 1:
            mask = shown == place + 1
            if can_be_judged(depth, mask):
                number = seen.images.objects[index, place]
                found = judge.estimate(*patch_of(depth, camera, mask, areas[number]))
                rows.append((hidden[place], found.hidden, found.uncovered))
    hidden, estimated, chance = np.array(rows).T
    assert len(rows) > 80
    assert np.abs(hidden - estimated).mean() < 0.07
    assert (hidden <= 0.05)[chance >= SURE].mean() > 0.95
    assert (chance >= SURE)[hidden <= 0.05].mean() > 0.6


class Turns:
    """Is sure of what has been asked an even number of times."""

    asked = 0

    def estimate(self, patch, numbers):
        Turns.asked += 1
        return Occlusion(0.0, 1.0 - Turns.asked % 2)


def test_an_evaluation_that_stops_itself_is_verified_and_judged_by_the_truth(monkeypatch):
    monkeypatch.setattr(segmenter, "make_estimator", lambda path: Turns())
    monkeypatch.setattr(segmenter, "can_be_judged", lambda depth, mask: True)
    monkeypatch.setattr(segmenter, "patch_of", lambda *seen: (None, None))
    monkeypatch.setattr(segmenter, "NEWEST", 1.0)
    found = evaluate("idle", limit=2, task=TaskConfig(stop="shipped", max_actions=4))
    assert found.header["env"]["stop"] == "shipped"
    assert "stop true -> shipped" in found.header["task_differs"]
    for record in found.episodes:
        assert (record.end, len(record.actions)) == ("stopped", 2)
        assert record.uncovered == (record.occlusions[-1] <= 0.05)
    assert all(check.passed for check in replay_all(found, embedded_file("single")))
    episode = found.episodes[0]
    for hidden, right in ((0.05, True), (0.06, False)):
        occlusions = np.array([0.9, 0.9, hidden])
        assert replace(episode, occlusions=occlusions).uncovered == right


def test_what_cannot_stop_an_episode_is_refused(tmp_path):
    pytest.importorskip("torch")
    with pytest.raises(MechSearchError, match="unknown stop 'x'; choose true, never, shipped, or"):
        HeapEnvConfig(stop="x")
    with pytest.raises(MechSearchError, match="retrieval ends with the target in the hand"):
        RetrieveConfig(stop="shipped")
    with pytest.raises(MechSearchError, match="no mechsearch occlusion network at"):
        make_estimator(tmp_path / "missing.safetensors")
