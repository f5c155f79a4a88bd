"""Worker processes that may fail, and the map over them; Ray has a module of its own."""

from mechsearch.processes.mapping import PROCESSORS, Input, Mapper, Result, map_in_order
from mechsearch.processes.progress import Progress, bars, silent
from mechsearch.processes.workers import Failure, Worker, process_context, replies
