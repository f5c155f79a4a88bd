"""Frozen dataclasses as JSON and back, checked field by field."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin, get_type_hints

from mechsearch.types import MechSearchError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Record = TypeVar("Record", bound=DataclassInstance)
else:
    Record = TypeVar("Record")


def record_from_json(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """Return a dataclass, nested ones included, from what `dataclasses.asdict` and JSON made.

    Raises:
        MechSearchError: If a field is unknown or its value of another kind; fields left out keep
            their defaults.
    """
    if not isinstance(data, Mapping):
        raise MechSearchError(f"a {kind.__name__} is {data!r}; expected values by field")
    hints = get_type_hints(kind)
    known = [field.name for field in fields(kind) if field.init]
    unknown = [name for name in data if name not in known]
    if unknown:
        raise MechSearchError(
            f"{kind.__name__} has no {', '.join(unknown)}; it has {', '.join(known)}"
        )
    return kind(**{name: _value(hints[name], name, value) for name, value in data.items()})


def _value(kind: Any, name: str, value: Any) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        return record_from_json(kind, value)
    if get_origin(kind) is tuple and isinstance(value, list):
        inner = get_args(kind)[0]
        return tuple(_value(inner, name, entry) for entry in value)
    expected = (int, float) if kind is float else (get_origin(kind) or kind)
    # JSON's true is no number.
    if isinstance(value, bool) != (kind is bool) or not isinstance(value, expected):
        raise MechSearchError(f"{name} is {value!r}; expected {getattr(kind, '__name__', kind)}")
    return value
