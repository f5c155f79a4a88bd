"""Worker processes that may fail, and the map over them; Ray has a module of its own."""

from mechsearch.processes.mapping import (
    PROCESSORS,
    TRIES,
    Input,
    Ledger,
    Mapper,
    Progress,
    Result,
    attempted,
    map_in_order,
    raise_failure,
    silent,
)
from mechsearch.processes.workers import START_LIMIT, STARTS, Failure, Worker, replies

__all__ = [
    "PROCESSORS",
    "STARTS",
    "START_LIMIT",
    "TRIES",
    "Failure",
    "Input",
    "Ledger",
    "Mapper",
    "Progress",
    "Result",
    "Worker",
    "attempted",
    "map_in_order",
    "raise_failure",
    "replies",
    "silent",
]
