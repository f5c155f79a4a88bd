"""How anything is written and read: whole, locked, checked; tensors have a module of their own."""

from mechsearch.files.arrays import ARRAY_DAMAGE, read_arrays
from mechsearch.files.records import (
    CHECK_MARK,
    RECORD,
    append_line,
    differences,
    line_of,
    read_json,
    read_lines,
    read_record,
    record_from_json,
    record_of,
    write_json,
    write_record,
)
from mechsearch.files.whole import (
    REFUSALS,
    NotWrittenError,
    alone,
    check_place,
    locked,
    naming,
    not_written,
    write_text,
    write_whole,
)

__all__ = [
    "ARRAY_DAMAGE",
    "CHECK_MARK",
    "RECORD",
    "REFUSALS",
    "NotWrittenError",
    "alone",
    "append_line",
    "check_place",
    "differences",
    "line_of",
    "locked",
    "naming",
    "not_written",
    "read_arrays",
    "read_json",
    "read_lines",
    "read_record",
    "record_from_json",
    "record_of",
    "write_json",
    "write_record",
    "write_text",
    "write_whole",
]
