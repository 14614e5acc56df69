"""Reads what was measured, on whatever machine, into tables in this project's names and units.

In: the files at ``measured=PATH``, whose bytes count in freshness, with the map of their columns and units; or, where
there is no path, `hardware_recordings` with the `active_recordings` of the design's arm, or the session that a rig
recorded. Out: `measured` (muscles over time, rectangular: every muscle of a trial has all of its samples, empty where
nothing was recorded), `measured_signals` (signals of any other machine; one of the two is empty), `measured_trials`,
`measured_muscles`, `measured_session`, and `measured_notes`, which says what was left out or derived. A file that does
not hold what it should is refused in one line.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import pandas as pd
from pydantic import BeforeValidator, model_validator

from pipeline.command import command_line
from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.errors import InputError, suggest
from pipeline.inputs import InputPath, read_json
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.machine import list_signals
from stages.science.recording.assembly import READINGS, Notes, note_missing
from stages.science.recording.blocks import arrange_records, begins_anew, list_blocks, split_records
from stages.science.recording.clock import count_time
from stages.science.recording.column_map import ColumnMap, is_one_trial, join_parts
from stages.science.recording.columns import RecordingError, check_rows, name_rows, quote
from stages.science.recording.description import UNTOLD, describe, list_arguments
from stages.science.recording.files.bags import is_bag
from stages.science.recording.files.readers import FileError, UnequalColumns, read_columns, read_header, read_samples
from stages.science.recording.headings import read_heading
from stages.science.recording.muscles import MUSCLE_COLUMNS, Session, describe_muscles, read_session
from stages.science.recording.odd_readings import note_odd_readings
from stages.science.recording.plausibility import check_readings, check_signals, suspect_clock
from stages.science.recording.sources import SAMPLE_KEY, Measurement, Source, read_executed, read_rig_session, tabulate
from stages.science.recording.uneven import even_out
from stages.science.recording.units import choose_unit

SAMPLES, META = "samples.parquet", "meta.json"
"""Files of a measured folder."""

TOGETHER = "several records go into one file, told apart by a column: columns.record=NAME"

NAMES = ("muscle", "part", "record")
"""Columns of text."""
RECORD_KEY = ("record", "time_s")

NEEDED = ("trial", "muscle", "time_s", "pressure_kpa", "force_n")
"""Columns without which muscles cannot be judged."""

reading = partial(column, float, nullable=True)
MEASURED = Table(
    "measured",
    "A sample of a muscle in a measured trial",
    {
        "trial": column(int, "trial of the dataset", low=0),
        "muscle": column(str, "name of the muscle"),
        "time_s": column(float, "time from the trial's start", unit="s", low=0),
        "pressure_command_kpa": reading("commanded gauge pressure as applied", unit="kPa", low=-100, high=1500),
        "pressure_kpa": reading("gauge pressure, sensor", unit="kPa", low=-100, high=1500),
        "contraction": reading("contraction, ratio of rest length", low=-0.5, high=0.8),
        "contraction_velocity_per_s": reading("velocity of contraction", unit="1/s", low=-50, high=50),
        "force_n": reading("tension at the load cell", unit="N", low=-2000, high=20000),
        "joint_angle_rad": reading("angle of the muscle's joint", unit="rad", low=-6.3, high=6.3),
        "joint_velocity_rad_per_s": reading("velocity of the joint's angle", unit="rad/s", low=-200, high=200),
    },
    key=("trial", "muscle", "time_s"),
)
MEASURED_SIGNALS = Table(
    "measured_signals",
    "A sample of a signal in a measured record",
    {
        "record": column(str, "samples that follow each other without a break"),
        "part": column(str, "what the record is for"),
        "trial": column(int, "block of the record that serves as a trial", low=0),
        "time_s": column(float, "time from the record's start", unit="s", low=0),
        "signal": column(str, "name, which ends in the unit"),
        "value": column(float, "in that unit", unit="as named", nullable=True),
    },
    key=("record", "signal", "time_s"),
)
MEASURED_TRIALS = Table(
    "measured_trials",
    "A measured trial",
    {
        "trial": column(int, "its number", low=0),
        "part": column(str, "what it is for"),
        "record": column(str, "record that it is a block of; empty for a trial of muscles"),
        "start_s": column(float, "start in the session or in the record", unit="s", nullable=True),
        "samples": column(int, "of each muscle or signal", low=1),
        "duration_s": column(float, "samples times the sampling period", unit="s", low=0),
    },
    key=("trial",),
)
MEASURED_MUSCLES = Table("measured_muscles", "A muscle of the measured machine", MUSCLE_COLUMNS, key=("muscle",))
MEASURED_SESSION = Table(
    "measured_session",
    "What was measured",
    {
        "source": column(str, "name of the file or folder, or the stage that recorded"),
        "kind": column(str, "which of the tables holds it", among=["muscles", "records"]),
        "sampling_rate_hz": column(float, "samples per second", unit="Hz", low=0),
        "load_cell_site": column(str, "where tension is measured", among=["muscle_tip", "joint_end", "unknown"]),
        "timing": column(str, "which sample a command acts on, in words"),
        "trials": column(int, "how many", low=1),
        "muscles": column(int, "how many", low=0),
    },
)
MEASURED_NOTES = Table(
    "measured_notes",
    "What was left out of what was measured, made from something else, or is odd in it",
    {"about": column(str, "column, muscle, trial or record"), "note": column(str, "what was done")},
)
DEFAULT_NAMES = {True: (*MEASURED.columns, "part"), False: ("record", "part", "time_s")}
"""Names that conf/measurement has, for muscles and for records."""
USUAL_JITTER = 0.01
"""As conf/measurement has it."""


def check_one(value: Any) -> Any:
    """Refuse a list of paths."""
    if isinstance(value, list):
        raise ValueError(f"expected one path, got {len(value)}; {TOGETHER}")
    return value


class SomethingMeasured(View):
    """There is a path, or a stage that records."""

    workflow: dict[str, Any]
    measured: Annotated[str | None, BeforeValidator(check_one)]

    @model_validator(mode="after")
    def _find_source(self) -> Self:
        if self.measured is None and not {"hardware", "blinded_session"} & set(self.workflow["stages"]):
            raise ValueError(
                "measured: expected what was measured (a folder with samples.parquet and meta.json, or one .parquet, "
                ".csv, .mat or .mcap file, or a ROS 2 bag), got null; set measured=PATH"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (SomethingMeasured,)

    measured: Annotated[InputPath | None, BeforeValidator(check_one)]
    columns: dict[str, str | None]
    units: dict[str, str | None]
    measurement: Measurement
    exoskeleton: Exoskeleton

    @model_validator(mode="after")
    def _know_columns(self) -> Self:
        known = [*MEASURED.columns, "part"] if self.measurement.kind == "muscles" else list(self.columns)
        for section, names in (("columns", self.columns), ("units", self.units)):
            for name in names:
                if name not in known:
                    raise ValueError(f"{section}: no column '{name}'; {suggest(name, known)}")
        for name, unit in self.units.items():
            choose_unit(name, unit)
        return self

    def map(self, muscles: pd.DataFrame) -> ColumnMap:
        """Return which column of a file is what, for the muscles that `read_known` returns."""
        given = self.measurement
        names = NEEDED if given.kind == "muscles" else [name for name in self.columns if name not in NAMES]
        needed = [name for name in names if name != "time_s" or given.rate_hz is None]
        return ColumnMap(self.columns, self.units, NAMES, needed, given.part_endings or [], given.rate_hz, muscles)


def show_map(cfg: Config) -> Iterator[str]:
    """Yield a line for each column, where it comes from and in which unit, and what is read in all."""
    if cfg.measured is None:
        yield "measured=null: from what the rig records"
        return
    file = find_samples(cfg.measured)
    yield f"{file}:"
    with about(str(file)):
        header = read_header(file)
        told = cfg.map(read_known(cfg.measured, cfg)).describe(header.names)
    yield from (f"  {each}" for each in [*header.remarks, *header.dropped, *told])
    tables = read_measured(cfg.measured, cfg)
    trials, rate = tables[MEASURED_TRIALS.name], tables[MEASURED_SESSION.name]["sampling_rate_hz"].iloc[0]
    shortest, longest = trials["duration_s"].min(), trials["duration_s"].max()
    lasting = f"{longest:g} s" if longest - shortest < 0.01 * longest else f"{shortest:.3g} to {longest:.3g} s"
    yield f"  {len(trials)} trial{'s' if len(trials) > 1 else ''} of {lasting} at {rate:g} Hz"
    notes = tables[MEASURED_NOTES.name].astype(str).drop_duplicates()
    yield from (f"  {which}: {note}" for which, note in notes.itertuples(index=False))


def describe_file(path: InputPath) -> list[str]:
    """Return what a file holds, as lines that end in the command line with the map of its columns."""
    file = find_samples(path)
    with about(str(file)):
        header = read_header(file)
        lines, guess = describe(read_columns(file), header, USUAL_JITTER, list_signals())
    kind = [] if guess.muscles else ["measurement=records"]
    told = [f"measured={quote(path)}", *kind, *list_arguments(guess, DEFAULT_NAMES[guess.muscles]), "plan=true"]
    open_places = [each for each in told if each.startswith("plant.") and UNTOLD in re.findall(r"\w+", each)]
    hint = f"put what it is in place of {UNTOLD}; " if open_places else ""
    last = f"to see how it would be read ({hint}plan=true writes nothing; without it, it runs):"
    return [f"{file}: {lines[0]}", *lines[1:], "", last, f"  {command_line(['workflow=discrepancy', *told])}"]


@stage(
    MEASURED, MEASURED_SIGNALS, MEASURED_TRIALS, MEASURED_MUSCLES, MEASURED_SESSION, MEASURED_NOTES, preview=show_map
)
def measurement(
    cfg: Config,
    ctx: Context,
    hardware_recordings: pd.DataFrame | None = None,
    active_recordings: pd.DataFrame | None = None,
    discrimination_recordings: pd.DataFrame | None = None,
    session_recordings: pd.DataFrame | None = None,
    session_machine: pd.DataFrame | None = None,
    further_recordings: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Read what was measured, under this project's names and units."""
    if cfg.measured is not None:
        tables = read_measured(cfg.measured, cfg)
    elif session_recordings is not None and session_machine is not None:
        tables = tabulate_muscles(read_rig_session(session_recordings, session_machine, further_recordings), cfg)
    else:
        if hardware_recordings is None or hardware_recordings.empty:
            raise InputError("measured: expected recordings of the hardware stage, got none; set measured=PATH")
        designed = hardware_recordings, active_recordings, discrimination_recordings
        tables = tabulate_muscles(read_executed(cfg.exoskeleton, *designed), cfg)
    return {
        each.name: tables.get(each.name, pd.DataFrame()).reindex(columns=list(each.columns))
        for each in measurement.writes
    }


