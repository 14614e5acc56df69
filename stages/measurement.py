"""Reads what was measured, on whatever machine, into tables in this project's names and units.

In: the files at ``measured=PATH``, whose bytes count in freshness, with the map of their columns and units; or, where
there is no path, `hardware_recordings`. Out: `measured` (muscles over time, rectangular: every muscle of a trial has
all of its samples, empty where nothing was recorded), `measured_signals` (signals of any other machine; one of the two
is empty), `measured_trials`, `measured_muscles`, `measured_session`, and `measured_notes`, which says what was left out
or derived. A file that does not hold what it should is refused in one line.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pandas as pd
import pyarrow
from pydantic import Field, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.errors import InputError, suggest
from pipeline.inputs import InputPath
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.plant import Exoskeleton
from stages.recording import (
    RecordingError,
    adopt,
    check_plausible,
    check_rows,
    derive_contraction,
    derive_velocity,
    describe_muscles,
    find_rate,
    read_session,
    regularise,
    tell_rows,
)

NAMES = ("muscle", "part", "record")
"""Columns of text."""

NEEDED = ("trial", "muscle", "time_s", "pressure_kpa", "force_n")
"""Columns without which muscles cannot be judged."""

WITHOUT_PART = "given"
"""Part of a trial that the file does not say."""

MEASURED = Table(
    "measured",
    "A sample of a muscle in a measured trial",
    {
        "trial": column(int, "trial of the session", low=0),
        "muscle": column(str, "name of the muscle"),
        "time_s": column(float, "time from the trial's start", unit="s", low=0),
        "pressure_command_kpa": column(
            float, "commanded gauge pressure as applied", unit="kPa", low=-100, high=1500, nullable=True
        ),
        "pressure_kpa": column(float, "gauge pressure, sensor", unit="kPa", low=-100, high=1500, nullable=True),
        "contraction": column(float, "contraction, ratio of rest length", low=-0.5, high=0.8, nullable=True),
        "contraction_velocity_per_s": column(
            float, "velocity of contraction", unit="1/s", low=-50, high=50, nullable=True
        ),
        "force_n": column(float, "tension at the load cell", unit="N", low=-2000, high=20000, nullable=True),
        "joint_angle_rad": column(float, "angle of the muscle's joint", unit="rad", low=-6.3, high=6.3, nullable=True),
        "joint_velocity_rad_per_s": column(
            float, "velocity of the joint's angle", unit="rad/s", low=-200, high=200, nullable=True
        ),
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
MEASURED_MUSCLES = Table(
    "measured_muscles",
    "A muscle of the measured machine",
    {
        "muscle": column(str, "its name"),
        "joint": column(str, "joint that it moves"),
        "role": column(str, "agonists raise the angle", among=["agonist", "antagonist"]),
        "type": column(str, "its type"),
        "rest_length_m": column(float, "length without pressure and load", unit="m", low=0),
        "nominal_diameter_m": column(float, "inner diameter without pressure", unit="m", low=0),
        "moment_arm_m": column(float, "radius of the joint's pulley", unit="m", low=0),
        "contraction_at_angle_0": column(float, "contraction at angle 0"),
        "sign": column(int, "1 when it shortens as the angle grows", among=[-1, 1]),
        "valve_tau_s": column(float, "time constant of the valve, to begin with", unit="s", nullable=True),
        "braid_angle_deg": column(float, "braid angle at rest, to begin with", unit="degrees", nullable=True),
        "contraction_factor": column(float, "factor on contraction, to begin with", nullable=True),
        "damping_n_s": column(float, "tension lost per velocity, to begin with", unit="N s", nullable=True),
    },
    key=("muscle",),
)
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
    "What was left out of what was measured, or made from something else",
    {"about": column(str, "column, muscle or trial"), "note": column(str, "what was done")},
)
READINGS = tuple(MEASURED.columns)[3:]


class Measurement(Section):
    """How recordings are read."""

    kind: Literal["muscles", "records"]
    largest_jitter: Annotated[float, Field(ge=0.0, le=0.4)]
    blocks: Annotated[int, Field(ge=2, le=10000)]


class Stages(View):
    """Which stages the workflow has."""

    stages: list[str]


class SomethingMeasured(View):
    """There is a path, or a stage that records."""

    workflow: Stages
    measured: str | None

    @model_validator(mode="after")
    def _find_source(self) -> Self:
        if self.measured is None and "hardware" not in self.workflow.stages:
            raise ValueError(
                "measured: expected what was measured (a folder with samples.parquet and meta.json, or one .parquet or "
                ".csv file), got null; set measured=PATH"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (SomethingMeasured,)

    measured: InputPath | None
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
        return self


@dataclass(frozen=True)
class Source:
    """Samples as they were read, and what is known of the machine.

    Parameters
    ----------
    name : str
        For the session's table.
    file : str
        Which messages name.
    samples : DataFrame
        This project's columns; its index counts the file's rows.
    muscles : DataFrame
        A row for each that may be there.
    load_cell_site, timing : str
        As told.
    rate_hz : float or None
        As told; None where the times must say.
    starts : callable
        Returns the start of each trial, or nan, from their numbers.
    told_in : str
        What describes the muscles, for messages.
    """

    name: str
    file: str
    samples: pd.DataFrame
    muscles: pd.DataFrame
    load_cell_site: str
    timing: str
    rate_hz: float | None
    starts: Any
    told_in: str


@stage(MEASURED, MEASURED_SIGNALS, MEASURED_TRIALS, MEASURED_MUSCLES, MEASURED_SESSION, MEASURED_NOTES)
def measurement(cfg: Config, ctx: Context, hardware_recordings: pd.DataFrame | None = None) -> dict[str, pd.DataFrame]:
    """Read what was measured, under this project's names and units."""
    if cfg.measurement.kind == "records":
        raise InputError("measurement.kind: records cannot be read yet")
    source = read_recordings(hardware_recordings, cfg) if cfg.measured is None else read_muscles(cfg.measured, cfg)
    with about(source.file):
        return tabulate(source, cfg)


