"""A rig whose trials are recordings: what is asked for is looked up among what a machine once measured.

A trial flows in; out flows the recording of the one that it is, by its pressure command or by its number, on the
exoskeleton's clock. Nothing moves. It is the one rig that reads files through `stages.science.recording.files`.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pandas as pd
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from pipeline.inputs import InputPath
from stages.science.plant.declaration import Declared, nearest
from stages.science.recording.assembly import READINGS, complete, derive_velocity
from stages.science.recording.clock import count_time
from stages.science.recording.column_map import ColumnMap, is_wide
from stages.science.recording.columns import RecordingError, check_rows
from stages.science.recording.files.bags import is_bag
from stages.science.recording.files.readers import TABLE_SUFFIXES, FileError, read_header, read_samples
from stages.science.recording.muscles import describe_muscles
from stages.science.recording.plausibility import check_readings
from stages.science.rig.contract import MEASUREMENT_COLUMNS, Rig, RigError, Watch
from stages.science.rig.placement import keep, resample
from stages.science.rig.reference import PUNCTUAL, arrange, assume_conduct, check_values, gather
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.trajectories import Array

Kind = Literal["free", "tracked", "passive"]
How = Literal["command", "order"]

NEEDED = ("pressure_command_kpa", "pressure_kpa", "force_n", "joint_angle_rad")
TEXTS = ("trial", "muscle", "kind", "participant", "status", "clipped_by")
KNOWN = ("trial", "kind", "participant", "muscle", "time_s", *READINGS, *PUNCTUAL, "reference_rad")
KEYS = ("participant", "experiment", "arm", "position", "trial", "trajectory")
"""Columns that tell trials apart in the tables of a run, where ``columns.trial`` names none."""
SLACK_N = -50.0
"""Tension below which a load cell is not merely slack; what lies between it and 0 is taken for 0, as in simulation."""
SAME_KPA = 1e-9
"""Difference of commands that are the same; of several recordings of one, that of the trial's number is taken."""


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
    """A recorded trial."""

    name: str
    """The file, and what tells the trial apart in it."""
    participant: str | None
    recording: Recording
    shown_rad: Array
    """The reference, where it is told; else the angles that were reached."""


