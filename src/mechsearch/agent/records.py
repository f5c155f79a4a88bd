"""Frozen dataclasses as JSON and back, checked field by field."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from mechsearch.types import MechSearchError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Record = TypeVar("Record", bound=DataclassInstance)
else:
    Record = TypeVar("Record")


def record_from_json(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """Return a dataclass, nested ones included, from what `dataclasses.asdict` and JSON made.

    Raises:
        MechSearchError: If a field is unknown; fields left out keep their defaults.
    """
    hints = get_type_hints(kind)
    known = [field.name for field in fields(kind) if field.init]
    unknown = [name for name in data if name not in known]
    if unknown:
        raise MechSearchError(
            f"{kind.__name__} has no {', '.join(unknown)}; it has {', '.join(known)}"
        )
    return kind(**{name: _value(hints[name], value) for name, value in data.items()})


def _value(kind: Any, value: Any) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        return record_from_json(kind, value)
    return tuple(value) if isinstance(value, list) else value
