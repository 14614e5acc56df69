"""Recordings that others made: foreign columns, units, clocks and gaps.

Frames as they were read flow in, with what is known of the machine; tidy frames in this project's names and units flow
out, or a `RecordingError` that names column and rows. No path is known here.
"""

from stages.recording.assembly import Notes, choose_muscles, complete, read_parts
from stages.recording.blocks import WHOLE, list_blocks, number_blocks, split_records
from stages.recording.clock import find_rate, regularise
from stages.recording.columns import RecordingError, adopt, check_rows, tell_rows
from stages.recording.muscles import MUSCLE_COLUMNS, Session, describe_muscles, read_session
from stages.recording.plausibility import check_plausible
from stages.recording.units import known_units, own_unit
from stages.recording.whole_sessions import SessionFrames, tabulate_session

__all__ = [
    "MUSCLE_COLUMNS",
    "WHOLE",
    "Notes",
    "RecordingError",
    "Session",
    "SessionFrames",
    "adopt",
    "check_plausible",
    "check_rows",
    "choose_muscles",
    "complete",
    "describe_muscles",
    "find_rate",
    "known_units",
    "list_blocks",
    "number_blocks",
    "own_unit",
    "read_parts",
    "read_session",
    "regularise",
    "split_records",
    "tabulate_session",
    "tell_rows",
]
