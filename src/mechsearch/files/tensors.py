"""Tensors in safetensors files: networks, optimisers and what belongs with them. Never a pickle."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from zlib import crc32

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.optim import Optimizer

from mechsearch.files import write_whole
from mechsearch.types import MechSearchError

ARCHIVE_FORMAT = 1

Module = TypeVar("Module", bound=nn.Module)


@dataclass(frozen=True)
class Archive:
    """Tensors with a purpose.

    Attributes:
        kind: What the file is, such as "mechsearch actor".
        tensors: By name.
        meta: Whatever JSON holds.
    """

    kind: str
    tensors: Mapping[str, Tensor]
    meta: Mapping[str, Any]


def prefixed(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors under names that `part` finds again."""
    return {f"{prefix}/{name}": tensor for name, tensor in tensors.items()}


def part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors that `prefixed` named so, under their own names."""
    head = prefix + "/"
    return {k.removeprefix(head): v for k, v in tensors.items() if k.startswith(head)}


def tensors_of(modules: Sequence[nn.Module]) -> dict[str, Tensor]:
    """Return the weights of several modules by their place and name, as `filled` takes them."""
    tensors: dict[str, Tensor] = {}
    for i, module in enumerate(modules):
        tensors |= prefixed(str(i), module.state_dict())
    return tensors


def filled(modules: Sequence[Module], tensors: Mapping[str, Tensor]) -> list[Module]:
    """Return modules themselves, with the weights that `tensors_of` returned.

    Raises:
        MechSearchError: If they are of other modules.
    """
    for i, module in enumerate(modules):
        fill(module, part(tensors, str(i)))
    return list(modules)


def fill(module: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Load a module's weights.

    Raises:
        MechSearchError: If a tensor is missing, surplus or of another shape.
    """
    own = module.state_dict()
    if set(own) != set(tensors):
        differing = ", ".join(sorted(set(own) ^ set(tensors)))
        raise MechSearchError(f"the file's weights are of another network: {differing}")
    for name, tensor in tensors.items():
        if tensor.shape != own[name].shape:
            raise MechSearchError(
                f"weight {name!r} is {tuple(tensor.shape)}; expected {tuple(own[name].shape)}"
            )
    module.load_state_dict(dict(tensors))


def optimizer_tensors(optimizer: Optimizer) -> dict[str, Tensor]:
    """Return an optimiser's moments and step counts, by parameter and name."""
    states: Mapping[int, Mapping[str, Tensor]] = optimizer.state_dict()["state"]
    return {f"{i}/{name}": value for i, state in states.items() for name, value in state.items()}


