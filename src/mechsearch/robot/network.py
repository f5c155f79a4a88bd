"""Networks as `mechsearch export` writes them: for onnxruntime, each beside what it is."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from mechsearch.files import read_json
from mechsearch.types import Array, MechSearchError, check_extra

FORMAT = 2
"""Of what is exported; others are refused."""

OPSET = 18
"""Version of the operators of ONNX that networks are written in."""


@dataclass(frozen=True)
class Exported:
    """What stands beside an exported network; policies, segmenters and graspers add their own.

    Attributes:
        format: See `FORMAT`.
        mechsearch: Version that wrote it.
        name: Of the policy, segmenter or gripper.
        kind: What it gives.
        network: SHA-256 of the network's file.
        opset: See `OPSET`.
        inputs: By name: shape, dtype and unit each.
        outputs: Likewise.
        image_size: Side of the images that it looks at [px].
        card: What is known of its training.
    """

    format: int
    mechsearch: str
    name: str
    kind: str
    network: str
    opset: int
    inputs: Mapping[str, Any]
    outputs: Mapping[str, Any]
    image_size: int
    card: Mapping[str, Any]


D = TypeVar("D", bound=Exported)


def places(folder: Path, what: str) -> tuple[Path, Path]:
    """Return where a "policy", "segmenter" or "grasps" has its description and its network."""
    return folder / f"{what}.json", folder / f"{what}.onnx"


def tensors(rows: dict[str, tuple[Sequence[Any], str, str]]) -> dict[str, Any]:
    """Return what a description says of tensors, given shape, dtype and unit of each."""
    return {n: dict(zip(("shape", "dtype", "unit"), row, strict=True)) for n, row in rows.items()}


def open_exported(
    folder: Path, what: str, description: type[D], kinds: Sequence[str]
) -> tuple[D, "Network"]:
    """Return what `mechsearch export` wrote; needs the `robot` extra.

    Args:
        folder: Of both files.
        what: See `places`.
        description: Record of what stands beside the network.
        kinds: That can be used.

    Raises:
        MechSearchError: If it is missing, damaged, or written for another version.
    """
    beside, place = places(folder, what)
    found = read_json(beside, f"exported {what}")
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        said = found.get("format") if isinstance(found, dict) else None
        written = found.get("mechsearch", "an unknown version") if isinstance(found, dict) else "?"
        raise MechSearchError(
            f"{beside} is of format {said}, written by mechsearch {written}; mechsearch "
            f"{version('mechsearch')} reads format {FORMAT}: export the {what} again with it"
        )
    names = {field.name for field in fields(description)}
    if missing := sorted(names - set(found)):
        raise MechSearchError(f"the exported {what} at {beside} is damaged: it lacks {missing[0]}")
    if found["kind"] not in kinds:
        raise MechSearchError(
            f"{beside} describes {found['kind']!r}; choose one of {', '.join(kinds)}"
        )
    if not place.is_file():
        raise MechSearchError(
            f"no network at {place}; expected what `mechsearch export {what}` wrote"
        )
    content = place.read_bytes()
    if hashlib.sha256(content).hexdigest() != found["network"]:
        raise MechSearchError(
            f"{place} is not the network that {beside.name} beside it describes; export the "
            f"{what} again"
        )
    return description(**{name: found[name] for name in names}), Network(content, what)


class Network:
    """A network in a session of one thread."""

    def __init__(self, content: bytes, what: str) -> None:
        """Take the bytes of an exported "policy", "segmenter" or "grasps"."""
        check_extra(f"an exported {what}", "robot")
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        providers = ["CPUExecutionProvider"]
        self._session = onnxruntime.InferenceSession(content, options, providers)
        self._names = [output.name for output in self._session.get_outputs()]

    def __call__(self, **inputs: Array) -> dict[str, Array]:
        """Return its outputs by name."""
        return dict(zip(self._names, self._session.run(None, inputs), strict=True))
