"""A rig whose trials a person executes: each trial is asked for, and told by a file that holds what was recorded.

A trial flows in; if its file lies in the folder, the recording flows out, else the `TrialRequested` that says what to
execute and where to put it. So a loop that drives a rig serves an operator unchanged: it stops, and goes on when
started again.
"""

import hashlib
import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from pydantic import field_validator

from stages.science.rig.contract import MEASUREMENT_COLUMNS, Rig, RigError, Watch
from stages.science.rig.reference import assume_conduct, check_values, gather
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.trajectories import Array

SUFFIXES = (".csv", ".parquet")
MOST_OFF_KPA = 1.0
"""Root mean square of recorded commands less those asked for, up to which they are the same, as of a replay."""
LEAST_ASKED_KPA, LOW_KPA = 40.0, 15.0
"""Pressure from which a command is one, and below which no pressure follows it but one in another unit."""


class TrialRequested(Exception):
    """A trial waits for a person, who is asked to execute a reference and commands and to put columns somewhere."""

    def __init__(self, asks: dict[str, Any]):
        super().__init__(f"execute {asks['trial']} and save what was recorded as {asks['save_as']}")
        self.asks = asks


class ManualRig(Rig):
    """A rig behind a person, who puts recordings into a folder."""

    real: ClassVar[bool] = True

    folder: str

    @field_validator("folder")
    @classmethod
    def _name_folder(cls, folder: str) -> str:
        if not folder.strip():
            raise ValueError(
                f"expected the path of the folder that receives recordings, got {folder!r}; set rig.folder=PATH"
            )
        if Path(folder).exists() and not Path(folder).is_dir():
            raise ValueError(f"expected a folder that receives recordings, got the file {folder}; set rig.folder=PATH")
        return folder

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Read what the operator recorded, or ask for it by `TrialRequested` where the trial's file is not there yet.

        A `RigError` tells that the file does not hold what was asked for.
        """
        content = hashlib.sha256(trial.kind.encode() + trial.participant.encode())
        content.update(trial.pressure_command_kpa.tobytes())
        content.update(b"" if trial.reference_rad is None else trial.reference_rad.tobytes())
        name = f"{re.sub(r'[^0-9a-zA-Z]+', '_', trial.label or trial.kind)}_{content.hexdigest()[:8]}"
        stem = Path(self.folder) / name
        found = [stem.with_suffix(suffix) for suffix in SUFFIXES if stem.with_suffix(suffix).exists()]
        if not found:
            raise TrialRequested(self._ask(trial, stem.with_suffix(".csv")))
        recording = self._read(found[0])
        problem = _compare(recording, trial.pressure_command_kpa)
        if problem:
            raise RigError(f"{found[0]}: {problem}")
        return recording

    def _ask(self, trial: Trial, path: Path) -> dict[str, Any]:
        shown = [] if trial.reference_rad is None else zip(self.joints, trial.reference_rad.T.tolist(), strict=True)
        return {
            "trial": trial.label,
            "kind": trial.kind,
            "participant": trial.participant,
            "reason": "" if trial.proposal is None else trial.proposal.reason,
            "save_as": str(path),
            "columns": {name: each["description"] for name, each in MEASUREMENT_COLUMNS.items()},
            "rows": (
                f"one for each of {len(self.muscles)} muscles and {self.samples} samples; before them, at times below "
                "0, those of the filling, where they were recorded"
            ),
            "time_s": (np.arange(self.samples) / self.sampling_rate_hz).tolist(),
            "reference_rad": dict(shown),
            "pressure_command_kpa": dict(zip(self.muscles, trial.pressure_command_kpa.T.tolist(), strict=True)),
        }

    def _read(self, path: Path) -> Recording:
        try:
            frame = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
        except (OSError, ValueError) as error:
            told = str(error).splitlines()[:1] or [type(error).__name__]
            raise RigError(f"{path}: expected a table ({told[0]})") from None
        missing = [name for name in MEASUREMENT_COLUMNS if name not in frame]
        if missing:
            raise RigError(
                f"{path}: expected the columns {', '.join(MEASUREMENT_COLUMNS)}; it lacks {', '.join(missing)}"
            )
        try:
            frame = check_values(assume_conduct(frame))
        except ValueError as error:
            raise RigError(f"{path}: {error}") from None
        counts = leave_out_lead_in(frame)["muscle"].value_counts()
        wrong = [name for name in self.muscles if counts.get(name, 0) != self.samples]
        if wrong:
            got = ", ".join(f"{counts.get(name, 0)} of {name}" for name in wrong)
            raise RigError(f"{path}: expected {self.samples} samples of every muscle, got {got}")
        times = frame.groupby("time_s")["muscle"].nunique()
        since, filling = times[times.index >= 0.0], times[times.index < 0.0]
        due = round(-filling.index.min() * self.sampling_rate_hz) if len(filling) else 0
        if len(filling) != due or filling.min() < len(self.muscles):
            raise RigError(
                f"{path}: expected every sample of every muscle before time 0, from {filling.index.min():g} s on, "
                f"where the filling was recorded ({due}), got {int((filling == len(self.muscles)).sum())}; "
                "leave them all out, or add what is missing"
            )
        if len(since) != self.samples or times.min() < len(self.muscles):
            raise RigError(f"{path}: expected the same {self.samples} times for every muscle, got {len(since)} times")
        step_s = 1.0 / self.sampling_rate_hz
        if np.abs(since.index.to_numpy() - step_s * np.arange(self.samples)).max() > step_s:
            raise RigError(
                f"{path}: expected samples from 0 to {step_s * (self.samples - 1):g} s, {self.sampling_rate_hz:g} in a "
                f"second, got them from {since.index[0]:g} to {since.index[-1]:g} s"
            )
        return gather(frame, self)


def _compare(recording: Recording, asked_kpa: Array) -> str:
    """Return how pressures of a recording contradict the commands that were asked for, (T, M); empty if they do not."""
    counted = recording.time_s >= 0.0
    applied, measured = recording.pressure_command_kpa[counted], recording.pressure_kpa[counted]
    off = (applied - asked_kpa)[recording.clipped_by[counted] == ""]
    rms = float(np.sqrt(np.mean(off**2))) if off.size else 0.0
    if rms > MOST_OFF_KPA:
        return (
            f"expected in pressure_command_kpa what was asked for, within {MOST_OFF_KPA:g} kPa RMS where clipped_by is "
            f"empty, got {rms:.3g} kPa off; record the trial that was asked for, or say what clipped it"
        )
    most, top = float(asked_kpa.max()), float(measured.max())
    if most > LEAST_ASKED_KPA and top < LOW_KPA:
        return (
            f"expected pressures in kPa gauge that follow those asked for, of up to {most:.0f} kPa, got none above "
            f"{top:.3g}; if they are in bar, write them in kPa"
        )
    return ""