def fill_optimizer(optimizer: Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Take back what `optimizer_tensors` returned; learning rates stay the optimiser's own."""
    states: dict[int, dict[str, Tensor]] = {}
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    for path, tensor in tensors.items():
        index, name = path.split("/")
        own = parameters[int(index)]
        # In the memory layout of the parameter: sums in another order have other last bits.
        laid_out = torch.empty_like(own).copy_(tensor) if tensor.shape == own.shape else tensor
        states.setdefault(int(index), {})[name] = laid_out
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": states, "param_groups": groups})


def save_archive(path: Path, archive: Archive) -> None:
    """Write an archive with checksums, whole or not at all."""
    tensors = {name: tensor.contiguous() for name, tensor in archive.tensors.items()}
    checks = {name: _checksum(tensor) for name, tensor in tensors.items()}
    meta = {"kind": archive.kind, "format": ARCHIVE_FORMAT, "checks": checks, **archive.meta}
    text = json.dumps(meta, sort_keys=True)
    # One entry alone: safetensors writes several in no fixed order.
    header = {"mechsearch": f"{crc32(text.encode())} {text}"}

    def write(partial: Path) -> None:
        try:
            save_file(tensors, partial, header)
        except SafetensorError as error:
            # While it writes, the system's error is in its text.
            found = re.search(r"os error (\d+)", str(error))
            if found is None:
                raise
            number = int(found[1])
            raise OSError(number, os.strerror(number)) from None

    write_whole(path, write)


def kind_of(path: Path) -> str:
    """Return what an archive is.

    Raises:
        MechSearchError: If the file is missing, damaged or not written by mechsearch.
    """
    header, _ = _read(path, "trained policy", whole=False)
    return str(_meta(header, str(path))["kind"])


def load_archive(path: Path, kind: str) -> Archive:
    """Read an archive.

    Raises:
        MechSearchError: If the file is missing, damaged or of another kind or format.
    """
    header, tensors = _read(path, kind)
    what = f"the {kind} at {path}"
    meta = _meta(header, what)
    checks = meta.pop("checks")
    for name, tensor in tensors.items():
        if checks.get(name) != _checksum(tensor):
            raise MechSearchError(f"{what} is damaged: {name!r} has another checksum")
    found = (meta.pop("kind"), meta.pop("format"))
    if found != (kind, ARCHIVE_FORMAT):
        raise MechSearchError(
            f"{path} holds a {found[0]} of format {found[1]}; expected a {kind} of format "
            f"{ARCHIVE_FORMAT}"
        )
    return Archive(kind, tensors, meta)


def save_progress(
    path: Path,
    kind: str,
    identity: Mapping[str, Any],
    network: nn.Module,
    optimizer: Optimizer,
    history: Sequence[Mapping[str, float]],
) -> None:
    """Write how far a training is, for `resume`.

    Args:
        path: The checkpoint.
        kind: What it is, as for `Archive`.
        identity: What makes the training this one, as JSON.
        network: Whose weights are kept.
        optimizer: Its own.
        history: What was logged so far.
    """
    tensors = prefixed("network", network.state_dict())
    tensors |= prefixed("adam", optimizer_tensors(optimizer))
    meta = {"identity": dict(identity), "history": list(history)}
    save_archive(path, Archive(kind, tensors, meta))


def resume(
    path: Path, kind: str, identity: Mapping[str, Any], network: nn.Module, optimizer: Optimizer
) -> list[dict[str, float]]:
    """Take up what `save_progress` wrote, if there is anything; return the history so far.

    Raises:
        MechSearchError: If it is of another training, or damaged.
    """
    if not path.exists():
        return []
    archive = load_archive(path, kind)
    stored = archive.meta["identity"]
    differing = ", ".join(name for name, value in identity.items() if stored.get(name) != value)
    if differing:
        raise MechSearchError(
            f"{path.parent} holds a training with another {differing}; name another folder"
        )
    fill(network, part(archive.tensors, "network"))
    fill_optimizer(optimizer, part(archive.tensors, "adam"))
    return list(archive.meta["history"])


def _read(path: Path, kind: str, whole: bool = True) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Return the header and, of the whole, the tensors of a safetensors file."""
    if not path.is_file():
        raise MechSearchError(f"no {kind} at {path}")
    try:
        with safe_open(path, framework="pt") as file:
            names = list(file.keys()) if whole else []
            return file.metadata() or {}, {name: file.get_tensor(name) for name in names}
    except (SafetensorError, ValueError, OSError) as error:
        raise MechSearchError(f"the {kind} at {path} is damaged: {error}") from None


def _checksum(tensor: Tensor) -> int:
    return crc32(tensor.detach().reshape(-1).view(torch.uint8).numpy().data)


def _meta(header: Mapping[str, str], what: str) -> dict[str, Any]:
    check, _, text = header.get("mechsearch", "").partition(" ")
    if check != str(crc32(text.encode())):
        raise MechSearchError(f"{what} is damaged, or was not written by mechsearch: its header")
    meta: dict[str, Any] = json.loads(text or "{}")
    if not {"kind", "format", "checks"} <= set(meta):
        raise MechSearchError(f"{what} was not written by mechsearch")
    return meta