@contextmanager
def about(file: str) -> Iterator[None]:
    """Name the file in what is refused."""
    try:
        yield
    except RecordingError as error:
        raise InputError(f"{file}: {error}") from None


def read_muscles(path: InputPath, cfg: Config) -> Source:
    """Read a folder with samples.parquet and meta.json, or one file and the configured exoskeleton."""
    if not Path(path).is_dir():
        samples = adopt_muscles(Path(path), cfg)
        known = describe_muscles(cfg.exoskeleton)
        site = cfg.exoskeleton.load_cell_site
        return Source(Path(path).name, path, samples, known, site, "", None, None, "exoskeleton.muscles")
    file, meta = Path(path) / "samples.parquet", Path(path) / "meta.json"
    for each in (file, meta):
        if not each.is_file():
            raise InputError(f"{path}: expected samples.parquet and meta.json in this folder, {each.name} is missing")
    with about(str(meta)):
        session = read_session(read_json(meta))
    return Source(
        Path(path).resolve().name,
        str(file),
        adopt_muscles(file, cfg),
        session.describe(),
        session.load_cell_site,
        session.timing,
        session.sampling_rate_hz,
        session.starts_of,
        str(meta),
    )


def adopt_muscles(file: Path, cfg: Config) -> pd.DataFrame:
    """Read a file's columns of muscles and check their rows."""
    columns = {name: cfg.columns.get(name) for name in ("trial", "part", *tuple(MEASURED.columns)[1:])}
    frame = read_file(file)
    with about(str(file)):
        if frame.empty:
            raise RecordingError("expected samples, got no rows")
        samples = adopt(frame, columns, cfg.units, NAMES, NEEDED)
        check_rows(samples, ("trial", "muscle", "time_s"))
        fraction = samples["trial"] % 1.0 != 0.0
        if fraction.any() or (samples["trial"] < 0).any():
            raise RecordingError(
                f"column trial: expected whole numbers from 0, in {tell_rows(fraction | (samples['trial'] < 0))}"
            )
        for name in READINGS:
            if name in samples:
                low, high = bounds_of(name)
                check_plausible(samples[name], name, low, high, cfg.units.get(name))
    return samples.astype({"trial": int})


def bounds_of(name: str) -> tuple[float, float]:
    """Return the range that `MEASURED` declares for a column."""
    limits = [check.statistics for check in MEASURED.columns[name].checks]
    return float(limits[0]["min_value"]), float(limits[1]["max_value"])


def read_file(path: Path) -> pd.DataFrame:
    """Read a foreign table.

    Raises
    ------
    InputError
        When the file is neither Parquet nor text in columns, whatever the reason.
    """
    if path.suffix.lower() not in (".parquet", ".csv"):
        raise InputError(f"{path}: expected a .parquet or .csv file, got '{path.suffix}'")
    try:
        return pd.read_csv(path) if path.suffix.lower() == ".csv" else pd.read_parquet(path).reset_index(drop=True)
    except (OSError, ValueError, KeyError, TypeError, pyarrow.ArrowException) as error:
        told = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as {path.suffix[1:].upper()} ({told[:120]})") from None


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError
        Naming the line that breaks it.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: expected JSON, got {error.msg} in line {error.lineno}") from None
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def read_recordings(recordings: pd.DataFrame | None, cfg: Config) -> Source:
    """Take what the hardware stage recorded for what was measured."""
    if recordings is None or recordings.empty:
        raise InputError("measured: expected recordings of the hardware stage, got none; set measured=PATH")
    by = ["participant", "experiment", "position"]
    samples = recordings[list(MEASURED.columns)[1:]].assign(
        trial=recordings.groupby(by, sort=False).ngroup(), part=recordings["participant"]
    )
    timing = "command held until the next sample; sensors sample before the command acts"
    known = describe_muscles(cfg.exoskeleton)
    site = cfg.exoskeleton.load_cell_site
    rate = cfg.exoskeleton.sampling_rate_hz
    return Source("hardware", "hardware_recordings", samples, known, site, timing, rate, None, "exoskeleton.muscles")


