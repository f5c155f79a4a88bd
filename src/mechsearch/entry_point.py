"""What users name as `package.module:name`: policies, teachers, rewards and algorithms."""

from importlib import import_module
from typing import Any

from mechsearch.types import MechSearchError


def is_entry_point(spec: str) -> bool:
    """Return whether a text has the form `package.module:name`."""
    module, colon, name = spec.partition(":")
    return bool(colon) and all(part.isidentifier() for part in (*module.split("."), name))


def load_entry_point(spec: str, purpose: str) -> Any:
    """Return the function or class that `package.module:name` names.

    Args:
        spec: Where it is.
        purpose: What it is for, such as "policy", for errors.

    Raises:
        MechSearchError: If the module cannot be imported, or has nothing callable of that name.
    """
    module_name, _, name = spec.partition(":")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        raise MechSearchError(f"{purpose} {spec!r} cannot be imported: {error}") from None
    found = getattr(module, name, None)
    if not callable(found):
        public = [key for key, value in vars(module).items() if callable(value)]
        names = ", ".join(key for key in sorted(public) if not key.startswith("_")) or "none"
        raise MechSearchError(f"{module_name} has no function or class {name!r}; it has {names}")
    return found
