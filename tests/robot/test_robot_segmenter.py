"""Exported segmenters: the same masks as in PyTorch, or refused."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from mechsearch.cli import main
from mechsearch.geometry import invert
from mechsearch.robot.controller import Controller
from mechsearch.robot.limits import MOVE, RETREAT, Limits
from mechsearch.robot.segmenter import open_segmenter
from mechsearch.types import MechSearchError
from tests.robot.described import check_described
from tests.robot.simulated_robot import (
    BASE_FROM_WORKSPACE,
    LIMITS,
    SEEN_HEAP,
    SimulatedRobot,
    own_camera,
)
from tests.robot.test_limits import Onwards

SIZES = ((320, 240), (128, 128), (90, 160))


@pytest.fixture(scope="module")
def frames():
    """Images of one heap from several places, with holes, and where the table is below them."""
    robot, rng, seen = SimulatedRobot(SEEN_HEAP), np.random.default_rng(0), []
    for number, size in enumerate(SIZES):
        robot.camera = own_camera(*size, tilt=0.1 * number)
        frame = robot.frame(colour=True)
        depth = np.where(rng.random(frame.depth.shape) < 0.05, 0, frame.depth).astype(np.float32)
        pose = invert(BASE_FROM_WORKSPACE) @ frame.camera.pose
        camera = replace(frame.camera, world_from_camera=tuple(pose.ravel().tolist()))
        seen.append((frame.colour, depth, camera, frame.mask))
    return seen


def test_masks_and_confidence_are_pytorchs(exported_segmenter, frames):
    from mechsearch.segmentation.reference import render_references
    from mechsearch.segmentation.segmenter import make_segmenter, visible_target

    theirs, carried = make_segmenter("shipped"), open_segmenter(exported_segmenter)
    theirs.look_for(render_references(SimulatedRobot(SEEN_HEAP).target))
    for rgb, depth, camera, truth in frames:
        expected, sure = visible_target(theirs, rgb, depth, camera)
        mask, confidence = carried.segment(rgb, depth, camera)
        assert (mask == expected).mean() >= 0.999
        assert confidence == pytest.approx(sure, abs=1e-4)
        # The target is found, so that masks that are alike say something.
        assert (mask & truth).sum() > 0.5 * (mask | truth).sum()


def test_the_description_says_what_goes_in_and_comes_out(exported_segmenter):
    described = open_segmenter(exported_segmenter).description
    check_described(described, exported_segmenter / "segmenter.onnx")
    for tensor in (*described.inputs.values(), *described.outputs.values()):
        assert tensor["dtype"] == "float32"
        assert tuple(tensor["shape"][-2:]) == ("N", "N")
    assert (described.image_size, described.views, described.opset) == (256, 12, 18)
    assert tuple(described.looks) == (112, 128)
    assert described.card["validation"]["iou"] > 0.5


def test_images_that_do_not_belong_together_are_refused(exported_segmenter, frames):
    carried, (rgb, depth, camera, _) = open_segmenter(exported_segmenter), frames[0]
    with pytest.raises(MechSearchError, match=r"depth \(120, 320\)"):
        carried.segment(rgb, depth[::2], camera)
    with pytest.raises(MechSearchError, match="of float32"):
        carried.segment(rgb.astype(np.float32), depth, camera)
    with pytest.raises(MechSearchError, match="holes alone"):
        carried.segment(rgb, 0 * depth, camera)


def test_what_another_version_wrote_is_refused(exported_segmenter, exported_pushes, tmp_path):
    described = json.loads((exported_segmenter / "segmenter.json").read_text())
    for number, (changes, words) in enumerate([
        ({"format": 9, "mechsearch": "9.1"}, r"format 9, written by mechsearch 9\.1"),
        ({"kind": "grasps"}, "'grasps'; choose one of masks"),
        ({"network": "0" * 64}, "not the network"),
    ]):  # fmt: skip
        place = tmp_path / str(number)
        shutil.copytree(exported_segmenter, place)
        (place / "segmenter.json").write_text(json.dumps(described | changes))
        with pytest.raises(MechSearchError, match=words):
            open_segmenter(place)
    with pytest.raises(MechSearchError, match="no exported segmenter at"):
        open_segmenter(exported_pushes)


def test_a_controller_looks_for_the_target_itself(exported_segmenter):
    robot, segmenter = SimulatedRobot(SEEN_HEAP), open_segmenter(exported_segmenter)
    controller = Controller(
        Onwards(-1.0, 0.5, 0.0), BASE_FROM_WORKSPACE, Limits(**LIMITS), None, segmenter
    )
    seen = robot.frame(colour=True)
    asked = replace(seen, mask=None)
    assert controller.step(asked, robot.tool(), 0.0).kind == MOVE
    found, goal = controller.mask, controller.goal
    assert (found & seen.mask).sum() > 0.5 * (found | seen.mask).sum()
    # A motion that goes on needs no look.
    assert controller.step(asked, robot.tool(), 0.05).kind == MOVE
    assert controller.mask is None
    np.testing.assert_array_equal(controller.goal, goal)
    motion = controller.step(replace(asked, colour=None), robot.tool(), 0.1)
    assert (motion.kind, motion.reason) == (RETREAT, "neither mask nor colours came with the image")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("shipped", "neither of --reference and --object"),
        ("shipped --object mug --reference views.npz", "both of --reference and --object"),
        ("shipped --object dragon", "dragon"),
        ("shipped --reference missing.npz", "missing.npz"),
        ("tests.segmentation.test_segmenter:Gives --object mug", "a Gives, which is not exported"),
        ("true --object mug", "a simulator's own mask"),
    ],
)
def test_what_cannot_be_exported_is_refused(words, says, tmp_path, capsys):
    pytest.importorskip("onnxscript")
    with pytest.raises(SystemExit):
        main([*f"export segmenter {words} --out".split(), str(tmp_path / "out")])
    assert says in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_an_object_is_seen_by_its_mesh(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from mechsearch.cli import export_segmenter as command
    from mechsearch.objects.catalog import load_object_set
    from mechsearch.segmentation.reference import render_references

    told = []
    monkeypatch.setattr(command, "export_segmenter", lambda *given: told.append(given))
    main(["export", "segmenter", "shipped", "--object", "mug", "--out", str(tmp_path / "out")])
    ((name, references, target, _),) = told
    assert (name, target) == ("shipped", "mug")
    expected = render_references(load_object_set("household").models["mug"])
    np.testing.assert_array_equal(references.rgb, expected.rgb)