def read_measured(path: InputPath, cfg: Config) -> dict[str, pd.DataFrame]:
    """Return the tables of what a path holds."""
    records = cfg.measurement.kind == "records"
    tables = tabulate_records(path, cfg) if records else tabulate_muscles(read_muscles(path, cfg), cfg)
    longest = tables[MEASURED_TRIALS.name].groupby("record")["duration_s"].sum().max()
    told = suspect_clock(tables[MEASURED_SESSION.name]["sampling_rate_hz"].iloc[0], longest)
    more = pd.DataFrame([("time_s", each) for each in told], columns=list(MEASURED_NOTES.columns))
    return {**tables, MEASURED_NOTES.name: pd.concat([tables[MEASURED_NOTES.name], more], ignore_index=True)}


def tabulate_muscles(source: Source, cfg: Config) -> dict[str, pd.DataFrame]:
    """Return the tables of recorded muscles."""
    with about(source.file):
        told, notes = tabulate(source, cfg.exoskeleton, cfg.measurement.largest_jitter)
    return {**vars(told), MEASURED_NOTES.name: pd.DataFrame(notes, columns=list(MEASURED_NOTES.columns))}


@contextmanager
def about(file: str) -> Iterator[None]:
    """Name the file in what is refused."""
    try:
        yield
    except FileError as error:
        raise InputError(str(error)) from None
    except RecordingError as error:
        raise InputError(f"{file}: {error}") from None