class ReplayRig(Rig):
    """A rig that returns what was recorded.

    It is real, as its numbers come from a machine: what was read is kept when code changes, controls are not executed
    unless asked for, and trials follow each other. The bytes of the recordings count in freshness.
    """

    real: ClassVar[bool] = True
    recorded: ClassVar[bool] = True

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

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Return the recording of this trial; all of its kind are read when the first one is asked for.

        A `RigError` tells that none is near enough, there are fewer, or a file does not hold what it should.
        """
        if trial.kind not in self._recorded:
            files = [file for path in getattr(self.recordings, trial.kind) for file in _list_files(path)]
            self._recorded[trial.kind] = [each for file in files for each in self._read_file(file, trial.kind)]
        found = self._recorded[trial.kind]
        asked = f"{trial.kind} trial{f' ({trial.label})' if trial.label else ''}"
        if not found:
            raise RigError(f"{asked}: expected recordings of this kind, got none; set rig.recordings.{trial.kind}=PATH")
        how = self.match.get(trial.kind, "command") if isinstance(self.match, dict) else self.match
        return (self._find_number if how == "order" else self._find_command)(trial, asked, found).recording

    def _find_number(self, trial: Trial, asked: str, found: Sequence[Recorded]) -> Recorded:
        if trial.number is None:
            raise RigError(f"{asked}: nothing numbers it; set 'rig.match={{{trial.kind}: command}}'")
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
                f"it, raise rig.tolerance_kpa, or set 'rig.match={{{trial.kind}: order}}'"
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

    def _read_file(self, file: Path, kind: str) -> list[Recorded]:
        with _about(str(file)):
            header = read_header(file)
        keys = [each for each in KEYS if each in header.names]
        if self.columns.get("trial"):
            keys = [each for each in ("participant", "trial") if self.columns.get(each)]
        columns = {**dict.fromkeys(keys), **self.columns}
        muscles = describe_muscles(self.exoskeleton)
        texts = [*TEXTS, *(each for each in keys if each not in TEXTS)]
        needed = [*(["time_s"] if self.rate_hz is None else []), "muscle", *NEEDED]
        given = ColumnMap(columns, self.units, texts, needed, [], self.rate_hz, muscles)
        with _about(str(file)):
            frame = _select(read_samples(file, set(given.wanted)), columns, kind)
            if frame.empty:
                return []
            samples = given.adopt(frame, header.names, header.units)
            samples["force_n"] = samples["force_n"].mask(samples["force_n"].between(SLACK_N, 0.0), 0.0)
            check_readings(samples, READINGS, MEASUREMENT_COLUMNS, self.units)
        keys = keys or [each for each in ("trial",) if is_wide(columns)]
        found = []
        for values, rows in samples.groupby(keys, sort=False) if keys else [((), samples)]:
            name = ", ".join([file.name, *(f"{key} {value}" for key, value in zip(keys, values, strict=True))])
            with _about(f"{file.parent / name}"):
                placed = self._place(rows.assign(trial=" ".join(map(str, values))), muscles)
                recording = gather(check_values(placed), self)
            who = str(placed["participant"].iloc[0]) if "participant" in placed else None
            shown = recording.without_lead_in().joint_angle_rad
            if "reference_rad" in placed:
                first_muscle = [list(self.muscle_joints).index(joint) for joint in self.joints]
                shown = arrange(leave_out_lead_in(placed), "reference_rad", self)[:, first_muscle]
            found.append(Recorded(name, who, recording, shown))
        return found

    def _place(self, rows: pd.DataFrame, muscles: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of a trial on the exoskeleton's clock, with all that follows from them."""
        missing = [each for each in self.muscles if each not in set(rows["muscle"].unique())]
        if missing:
            raise RecordingError(f"column muscle: expected rows of every muscle, got none of {', '.join(missing)}")
        rows = assume_conduct(rows[rows["muscle"].isin(self.muscles)])
        if "time_s" not in rows:
            rows = count_time(rows, ["muscle"], float(self.rate_hz or 0.0))
        check_rows(rows, ("trial", "muscle", "time_s"))
        size = self.sampling_rate_hz, self.samples
        placed = resample(rows, *size, self.largest_gap_s) if self.resample else keep(rows, *size, self.largest_jitter)
        filtering = self.sampling_rate_hz, self.exoskeleton.velocity_filter
        if "joint_velocity_rad_per_s" not in placed:
            derived = derive_velocity(placed, "joint_angle_rad", ["muscle"], *filtering)
            placed = placed.assign(joint_velocity_rad_per_s=derived)
        return complete(placed, muscles, *filtering, [])


def _select(frame: pd.DataFrame, columns: dict[str, str | None], kind: str) -> pd.DataFrame:
    """Return the rows of one kind of trial, where the file tells kinds apart, but for those of no trial."""
    trial, kinds, clipped = (columns.get(name) or name for name in ("trial", "kind", "clipped_by"))
    if trial in frame:
        frame = frame[frame[trial].notna()]
    if kinds in frame:
        frame = frame[frame[kinds] == kind]
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
    recording = recording.without_lead_in()
    as_asked = recording.clipped_by == ""
    as_asked = as_asked if as_asked.any() else np.ones_like(as_asked)
    return float(np.sqrt(np.mean((recording.pressure_command_kpa - command_kpa)[as_asked] ** 2)))


@contextmanager
def _about(what: str) -> Iterator[None]:
    """Name the file and the trial in what is refused, and the rig's section in what is to be set."""
    try:
        yield
    except FileError as error:
        raise RigError(str(error)) from None
    except ValueError as error:
        told = re.sub(r"(?<![\w.])(columns|units)\.", r"rig.\1.", str(error)).replace("measurement.", "rig.")
        raise RigError(f"{what}: {told}") from None
