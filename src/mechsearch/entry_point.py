"""What users name as `package.module:name`: policies, teachers, rewards and algorithms."""

import traceback
from collections.abc import Callable, Sequence
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
    except Exception as error:
        raise MechSearchError(
            f"{purpose} {spec!r} cannot be imported: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, name, None)
    if not callable(found):
        public = [key for key, value in vars(module).items() if callable(value)]
        names = ", ".join(key for key in sorted(public) if not key.startswith("_")) or "none"
        raise MechSearchError(f"{module_name} has no function or class {name!r}; it has {names}")
    return found


def called(function: Callable[..., Any], purpose: str, spec: str, *arguments: Any) -> Any:
    """Return what a user's function or class gives for arguments.

    Args:
        function: As `load_entry_point` returned it.
        purpose: What it is for, as there.
        spec: Its name in errors.
        arguments: What it is handed.

    Raises:
        MechSearchError: If it raises anything, such as for the number of arguments; says where.
    """
    try:
        return function(*arguments)
    except MechSearchError:
        raise
    except Exception as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename != __file__]
        place = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
        raise MechSearchError(
            f"{purpose} {spec!r}, called with {len(arguments) or 'no'} arguments, raised "
            f"{type(error).__name__}: {error}{place}"
        ) from error


def conforming(found: Any, purpose: str, spec: str, members: Sequence[str]) -> Any:
    """Return what a user gave, once it is certain that it has all that a protocol asks for.

    Args:
        found: What was given.
        purpose: What it is for, as in `load_entry_point`.
        spec: Its name in errors.
        members: Of its protocol, methods with their arguments, such as "act(obs)".

    Raises:
        MechSearchError: If it is none, naming what it lacks.
    """
    missing = [name for m in members if not hasattr(found, name := m.partition("(")[0])]
    if missing:
        raise MechSearchError(
            f"{purpose} {spec!r} gives a {type(found).__name__} without {', '.join(missing)}; "
            f"a {purpose} has {', '.join(members[:-1])} and {members[-1]}"
        )
    return found