def find_samples(path: InputPath) -> Path:
    """Return the file that holds the samples; refuse a folder of other files."""
    if not is_folder(path):
        return Path(path)
    if not (Path(path) / SAMPLES).is_file():
        names = sorted((each.name for each in path.files), key=lambda each: each == META)
        told = ", ".join(names[:5] + ["..."] * (len(names) > 5)) or "none"
        remedy = (
            f"name one file, as measured={quote(str(Path(path) / names[0]))}; {TOGETHER}" if names else "name a file"
        )
        raise InputError(f"{path}: expected {SAMPLES} in this folder, got {told}; {remedy}")
    return Path(path) / SAMPLES


def is_folder(path: InputPath) -> bool:
    """Return whether a path is that of a folder with samples and meta.json; a bag is one file, of several parts."""
    return Path(path).is_dir() and not is_bag(Path(path))


def read_known(path: InputPath, cfg: Config) -> pd.DataFrame:
    """Return the muscles that may be there, under `MUSCLE_COLUMNS`."""
    session = read_meta(path)
    return session.describe() if session else describe_muscles(cfg.exoskeleton)


def read_meta(path: InputPath) -> Session | None:
    """Read how a folder describes its own machine, which a file does not."""
    if not is_folder(path):
        return None
    for name in (SAMPLES, META):
        if not (Path(path) / name).is_file():
            raise InputError(f"{path}: expected {SAMPLES} and {META} in this folder, {name} is missing")
    with about(str(Path(path) / META)):
        return read_session(read_json(Path(path) / META))


