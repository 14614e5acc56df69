"""Samples of muscles from wherever they were read, made into the tables of a dataset.

A `Source` flows in: of a file, of a rig's session, or of the trials that a study executed. `MeasuredTables` flow out,
rectangular, on one clock, with notes on what was left out or derived.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import pandas as pd
from pydantic import Field

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.recording.assembly import READINGS, Notes, choose_muscles, complete, note_missing, read_parts
from stages.science.recording.blocks import PROPOSED, WHOLE
from stages.science.recording.clock import find_rate, regularise
from stages.science.recording.datasets import SESSION_COLUMNS, find_starts, list_trials
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import MUSCLE_COLUMNS, Session, describe_muscles
from stages.science.signals.executed_trials import join_executed

SAMPLE_KEY = ("trial", "muscle", "time_s")
HELD = "command held until the next sample; sensors sample before the command acts"
"""Timing of every rig."""


class Measurement(Declared):
    """How recordings are read."""

    kind: Literal["muscles", "records"]
    rate_hz: Annotated[float, Field(gt=0.0, le=1e9)] | None
    largest_jitter: Annotated[float, Field(ge=0.0, le=0.4)]
    part_endings: Annotated[list[str], Field(min_length=1)] | None
    blocks: Annotated[int, Field(ge=2, le=10000)]


@dataclass(frozen=True)
class Source:
    """Samples of muscles as they were read, and what is known of the machine.

    `samples` have this project's columns, and an index that counts the file's rows; `muscles` a row for each that may
    be there. Messages name the `file`, and what the muscles are `described_in`. The times must say where no rate is
    told; `session` is what meta.json says, and `notes` what was left out already.
    """

    name: str
    file: str
    samples: pd.DataFrame
    muscles: pd.DataFrame
    described_in: str
    load_cell_site: str
    timing: str
    rate_hz: float | None
    session: Session | None
    notes: Sequence[tuple[str, str]] = ()


def read_executed(
    machine: Exoskeleton, initial: pd.DataFrame, designed: pd.DataFrame | None, further: pd.DataFrame | None
) -> Source:
    """Return the trials that a study executed: initial ones, those of the design's arm, and further ones.

    Rows are of `hardware_recordings`, `active_recordings` and `discrimination_recordings`. Samples that are not ok are
    left out, and the force of lead-ins.
    """
    recordings = join_executed(initial, designed).assign(part=WHOLE)
    if further is not None and len(further):
        later = further.assign(trial=recordings["trial"].max() + further["trial"], part=PROPOSED)
        recordings = pd.concat([recordings, later[recordings.columns.intersection(later.columns)]], ignore_index=True)
    samples = recordings[[*SAMPLE_KEY, *READINGS, "part"]].copy()
    amiss = recordings["status"] != "ok"
    samples.loc[amiss, [name for name in READINGS if name != "pressure_command_kpa"]] = float("nan")
    counts = recordings[amiss].groupby(["muscle", "status"], sort=False).size().reset_index(name="count")
    notes = [(str(row["muscle"]), f"{row['count']} samples left out: {row['status']}") for _, row in counts.iterrows()]
    filling = recordings["time_s"] < 0.0
    if filling.any():
        samples.loc[filling, "force_n"] = float("nan")
        notes.append(("force_n", "left out where muscles were filled, which tells the state that trials begin in"))
    file, described_in = "hardware_recordings", "exoskeleton.muscles"
    told = machine.load_cell_site, HELD, machine.sampling_rate_hz, None, notes
    name = "hardware" if designed is None else "hardware and active_loop"
    return Source(name, file, samples, describe_muscles(machine), described_in, *told)


def read_rig_session(recordings: pd.DataFrame, machine: pd.DataFrame, further: pd.DataFrame | None) -> Source:
    """Return a session that a rig recorded, and its further trials; its clock runs through them."""
    recordings = recordings.assign(part=WHOLE)
    if further is not None and len(further):
        recordings = pd.concat([recordings, further.assign(part=PROPOSED)], ignore_index=True)
    samples = recordings.assign(time_s=recordings["start_s"] + recordings["time_s"])
    known, told = machine[list(MUSCLE_COLUMNS)], machine.iloc[0]
    site, timing, rate = str(told["load_cell_site"]), str(told["timing"]), float(told["sampling_rate_hz"])
    kept = samples[[*SAMPLE_KEY, *READINGS, "part"]]
    return Source("blinded_session", "session_recordings", kept, known, "session_machine", site, timing, rate, None)


def tabulate(source: Source, machine: Exoskeleton, largest_jitter: float) -> tuple[MeasuredTables, Notes]:
    """Return the tables of a recording of muscles, and notes.

    Velocities that were not measured are differentiated by the filter of the machine; `largest_jitter` is the deviation
    of a time step that is borne, in periods. A `RecordingError` tells that no muscle has data, one is not described, or
    the clock is not uniform.
    """
    notes: Notes = list(source.notes)
    samples, muscles = choose_muscles(source.samples, source.muscles, source.described_in, notes)
    notes += note_missing(samples, READINGS)
    rate = find_rate(samples, ("trial", "muscle"), source.rate_hz)
    parts = read_parts(samples, WHOLE)
    recorded = samples.groupby("trial", sort=False).size()
    samples, starts = regularise(samples, "trial", ["muscle"], rate, largest_jitter)
    lost = samples.groupby("trial", sort=False).size() - recorded
    told = "of its rows were missing: samples without values"
    notes.extend((f"trial {trial}", f"{count} {told}") for trial, count in lost.items() if count)
    samples = complete(samples, muscles, rate, machine.velocity_filter, notes)
    trials = list_trials(samples, rate).assign(part=parts.to_numpy(), start_s=find_starts(source.session, starts))
    row = (source.name, "muscles", rate, source.load_cell_site, source.timing, len(trials), len(muscles))
    session = pd.DataFrame([row], columns=SESSION_COLUMNS)
    no_signals = pd.DataFrame(columns=["signal"])
    return MeasuredTables(samples[[*SAMPLE_KEY, *READINGS]], no_signals, trials, muscles, session), notes
