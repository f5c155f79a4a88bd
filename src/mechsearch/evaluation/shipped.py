"""Trained policies that come with the package, each with a card that says what it was made from."""

from pathlib import Path
from typing import Any

from mechsearch.files import read_json
from mechsearch.types import MechSearchError

SHIPPED = ("single", "dual")
"""Conditions for which a trained policy is shipped, and the policies' names."""

_FOLDER = Path(__file__).with_name("trained")


def shipped_file(name: str) -> Path:
    """Return the weights (.safetensors) of a shipped policy.

    Raises:
        MechSearchError: If there is none of that name.
    """
    if name not in SHIPPED:
        raise MechSearchError(f"no policy {name!r} is shipped; choose one of {', '.join(SHIPPED)}")
    return _FOLDER / f"{name}.safetensors"


def card(name: str) -> dict[str, Any]:
    """Return a shipped policy's card: its data, configuration, seed and scores.

    Raises:
        MechSearchError: If there is none of that name, or the card is damaged.
    """
    found: dict[str, Any] = read_json(shipped_file(name).with_suffix(".json"), "policy's card")
    return found
