"""Recordings that others made: foreign columns, units, clocks and gaps.

Frames as they were read flow in, with what is known of the machine; tidy frames in this project's names and units flow
out, or a `RecordingError` that names column and rows. No path is known here.
"""

from stages.recording.adoption import adopt_rows
from stages.recording.assembly import Notes, choose_muscles, complete, read_parts
from stages.recording.blocks import WHOLE, arrange_records, list_blocks, number_blocks, split_records
from stages.recording.clock import count_time, find_rate, regularise
from stages.recording.column_map import ColumnMap
from stages.recording.columns import RecordingError, adopt, check_rows, tell_rows
from stages.recording.completion import derive_velocity
from stages.recording.dates import read_dates
from stages.recording.description import describe, list_arguments, quote
from stages.recording.endings import join_parts, name_parts
from stages.recording.guessing import Guess, guess_map
from stages.recording.headings import check_headings, read_heading
from stages.recording.muscles import MUSCLE_COLUMNS, Session, describe_muscles, read_session
from stages.recording.plausibility import check_plausible
from stages.recording.rates import equalise, find_rates
from stages.recording.trials import find_starts, list_trials
from stages.recording.uneven import even_out
from stages.recording.units import convert, known_units, own_unit, read_unit
from stages.recording.whole_sessions import SessionFrames, tabulate_session
from stages.recording.wide import expand, is_one_trial, is_wide, list_sources

__all__ = [
    "MUSCLE_COLUMNS",
    "WHOLE",
    "ColumnMap",
    "Guess",
    "Notes",
    "RecordingError",
    "Session",
    "SessionFrames",
    "adopt",
    "adopt_rows",
    "arrange_records",
    "check_headings",
    "check_plausible",
    "check_rows",
    "choose_muscles",
    "complete",
    "convert",
    "count_time",
    "derive_velocity",
    "describe",
    "describe_muscles",
    "equalise",
    "even_out",
    "expand",
    "find_rate",
    "find_rates",
    "find_starts",
    "guess_map",
    "is_one_trial",
    "is_wide",
    "join_parts",
    "known_units",
    "list_arguments",
    "list_blocks",
    "list_sources",
    "list_trials",
    "name_parts",
    "number_blocks",
    "own_unit",
    "quote",
    "read_dates",
    "read_heading",
    "read_parts",
    "read_session",
    "read_unit",
    "regularise",
    "split_records",
    "tabulate_session",
    "tell_rows",
]
