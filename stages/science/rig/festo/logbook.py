"""What a trial measured, sample by sample, while it runs, and what a device counted where there is no trial.

Samples flow in as they are taken; rows flow out to whoever watches, and in the end the whole trial.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.rig import clock
from stages.science.rig.contract import Rig, Watch, tidy
from stages.science.rig.festo.supervision import Sample
from stages.science.rig.limits import ROUNDING_KPA
from stages.science.rig.pacing import Tick
from stages.science.rig.sensors import contract, derive_from_encoder
from stages.science.rig.trial import Recording
from stages.science.signals.trajectories import Array

HANDED_OVER = 10
"""Samples that are handed to who watches at a time."""


class Logbook:
    """The samples of one trial on a rig's machine, under commands (L + T, M), kPa gauge, clipped by what is told.

    The samples L of the lead-in have times below 0.
    """

    def __init__(self, rig: Rig, lead: int, command_kpa: Array, clipped_by: NDArray[Any], watch: Watch | None):
        self.rig, self.lead, self.watch = rig, lead, watch
        self.command_kpa, self.clipped_by = command_kpa, clipped_by
        self.count = 0
        self.last_command: Array = np.zeros(command_kpa.shape[1])
        self._rows: list[dict[str, Any]] = []
        self._handed_over = 0
        self._begun_s = clock.now_s()
        self.noticed_at_s = 0.0
        self.missed = 0

    @property
    def time_s(self) -> float:
        """Time of the last sample, s; below 0 in the lead-in."""
        return (self.count - 1 - self.lead) / self.rig.sampling_rate_hz

    def next_command(self, index: int, step_kpa: Array) -> tuple[Array, NDArray[Any]]:
        """Return the command of a sample, no further from the last one than a step, and what made it differ."""
        wanted, last = self.command_kpa[index], self.last_command
        command = np.clip(wanted, last - step_kpa, last + step_kpa)
        return command, np.where(np.abs(command - wanted) > ROUNDING_KPA, "rate", self.clipped_by[index])

    def note(self, tick: Tick, late_s: float, sample: Sample, command: tuple[Array, NDArray[Any]] | None) -> None:
        """Note a sample, and before it those that were missed, with the values and the command that held meanwhile.

        The command is as of `next_command`; None where the one before holds on.
        """
        self._begun_s = tick.due_s - tick.index / self.rig.sampling_rate_hz
        while self.count < tick.index:
            held = self._rows[-1] if self._rows else self._describe(sample, self.last_command, "")
            self._append({**held, "status": np.full(len(self.last_command), "missed"), "late_s": 0.0})
            self.missed += 1
        applied, clipped = command or (self.last_command, np.array("ramp"))
        self.last_command = applied
        status = sample.status
        if late_s * self.rig.sampling_rate_hz > 1.0:
            status = np.where(status == "ok", "late", status)
        self._append({**self._describe(sample, applied, clipped), "status": status, "late_s": late_s})

    def note_ramp(self, sample: Sample, command_kpa: Array) -> None:
        """Note a sample on the way down, as late as it is on the trial's clock."""
        status = np.where(sample.status == "ok", "ramp", sample.status)
        late_s = clock.now_s() - self._begun_s - self.count / self.rig.sampling_rate_hz
        row = self._describe(sample, command_kpa, np.array("ramp"))
        self._append({**row, "status": status, "late_s": max(late_s, 0.0)})

    def collect(self) -> Recording:
        """Return the trial with its lead-in and without the way down, velocities as of every rig."""
        measured = self._record(0, len(self.command_kpa))
        derived = derive_from_encoder(measured.joint_angle_rad, self.rig.exoskeleton, self.lead)
        return replace(measured, force_n=np.maximum(measured.force_n, 0.0), **derived)

    def hand_over(self) -> None:
        """Hand what was not yet handed over to who watches, sample after sample."""
        if self.watch is None or self._handed_over == self.count:
            return
        columns = tidy(self._record(self._handed_over, self.count), self.rig)
        order = np.arange(len(columns["time_s"])).reshape(len(self.rig.muscles), -1).T.ravel()
        self.watch({name: values[order] for name, values in columns.items()})
        self._handed_over = self.count

    def _record(self, first: int, end: int) -> Recording:
        rows = self._rows[first:end]
        its = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        its |= contract(its["joint_angle_rad"], its["joint_velocity_rad_per_s"], self.rig.exoskeleton)
        return Recording(time_s=(np.arange(first, first + len(rows)) - self.lead) / self.rig.sampling_rate_hz, **its)

    def _describe(self, sample: Sample, command_kpa: Array, clipped_by: Any) -> dict[str, Any]:
        told = {name: values for name, values in vars(sample).items() if name != "breach"}
        clipped = np.broadcast_to(clipped_by, command_kpa.shape)
        return {**told, "pressure_command_kpa": command_kpa, "clipped_by": clipped}

    def _append(self, row: dict[str, Any]) -> None:
        self._rows.append(row)
        self.count += 1
        if self.count - self._handed_over >= HANDED_OVER:
            self.hand_over()


@dataclass(frozen=True, eq=False)
class CountRecording:
    """Raw counts over time, as the device tells them: a column for each input, indexed by ``time_s``."""

    counts: pd.DataFrame
    command_count: int | None = None
    """What was written to the regulator of the muscle that was held."""
    stopped: str = ""
    """Why the muscle was let down before the time was over; empty where it was held throughout."""
