"""A rig whose trials are recordings: what is asked for is looked up among what a machine once measured.

A trial flows in; out flows the recording of the one that it is, by its pressure command or by its number, on the
exoskeleton's clock. Nothing moves. It is the one rig that reads files through `pipeline.foreign`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pandas as pd
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from pipeline.bags import is_bag
from pipeline.foreign import TABLE_SUFFIXES, read_foreign, read_header
from pipeline.inputs import InputPath
from stages.plant.declaration import Declared, nearest
from stages.recording import (
    RecordingError,
    adopt_rows,
    check_plausible,
    check_rows,
    complete,
    count_time,
    derive_velocity,
    describe_muscles,
    find_rate,
    is_wide,
    list_sources,
    regularise,
    tell_rows,
)
from stages.rig.configured import ConfiguredRig
from stages.rig.contract import MEASUREMENT_COLUMNS, Array, Recording, RigError, Trial, Watch
from stages.rig.rows import PUNCTUAL, assume_conduct, check_values, gather

Kind = Literal["free", "tracked", "passive"]
How = Literal["command", "order"]

READINGS = tuple(MEASUREMENT_COLUMNS)[2:]
NEEDED = ("pressure_command_kpa", "pressure_kpa", "force_n", "joint_angle_rad")
TEXTS = ("trial", "muscle", "kind", "participant", "status", "clipped_by")
KNOWN = ("trial", "kind", "participant", "muscle", "time_s", *READINGS, *PUNCTUAL, "reference_rad")
KEYS = ("participant", "experiment", "arm", "position", "trial", "trajectory")
"""Columns that tell trials apart in the tables of a run, where ``columns.trial`` names none."""
HELD = ("pressure_command_kpa", *PUNCTUAL)
"""Columns whose values hold until the next sample."""
SLACK_N = -50.0
"""Tension below which a load cell is not merely slack; what lies between it and 0 is taken for 0, as in simulation."""
SAME_RATE = 0.01
"""Relative difference of two rates that are the same."""
SAME_KPA = 1e-9
"""Difference of commands that are the same; of several recordings of one, that of the trial's number is taken."""
A_GAP = 1.5
"""Steps of time, over the usual one, from which on samples are missing in between."""


def _list(value: Any) -> Any:
    return [] if value is None else [value] if isinstance(value, str) else value


Paths = Annotated[list[InputPath], BeforeValidator(_list)]