def read_muscles(path: InputPath, cfg: Config) -> Source:
    """Read a folder with samples and meta.json, or one file for the configured exoskeleton, and check its rows."""
    session = read_meta(path)
    known, file = read_known(path, cfg), find_samples(path)
    samples, notes = adopt_file(file, cfg, SAMPLE_KEY, known)
    with about(str(file)):
        check_rows(samples, SAMPLE_KEY)
        wrong = (samples["trial"] % 1.0 != 0.0) | (samples["trial"] < 0.0)
        if wrong.any():
            raise RecordingError(f"column trial: expected whole numbers from 0, got others in {name_rows(wrong)}")
        check_readings(samples, READINGS, MEASURED.columns, cfg.units)
    samples = samples.astype({"trial": int})
    if session is None:
        site, rate = cfg.exoskeleton.load_cell_site, cfg.measurement.rate_hz
        return Source(file.name, path, samples, known, "exoskeleton.muscles", site, "", rate, None, notes)
    folder, told = file.parent, (session.load_cell_site, session.timing, session.sampling_rate_hz, session, notes)
    return Source(folder.resolve().name, str(file), samples, known, str(folder / META), *told)


def adopt_file(file: Path, cfg: Config, key: Sequence[str], known: pd.DataFrame) -> tuple[pd.DataFrame, Notes]:
    """Read the configured columns of a file, split into records where the key asks for them.

    The notes are of samples that are counted, as the file has no column of time, and of what a bag's times are.
    """
    notes: Notes = []
    with about(str(file)):
        header = read_header(file)
        given = cfg.map(known)
        samples = given.adopt(read_wanted(file, given, header.names), header.names, header.units)
        if "time_s" not in samples and cfg.measurement.rate_hz is not None:
            samples = count_time(samples, [*key[:-1], "part"], cfg.measurement.rate_hz)
            notes.append(("time_s", f"counted at {cfg.measurement.rate_hz:g} Hz (measurement.rate_hz)"))
        if "record" in key:
            samples = split_records(samples)
    if is_one_trial(cfg.columns, header.names):
        notes.append(("trial", "the whole file is one, number 0"))
    return samples, notes + [(file.name, each) for each in [*header.dropped, *(header.remarks if is_bag(file) else [])]]


def read_wanted(file: Path, given: ColumnMap, names: Sequence[str]) -> pd.DataFrame:
    """Read the columns that the map names, of each part behind each other where the ends of names tell parts."""
    if not given.endings:
        try:
            return read_samples(file, set(given.wanted))
        except UnequalColumns as error:
            raise InputError(
                f"{error}; if the ends of their names tell parts, as in uEst and uVal, map u and set "
                "measurement.part_endings=[Est,Val]; else write them as one table"
            ) from None
    parts = given.part_columns(names)
    return join_parts({end: read_samples(file, own).rename(columns=own) for end, own in parts.items()})


def list_stated(file: Path, cfg: Config, signals: Sequence[str]) -> dict[str, str | None]:
    """Return by signal the unit that the configuration or a heading of the file states."""
    told = read_header(file).units
    sources = {name: cfg.columns.get(name) or name for name in signals}
    headed = {name: read_heading(source, told.get(source, "")).unit for name, source in sources.items()}
    return {name: cfg.units.get(name) or headed[name] for name in signals}


def tabulate_records(path: InputPath, cfg: Config) -> dict[str, pd.DataFrame]:
    """Return the tables of records of any signals."""
    file = find_samples(path)
    known = describe_muscles(cfg.exoskeleton)
    frame, notes = adopt_file(file, cfg, RECORD_KEY, known)
    signals = [name for name in cfg.columns if name not in NAMES and name != "time_s"]
    given = cfg.measurement
    anew = frame["part"].eq(frame["part"].shift()) & begins_anew(frame)
    if anew.any() and (cfg.columns.get("record") or "record") not in read_header(file).names:
        notes.append(("time_s", f"begins anew in {name_rows(anew)}, as another record"))
    with about(str(file)):
        notes += note_missing(frame, signals)
        notes += note_odd_readings(frame, signals)
        frame = even_out(frame, signals, given.largest_jitter, notes)
        check_rows(frame, RECORD_KEY)
        check_signals(frame, signals, list_stated(file, cfg, signals))
        frame, rate = arrange_records(frame, signals, given.blocks, given.rate_hz, given.largest_jitter, notes)
    trials = list_blocks(frame, rate)
    row = (file.name, "records", rate, "unknown", "", len(trials), 0)
    long = frame.melt(["record", "part", "trial", "time_s"], signals, "signal", "value")
    return {
        MEASURED_SIGNALS.name: long[list(MEASURED_SIGNALS.columns)],
        MEASURED_TRIALS.name: trials[list(MEASURED_TRIALS.columns)],
        MEASURED_SESSION.name: pd.DataFrame([row], columns=list(MEASURED_SESSION.columns)),
        MEASURED_NOTES.name: pd.DataFrame(notes, columns=list(MEASURED_NOTES.columns)),
    }
