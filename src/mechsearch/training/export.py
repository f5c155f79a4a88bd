"""Trained policies, segmenters and grasp networks for computers without PyTorch."""

import hashlib
import logging
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import torch

from mechsearch.evaluation import policies
from mechsearch.files import read_json, write_json, write_whole
from mechsearch.grasp.quality_network import quality_file, quality_to_export
from mechsearch.robot import grasper as grasps
from mechsearch.robot import policy as exported
from mechsearch.robot import segmenter as masks
from mechsearch.robot.network import FORMAT, OPSET, Exported, places
from mechsearch.segmentation.network import segmentation_card
from mechsearch.segmentation.reference import FULL, LOOKS, References
from mechsearch.segmentation.segmenter import SHIPPED, make_segmenter
from mechsearch.types import MechSearchError, check_extra

D = TypeVar("D", bound=Exported)


def export_policy(spec: str, folder: Path, candidates: int | None = None) -> exported.Description:
    """Write a policy for `robot.policy.open_policy`.

    Args:
        spec: One of `SHIPPED_POLICIES`, a run directory, or one policy's file.
        folder: For the network and its description.
        candidates: Pushes to judge at each decision; None takes as many as in training.

    Raises:
        MechSearchError: If there is no such policy, it is of a kind that is not exported, or it has
            no candidates, or is to have none.
    """
    check_extra("`mechsearch export policy`", "export")
    policy = policies.policy_named(spec)
    inner: Any = getattr(policy, "policy", policy)
    if not hasattr(inner, "to_export"):
        raise MechSearchError(
            f"the policy {spec} is a {type(inner).__name__}, which is not exported; expected one "
            "that chooses pushes or actions by networks, such as uncover or a run of method"
        )
    own = getattr(inner, "candidates", 0)
    if candidates is not None and not (own and candidates > 0):
        expected = "at least 1" if own else "none: it judges no pushes"
        raise MechSearchError(f"{spec} is to judge {candidates} candidates; expected {expected}")
    kind, network, examples = inner.to_export()
    run = policies.config_of_run(spec)
    task = policies.task_of(policy, run, "overhead")
    inputs, outputs = exported.described_tensors(kind, inner.keys, task.image_size)
    bounds, shipped = task.workspace, spec in policies.SHIPPED_POLICIES
    card = policies.card(spec) if shipped else {"config": run, "actor": policies.actor_of(spec)}
    return _exported(
        exported.Description, "policy", folder, network, examples, inputs, outputs,
        name=spec, kind=kind, camera=task.camera, image_size=task.image_size,
        low=[-bounds.half, -bounds.half, bounds.low], high=[bounds.half, bounds.half, bounds.high],
        candidates=candidates or own, card=card,
        searches=getattr(inner, "searches", False),
        full_steps=getattr(inner, "full_steps", False),
    )  # fmt: skip


def export_segmenter(
    spec: str, references: References, target: str, folder: Path
) -> masks.SegmenterDescription:
    """Write a segmenter that looks for one object, for `robot.segmenter.open_segmenter`.

    Args:
        spec: "shipped", or a network's file.
        references: Views of the object; what the network makes of them is computed here.
        target: What to call it.
        folder: For the network and its description.

    Raises:
        MechSearchError: If there is no such segmenter, or it is not a network.
    """
    check_extra("`mechsearch export segmenter`", "export")
    segmenter: Any = make_segmenter(spec)
    if not hasattr(segmenter, "to_export"):
        raise MechSearchError(
            f"the segmenter {spec} is a {type(segmenter).__name__}, which is not exported; "
            f"expected {SHIPPED}, or a network's file"
        )
    network, confidence = segmenter.to_export(references)
    inputs, outputs = masks.described_masks()
    side = 16 * torch.export.Dim("side", min=2, max=64)
    example = torch.zeros(1, masks.CHANNELS, LOOKS[1], LOOKS[1])
    return _exported(
        masks.SegmenterDescription, "segmenter", folder, network, (example,), inputs, outputs,
        [{2: side, 3: side}], name=spec, kind="masks", image_size=FULL, looks=LOOKS,
        confidence=confidence, target=target, views=len(references.width),
        card=segmentation_card(None if spec == SHIPPED else Path(spec)),
    )  # fmt: skip


def export_grasps(spec: str, folder: Path) -> grasps.GrasperDescription:
    """Write a gripper's grasp quality network, for `robot.grasper.open_grasper`.

    Args:
        spec: A gripper, whose shipped network it is, or a network's file.
        folder: For the network and its description.

    Raises:
        MechSearchError: If there is neither, or the file is damaged or of another version.
    """
    check_extra("`mechsearch export grasps`", "export")
    name, network, examples, facts = quality_to_export(spec)
    card = read_json(quality_file(name).with_suffix(".json"), "card") if spec == name else facts
    inputs, outputs = grasps.described_grasps(name)
    return _exported(
        grasps.GrasperDescription, "grasps", folder, network, examples, inputs, outputs,
        name=spec, card=card, **grasps.described_gripper(name),
    )  # fmt: skip


def _exported(
    description: Callable[..., D], what: str, folder: Path, network: torch.nn.Module, examples: Any,
    inputs: Mapping[str, Any], outputs: Mapping[str, Any], shapes: Any = None, **facts: Any,
) -> D:  # fmt: skip
    beside, place = places(folder, what)
    if shapes is None and examples[0].shape[0] > 1:
        shapes = [{0: torch.export.Dim("N", min=1, max=65536)}] * len(examples)
    names = list(inputs), list(outputs)
    write_whole(place, lambda to: _write(network, examples, *names, shapes, to))
    written = description(
        format=FORMAT, mechsearch=version("mechsearch"), opset=OPSET, inputs=inputs,
        network=hashlib.sha256(place.read_bytes()).hexdigest(), outputs=outputs, **facts,
    )  # fmt: skip
    write_json(beside, asdict(written))
    return written


def _write(
    network: torch.nn.Module, examples: Any, inputs: list[str], outputs: list[str], shapes: Any,
    path: Path,
) -> None:  # fmt: skip
    # What the exporter does not find, it does not need; what is not folded is computed.
    for name in ("torch.onnx._internal.exporter._registration", "onnxscript.optimizer"):
        logging.getLogger(name).setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network.eval(), examples, dynamo=True, opset_version=OPSET, verbose=False,
            input_names=inputs, output_names=outputs,
            dynamic_shapes=shapes,
        )  # fmt: skip
    assert program is not None
    # Whole in one file.
    program.save(path, external_data=False)