class Recordings(Declared):
    """Where the recorded trials of each kind lie: a table, a bag, a folder of such, or a list of these."""

    free: Paths
    tracked: Paths
    passive: Paths

    @model_validator(mode="after")
    def _name_some(self) -> Self:
        if not (self.free or self.tracked or self.passive):
            raise ValueError("expected the path of recorded trials, got none; set rig.recordings.free=PATH")
        return self


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recorded trial.

    Parameters
    ----------
    name : str
        The file, and what tells the trial apart in it.
    participant : str or None
        Who was in the machine, where that is told.
    recording : Recording
        What was measured.
    shown_rad : (T, J) ndarray
        The reference, where it is told; else the angles that were reached.
    """

    name: str
    participant: str | None
    recording: Recording
    shown_rad: Array


class ReplayRig(ConfiguredRig):
    """A rig that returns what was recorded.

    Parameters
    ----------
    exoskeleton, participants
        As of every `ConfiguredRig`.
    recordings : Recordings
        Paths, by kind of trial.
    match : str, or dict of str to str
        How a trial is found, of all kinds or by kind: ``command``, the one of the nearest pressure command, or
        ``order``, the one of the trial's number.
    tolerance_kpa, tolerance_rad : float
        Largest difference of commands and references from those asked for, RMS.
    resample : bool
        Whether recordings at another rate, with gaps or longer than a trial are brought to the exoskeleton's samples.
    largest_gap_s : float
        Longest stretch without samples that resampling bridges, s.
    largest_jitter : float
        Deviation of a step of time from whole periods that is borne without resampling, in periods.
    rate_hz : float or None
        Samples per second of recordings without a column of time.
    columns, units : dict of str to str or None
        As of ``measured=``.

    Notes
    -----
    It is real, as its numbers come from a machine: what was read is kept when code changes, controls are not executed
    unless asked for, and trials follow each other. The bytes of the recordings count in freshness.
    """

    real: ClassVar[bool] = True

    recordings: Recordings
    match: How | dict[Kind, How]
    tolerance_kpa: float = Field(ge=0.0, le=1000.0)
    tolerance_rad: float = Field(ge=0.0, le=7.0)
    resample: bool
    largest_gap_s: float = Field(ge=0.0, le=10.0)
    largest_jitter: float = Field(ge=0.0, le=0.4)
    rate_hz: Annotated[float, Field(gt=0.0, le=1e6)] | None
    columns: dict[str, str | None]
    units: dict[str, str | None]
    _recorded: dict[str, list[Recorded]] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _know_columns(self) -> Self:
        for section in ("columns", "units"):
            for name in getattr(self, section):
                if name not in KNOWN:
                    raise ValueError(f"{section}: no column '{name}'; {nearest(name, KNOWN)}")
        return self

    def connect(self) -> None:
        """Read the recordings, once.

        Raises
        ------
        RigError
            When one does not hold what it should.
        """
        if not self._recorded:
            found = {kind: self._read_kind(kind) for kind in ("free", "tracked", "passive")}
            self._recorded.update(found)
        super().connect()

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Return the recording of this trial.

        Raises
        ------
        RigError
            When none is near enough, or there are fewer.
        """
        found = self._recorded[trial.kind]
        asked = f"{trial.kind} trial{f' ({trial.label})' if trial.label else ''}"
        if not found:
            raise RigError(f"{asked}: expected recordings of this kind, got none; set rig.recordings.{trial.kind}=PATH")
        how = self.match.get(trial.kind, "command") if isinstance(self.match, dict) else self.match
        return (self._find_number if how == "order" else self._find_command)(trial, asked, found).recording

    def _find_number(self, trial: Trial, asked: str, found: Sequence[Recorded]) -> Recorded:
        if trial.number is None:
            raise RigError(f"{asked}: nothing numbers it; set rig.match={{{trial.kind}: command}}")
        if trial.number >= len(found):
            raise RigError(
                f"{asked}: expected recording {trial.number + 1} in order, got {len(found)} of {trial.kind} trials; "
                "add recordings, or ask for fewer trials"
            )
        return found[trial.number]

    def _find_command(self, trial: Trial, asked: str, found: Sequence[Recorded]) -> Recorded:
        theirs = [each for each in found if each.participant in (None, trial.participant)]
        if not theirs:
            people = ", ".join(sorted({str(each.participant) for each in found}))
            raise RigError(f"{asked}: expected a recording of {trial.participant}, got some of {people}")
        away = [_differ(each.recording, trial.pressure_command_kpa) for each in theirs]
        nearest_kpa = min(away)
        if nearest_kpa > self.tolerance_kpa:
            raise RigError(
                f"{asked}: expected a recording whose pressure command is within {self.tolerance_kpa:g} kPa RMS, got "
                f"{theirs[away.index(nearest_kpa)].name} at {nearest_kpa:.4g} kPa as the nearest; add a recording of "
                f"it, raise rig.tolerance_kpa, or set rig.match={{{trial.kind}: order}}"
            )
        near = [each for each, its in zip(theirs, away, strict=True) if its <= max(nearest_kpa, SAME_KPA)]
        if trial.reference_rad is not None:
            near = self._keep_tracked(near, trial.reference_rad, asked)
        numbered = found[trial.number] if trial.number is not None and trial.number < len(found) else None
        return next((each for each in near if each is numbered), near[0])

    def _keep_tracked(self, near: Sequence[Recorded], reference_rad: Array, asked: str) -> list[Recorded]:
        """Return the recordings within the tolerance of a reference, the nearest first."""
        off = [float(np.sqrt(np.mean((each.shown_rad - reference_rad) ** 2))) for each in near]
        order = [int(k) for k in np.argsort(off, kind="stable")]
        if off[order[0]] > self.tolerance_rad:
            raise RigError(
                f"{asked}: expected a recording whose reference is within {self.tolerance_rad:g} rad RMS, got "
                f"{near[order[0]].name} at {off[order[0]]:.3g} rad as the nearest; add a recording of it, name the "
                "file's reference with rig.columns.reference_rad=NAME, or raise rig.tolerance_rad"
            )
        return [near[k] for k in order if off[k] <= self.tolerance_rad]

    def _read_kind(self, kind: str) -> list[Recorded]:
        paths: list[InputPath] = getattr(self.recordings, kind)
        return [each for path in paths for file in _list_files(path) for each in self._read_file(file, kind)]

    def _read_file(self, file: Path, kind: str) -> list[Recorded]:
        header = read_header(file)
        keys = ["trial"] if self.columns.get("trial") else [each for each in KEYS if each in header.names]
        columns = {**dict.fromkeys(keys), **self.columns}
        muscles = describe_muscles(self.exoskeleton)
        frame = read_foreign(file, set(list_sources([its or name for name, its in columns.items()], muscles)))
        frame = _select(frame, columns, kind)
        texts = [*TEXTS, *(each for each in keys if each not in TEXTS)]
        needed = [*(["time_s"] if self.rate_hz is None else []), "muscle", *NEEDED]
        with _about(str(file)):
            if frame.empty:
                return []
            samples = adopt_rows(frame, header.names, header.units, columns, self.units, texts, needed, muscles)
            samples["force_n"] = samples["force_n"].mask(samples["force_n"].between(SLACK_N, 0.0), 0.0)
            for name in READINGS:
                if name in samples:
                    low, high = (check.statistics for check in MEASUREMENT_COLUMNS[name].checks)
                    bounds = low["min_value"], high["max_value"]
                    check_plausible(samples[name], name, *bounds, self.units.get(name))
        keys = keys or [each for each in ("trial",) if is_wide(columns)]
        trials = samples.groupby(keys, sort=False) if keys else [((), samples)]
        found = []
        for values, rows in trials:
            name = ", ".join([file.name, *(f"{key} {value}" for key, value in zip(keys, values, strict=True))])
            with _about(f"{file.parent / name}"):
                found.append(self._read_trial(rows.assign(trial=" ".join(map(str, values))), name, muscles))
        return found

    def _read_trial(self, rows: pd.DataFrame, name: str, muscles: pd.DataFrame) -> Recorded:
        rows = rows[rows["muscle"].isin(self.muscles)]
        missing = [each for each in self.muscles if each not in set(rows["muscle"])]
        if missing:
            raise RecordingError(f"column muscle: expected rows of every muscle, got none of {', '.join(missing)}")
        if "time_s" not in rows:
            rows = count_time(rows, ["muscle"], float(self.rate_hz or 0.0))
        check_rows(rows, ("trial", "muscle", "time_s"))
        rows = assume_conduct(rows)
        rate = find_rate(rows, ("muscle",), None)
        placed = self._resample(rows) if self.resample else self._keep(rows, rate)
        window = self.exoskeleton.velocity_filter
        filtering = self.sampling_rate_hz, window.window_s, window.order
        if "joint_velocity_rad_per_s" not in placed:
            derived = derive_velocity(placed, "joint_angle_rad", ["muscle"], *filtering)
            placed = placed.assign(joint_velocity_rad_per_s=derived)
        placed = complete(placed, muscles, READINGS, *filtering, [])
        try:
            recording = gather(check_values(placed), self)
        except ValueError as error:
            raise RecordingError(str(error)) from None
        told = placed.get("participant")
        return Recorded(
            name, None if told is None else str(told.iloc[0]), recording, self._read_shown(placed, recording)
        )

    def _read_shown(self, placed: pd.DataFrame, recording: Recording) -> Array:
        if "reference_rad" not in placed:
            return recording.joint_angle_rad
        told = placed.pivot(index="time_s", columns="muscle", values="reference_rad")
        first_muscle = [self.muscles[list(self.muscle_joints).index(joint)] for joint in self.joints]
        return told[first_muscle].to_numpy()

    def _keep(self, rows: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
        """Return the rows on the exoskeleton's clock, which must be theirs."""
        if abs(rate_hz / self.sampling_rate_hz - 1.0) > SAME_RATE:
            raise RecordingError(
                f"column time_s: expected the exoskeleton's {self.sampling_rate_hz:g} Hz, got {rate_hz:.6g} Hz; set "
                f"rig.resample=true, or exoskeleton.sampling_rate_hz={rate_hz:.6g}"
            )
        steps = rows.groupby("muscle", sort=False)["time_s"].diff() * self.sampling_rate_hz
        if (steps > A_GAP).any():
            lost = int((steps[steps > A_GAP].round() - 1).max())
            raise RecordingError(
                f"column time_s: nothing for {lost} samples before {tell_rows(steps > A_GAP)}; record it anew, or set "
                "rig.resample=true, which marks what is missing"
            )
        for name in [each for each in READINGS if each in rows]:
            if rows[name].isna().any():
                raise RecordingError(
                    f"column {name}: expected a value in every row, got none in {tell_rows(rows[name].isna())}; set "
                    "rig.resample=true, which marks what is missing"
                )
        placed, _ = regularise(rows, "trial", ["muscle"], self.sampling_rate_hz, self.largest_jitter)
        counts = placed.groupby("muscle")["time_s"].size()
        if (counts != self.samples).any():
            count = int(counts[counts != self.samples].iloc[0])
            remedy = "rig.resample=true, which cuts it, or " if count > self.samples else ""
            raise RecordingError(
                f"expected the {self.samples} samples of a trial, got {count}; set {remedy}"
                f"exoskeleton.trial_s={count / self.sampling_rate_hz:g}"
            )
        return placed

    def _resample(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return the rows at the exoskeleton's samples: readings between two by interpolation, missing ones held."""
        start = rows["time_s"].min()
        return pd.concat(
            [self._resample_muscle(own, float(start)) for _, own in rows.groupby("muscle", sort=False)],
            ignore_index=True,
        )

    def _resample_muscle(self, rows: pd.DataFrame, start_s: float) -> pd.DataFrame:
        readings = [name for name in (*READINGS, "reference_rad") if name in rows]
        rows = rows[rows[readings].notna().all(axis=1)]
        times = rows["time_s"].to_numpy() - start_s
        if len(times) < 2:
            raise RecordingError(f"expected samples with all readings of {rows['muscle'].iloc[:1].tolist()}, got none")
        grid = np.arange(self.samples) / self.sampling_rate_hz
        usual = float(np.median(np.diff(times)))
        before = np.clip(np.searchsorted(times, grid + 1e-9, side="right") - 1, 0, None)
        after = np.clip(np.searchsorted(times, grid - 1e-9), None, len(times) - 1)
        missed = times[after] - times[before] > A_GAP * usual
        missed |= (grid > times[-1] + 0.5 * usual) | (grid < times[0] - 0.5 * usual)
        longest = _longest(missed) / self.sampling_rate_hz
        if longest > self.largest_gap_s:
            at = float(grid[int(np.argmax(missed))])
            raise RecordingError(
                f"column time_s: nothing for {longest:.3g} s, first from {at:.3g} s of the trial on, in which "
                f"rig.largest_gap_s={self.largest_gap_s:g} bridges less; record it anew, or shorten exoskeleton.trial_s"
            )
        held = rows.iloc[before].reset_index(drop=True)
        between = {name: np.interp(grid, times, rows[name].to_numpy()) for name in readings if name not in HELD}
        told = {name: np.where(missed, held[name], values) for name, values in between.items()}
        return held.assign(**told, time_s=grid, status=held["status"].mask(missed & (held["status"] == "ok"), "missed"))


def _select(frame: pd.DataFrame, columns: dict[str, str | None], kind: str) -> pd.DataFrame:
    """Return the rows of one kind of trial, where the file tells kinds apart; an empty cause of clipping is a text."""
    told = columns.get("kind") or "kind"
    if told in frame:
        frame = frame[frame[told] == kind]
    clipped = columns.get("clipped_by") or "clipped_by"
    return frame.assign(**{clipped: frame[clipped].astype(object).fillna("")}) if clipped in frame else frame


def _list_files(path: InputPath) -> list[Path]:
    """Return the file or bag at a path, or the tables in a folder, by name."""
    if is_bag(Path(path)) or not Path(path).is_dir():
        return [Path(path)]
    found = [each for each in path.files if each.suffix.lower() in TABLE_SUFFIXES]
    if not found:
        raise RigError(f"{path}: expected recordings ({', '.join(TABLE_SUFFIXES)}) in this folder, got none")
    return found


def _differ(recording: Recording, command_kpa: Array) -> float:
    """Return the RMS difference of commands, kPa, where nothing clipped what was asked."""
    as_asked = recording.clipped_by == ""
    as_asked = as_asked if as_asked.any() else np.ones_like(as_asked)
    return float(np.sqrt(np.mean((recording.pressure_command_kpa - command_kpa)[as_asked] ** 2)))


def _longest(flags: np.ndarray) -> int:
    """Return the length of the longest run of true."""
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~flags, [True]])))
    return int(runs.max()) - 1


@contextmanager
def _about(what: str) -> Iterator[None]:
    """Name the file and the trial in what is refused, and the rig's section in what is to be set."""
    try:
        yield
    except RecordingError as error:
        told = re.sub(r"(?<![\w.])(columns|units)\.", r"rig.\1.", str(error)).replace("measurement.", "rig.")
        raise RigError(f"{what}: {told}") from None
