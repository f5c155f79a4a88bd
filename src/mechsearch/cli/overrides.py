"""Options that change only what is said of a record, such as of the task that a run was made in."""

from dataclasses import fields, is_dataclass, make_dataclass, replace
from functools import cache
from typing import Annotated, Any, get_type_hints

import tyro

_METAVARS = {int: "INT", float: "FLOAT", str: "STR", bool: "{True,False}"}


@cache
def optional(kind: type[Any], flat: tuple[str, ...] = ()) -> type[Any]:
    """Return a dataclass like another, nested ones included, whose values are None by default.

    Its docstrings are the other's, and so are the options that it makes on a command line.

    Args:
        kind: The other.
        flat: Names of nested ones whose options do not begin with their name.
    """
    hints = get_type_hints(kind)
    made: list[tuple[str, Any, Any]] = []
    for entry in fields(kind):
        hint: Any = hints[entry.name]
        if isinstance(hint, type) and is_dataclass(hint):
            nested = optional(hint)
            name = "" if entry.name in flat else None
            made.append((entry.name, Annotated[nested, tyro.conf.arg(name=name)], nested()))
        else:
            shown = tyro.conf.arg(help_behavior_hint="", metavar=_METAVARS.get(hint))
            made.append((entry.name, Annotated[hint | None, shown], None))
    namespace = {"__doc__": kind.__doc__, "__module__": kind.__module__}
    return make_dataclass(kind.__name__, made, frozen=True, namespace=namespace)


def overridden(base: Any, said: Any) -> Any:
    """Return a record changed by the values of its `optional` twin that are not None."""
    changes = {}
    for entry in fields(said):
        value = getattr(said, entry.name)
        if is_dataclass(value):
            value = overridden(getattr(base, entry.name), value)
        if value is not None:
            changes[entry.name] = value
    return replace(base, **changes)
