"""How anything is written and read: whole, locked, checked; tensors have a module of their own."""

from mechsearch.files.arrays import ARRAY_DAMAGE, read_arrays
from mechsearch.files.layout import (
    CHECKPOINT_FILE,
    CHECKPOINTS_FOLDER,
    CONFIG_FILE,
    CURVES_FILE,
    EVALUATIONS_FOLDER,
    EVENTS_FOLDER,
    FINISHED_FILE,
    INPUTS_FILE,
    JOURNAL_FILE,
    METRICS_FILE,
    NETWORK_FILE,
    PLAN_FILE,
    POLICIES_FOLDER,
    POLICY_FILE,
    PROGRESS_FILE,
    RUNS_FOLDER,
    SCORES_SUFFIX,
    SPEED_FILE,
    SUMMARY_FILE,
    cache_folder,
)
from mechsearch.files.provenance import crossed, fingerprint, mixed
from mechsearch.files.records import (
    CHECK_MARK,
    append_line,
    check_kinds,
    differing_fields,
    line_of,
    read_content,
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
    check_absent,
    check_place,
    locked,
    naming,
    not_written,
    write_folder,
    write_text,
    write_whole,
)
