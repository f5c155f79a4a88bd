"""Trained policies for computers without PyTorch."""

import hashlib
import logging
import warnings
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from mechsearch.evaluation import policies
from mechsearch.files import write_json, write_whole
from mechsearch.robot import policy as exported
from mechsearch.types import MechSearchError, check_extra


def export_policy(spec: str, folder: Path) -> exported.Description:
    """Write a policy for `robot.policy.open_policy`.

    Args:
        spec: One of `SHIPPED_POLICIES`, a run directory, or one policy's file.
        folder: For the network and its description.

    Raises:
        MechSearchError: If there is no such policy, or it is of a kind that is not exported.
    """
    check_extra("`mechsearch export policy`", "export")
    policy = policies.policy_named(spec)
    inner: Any = getattr(policy, "policy", policy)
    if not hasattr(inner, "to_export"):
        raise MechSearchError(
            f"the policy {spec} is a {type(inner).__name__}, which is not exported; expected one "
            "that chooses pushes or actions by networks, such as single or a run of method"
        )
    kind, network, examples = inner.to_export()
    run = policies.config_of_run(spec)
    task = policies.task_of(policy, run, "overhead")
    inputs, outputs = exported.described_tensors(kind, inner.keys, task.image_size)
    path = folder / exported.ONNX_FILE
    write_whole(path, lambda place: _write(network, examples, list(inputs), list(outputs), place))
    bounds, shipped = task.workspace, spec in policies.SHIPPED_POLICIES
    card = policies.card(spec) if shipped else {"config": run, "actor": policies.actor_of(spec)}
    description = exported.Description(
        format=exported.FORMAT, mechsearch=version("mechsearch"), name=spec, kind=kind,
        network=hashlib.sha256(path.read_bytes()).hexdigest(), opset=exported.OPSET,
        inputs=inputs, outputs=outputs, camera=task.camera, image_size=task.image_size,
        low=[-bounds.half, -bounds.half, bounds.low], high=[bounds.half, bounds.half, bounds.high],
        candidates=getattr(inner, "candidates", 0), card=card,
        searches=getattr(inner, "searches", False),
    )  # fmt: skip
    write_json(folder / exported.DESCRIPTION_FILE, asdict(description))
    return description


def _write(
    network: torch.nn.Module, examples: Any, inputs: list[str], outputs: list[str], path: Path
) -> None:
    several = {0: torch.export.Dim("N", min=1, max=65536)} if examples[0].shape[0] > 1 else None
    # What it does not find, it does not need.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network.eval(), examples, dynamo=True, opset_version=exported.OPSET, verbose=False,
            input_names=inputs, output_names=outputs,
            dynamic_shapes=[several] * len(examples) if several else None,
        )  # fmt: skip
    assert program is not None
    # Whole in one file.
    program.save(path, external_data=False)