def tabulate(source: Source, cfg: Config) -> dict[str, pd.DataFrame]:
    """Return all tables of a recording of muscles."""
    notes: list[tuple[str, str]] = []
    samples, muscles = choose_muscles(source, notes)
    rate = find_rate(samples, ("trial", "muscle"), source.rate_hz)
    parts = read_parts(samples)
    samples, starts = regularise(samples, "trial", ["muscle"], rate, cfg.measurement.largest_jitter)
    samples = complete(samples, muscles, rate, cfg, notes)
    trials = samples.groupby("trial")["time_s"].nunique()
    numbers = [int(each) for each in trials.index]
    told = source.starts(numbers) if source.starts else find_starts(starts)
    session = {
        "source": source.name,
        "kind": "muscles",
        "sampling_rate_hz": rate,
        "load_cell_site": source.load_cell_site,
        "timing": source.timing,
        "trials": len(trials),
        "muscles": len(muscles),
    }
    return {
        MEASURED.name: samples[list(MEASURED.columns)],
        MEASURED_SIGNALS.name: pd.DataFrame(columns=list(MEASURED_SIGNALS.columns)),
        MEASURED_TRIALS.name: pd.DataFrame(
            {
                "trial": trials.index,
                "part": parts.loc[trials.index].to_numpy(),
                "record": "",
                "start_s": np.asarray(told, dtype=float),
                "samples": trials.to_numpy(),
                "duration_s": trials.to_numpy() / rate,
            }
        ),
        MEASURED_MUSCLES.name: muscles,
        MEASURED_SESSION.name: pd.DataFrame([session]),
        MEASURED_NOTES.name: pd.DataFrame(notes, columns=list(MEASURED_NOTES.columns)),
    }


def find_starts(starts: pd.Series) -> list[float]:
    """Return when each trial started, s; nan where every trial's clock begins at zero."""
    return [float(each) if starts.any() else np.nan for each in starts]


def choose_muscles(source: Source, notes: list[tuple[str, str]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the samples and descriptions of the muscles that have data."""
    samples, known = source.samples, list(source.muscles["muscle"])
    strange = ~samples["muscle"].isin(known)
    if strange.any():
        name = str(samples.loc[strange, "muscle"].iloc[0])
        raise RecordingError(
            f"column muscle: {source.told_in} has no muscle '{name}' of {tell_rows(strange)}; {suggest(name, known)}"
        )
    used = []
    for name in known:
        rows = samples[samples["muscle"] == name]
        empty = [each for each in ("pressure_kpa", "force_n") if rows[each].isna().all()]
        if empty:
            notes.append(
                (name, "left out: no rows" if rows.empty else f"left out: nothing in column {' and '.join(empty)}")
            )
        else:
            used.append(name)
    if not used:
        raise RecordingError("columns pressure_kpa and force_n: expected values of some muscle, got none")
    order = pd.Categorical(samples["muscle"], used)
    chosen = samples.assign(muscle=order).dropna(subset="muscle").sort_values(["trial", "muscle"], kind="stable")
    chosen = chosen.assign(muscle=chosen["muscle"].astype(str))
    return chosen, source.muscles.set_index("muscle").loc[used].reset_index()


def read_parts(samples: pd.DataFrame) -> pd.Series:
    """Return the part of each trial."""
    if "part" not in samples:
        return pd.Series(WITHOUT_PART, index=samples["trial"].unique())
    parts = samples.groupby("trial")["part"]
    mixed = samples["trial"].map(parts.nunique()) > 1
    if mixed.any():
        raise RecordingError(f"column part: expected one in each trial, got more in that of {tell_rows(mixed)}")
    return parts.first()


def complete(
    samples: pd.DataFrame, muscles: pd.DataFrame, rate: float, cfg: Config, notes: list[tuple[str, str]]
) -> pd.DataFrame:
    """Return the samples with all columns of `MEASURED`, derived where that is possible."""
    made = {}
    if "contraction" not in samples:
        if "joint_angle_rad" not in samples:
            raise RecordingError("no column contraction and none joint_angle_rad, of which one is needed")
        made["contraction"] = derive_contraction(samples, muscles)
        notes.append(("contraction", "derived from joint_angle_rad by a constant moment arm"))
    samples = samples.assign(**made)
    if "contraction_velocity_per_s" not in samples:
        window = cfg.exoskeleton.velocity_filter
        velocity = derive_velocity(samples, "contraction", ["trial", "muscle"], rate, window.window_s, window.order)
        samples = samples.assign(contraction_velocity_per_s=velocity)
        notes.append(("contraction_velocity_per_s", "derived from contraction, filtered"))
    if "pressure_command_kpa" not in samples or samples["pressure_command_kpa"].isna().all():
        notes.append(("pressure_command_kpa", "missing: how pressure follows its command is not judged"))
    absent = [name for name in READINGS if name not in samples]
    return samples.assign(**dict.fromkeys(absent, np.nan))
