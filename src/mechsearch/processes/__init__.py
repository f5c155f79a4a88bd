"""Worker processes that may fail, and the map over them; Ray has a module of its own."""

from mechsearch.processes.mapping import PROCESSORS, Mapper, Progress, map_in_order, silent
from mechsearch.processes.workers import Failure, Worker, replies

__all__ = [
    "PROCESSORS",
    "Failure",
    "Mapper",
    "Progress",
    "Worker",
    "map_in_order",
    "replies",
    "silent",
]
