"""The output channels of measured muscles: tidy rows become arrays of samples by trials.

`MeasuredTables` flow in; for each muscle the channels of its pressure and its force flow out, gaps bridged and marked.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd

from stages.science.discrepancy.settings import DiscrepancySettings, MuscleChannelSettings, Tolerance
from stages.science.output_channels.muscle_channels import (
    PRESSURES,
    Build,
    ForceChannel,
    MuscleChannel,
    PressureChannel,
    Records,
)
from stages.science.output_channels.records import bridge
from stages.science.plant.effect import Parameter
from stages.science.plant.muscle import braid_coefficients
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.signals.filtering import decimate, follow, smooth
from stages.science.signals.trajectories import Array

SIGNALS = {
    "command_kpa": "pressure_command_kpa",
    "pressure_kpa": "pressure_kpa",
    "contraction": "contraction",
    "velocity_per_s": "contraction_velocity_per_s",
    "force_n": "force_n",
}
SAMPLES = 5
"""Samples in the width over which pressure is smoothed, of the most that are kept."""
Spread = Mapping[str, tuple[Any, Array]]
"""By column, where it was measured, and its values, (T, K) each."""


def _collect_records(
    tables: MeasuredTables,
    spread: Mapping[str, Spread],
    muscle: str,
    joints: Mapping[str, str],
    limits: MuscleChannelSettings,
) -> Records:
    """Return one muscle's trials, in their order, as arrays; another joint's angle is that of its first muscle."""
    measured, trials = tables.measured, tables.measured_trials
    order, samples = list(trials["trial"]), len(spread[muscle]["contraction"][1])
    smoothing_s = limits.smoothing_s
    first = measured.loc[(measured["muscle"] == muscle) & (measured["trial"] == order[0]), "time_s"]
    step_s = float(np.median(np.diff(first)))
    known, signals = {}, {}
    for name, column in SIGNALS.items():
        known[name], signals[name] = spread[muscle][column]
    start = trials["start_s"].to_numpy(dtype=float)
    start = np.where(np.isfinite(start), start, np.arange(len(order)) * samples * step_s)
    told = follow(signals["pressure_kpa"], signals["command_kpa"], step_s)
    for name, width_s in zip(PRESSURES, (smoothing_s, limits.slow_smoothing_s), strict=True):
        signals[name] = told + smooth(signals["pressure_kpa"] - told, step_s, width_s)
    signals["velocity_per_s"] = smooth(signals["velocity_per_s"], step_s, smoothing_s)
    others, seen = {}, {joints.get(muscle)}
    for name in [each for each in joints if each != muscle]:
        for signal in ("pressure_kpa", "pressure_command_kpa"):
            others[f"{name} {signal}"] = spread[name][signal][1]
        if joints[name] not in seen:
            seen.add(joints[name])
            others[f"{joints[name]} contraction"] = spread[name]["contraction"][1]
    readings = {name: np.where(known[name], signals[name], np.nan) for name in ("pressure_kpa", "force_n")}
    written = signals["command_kpa"]
    times = max(int(smoothing_s / SAMPLES / step_s * (1.0 + 1e-9)), 1)
    signals = {name: decimate(each, times, held=name == "command_kpa") for name, each in signals.items()}
    others = {name: decimate(each, times, held="command" in name) for name, each in others.items()}
    known = {name: decimate(each.astype(float), times) > 0.5 for name, each in known.items()}
    start -= start[0]
    return Records(
        times * step_s,
        start,
        **signals,
        known=known,
        others=others,
        averaged=times,
        readings=readings,
        written_kpa=written,
    )


def _spread(rows: pd.DataFrame, order: Sequence[int], column: str, samples: int) -> tuple[Any, Array]:
    """Return where a column was measured, and its values with gaps bridged by straight lines and ends held."""
    known = np.zeros((samples, len(order)), dtype=bool)
    values = np.zeros((samples, len(order)))
    groups = dict(tuple(rows.groupby("trial")[column])) if column in rows else {}
    for place, trial in enumerate(order):
        if trial in groups:
            got = groups[trial].reset_index(drop=True).reindex(range(samples))
            known[:, place], values[:, place] = np.isfinite(got), bridge(got)
    return known, values


def build_muscle_channels(tables: MeasuredTables, settings: DiscrepancySettings) -> list[MuscleChannel]:
    """Return the output channels of a dataset: for every muscle its pressure and its force, where there are data.

    Raises
    ------
    ValueError
        When the settings have no largest pressure for a muscle's type.
    """
    tolerances, limits = settings.tolerances, settings.muscle_channels
    site = str(tables.measured_session["load_cell_site"].iloc[0])
    load_cell_site: Literal["muscle_tip", "joint_end"] = "muscle_tip" if site == "muscle_tip" else "joint_end"
    muscles = tables.measured_muscles
    joints = dict(zip(muscles["muscle"], muscles["joint"], strict=True))
    order = list(tables.measured_trials["trial"])
    samples = int(tables.measured.groupby(["trial", "muscle"]).size().max())
    spread = {
        str(name): {column: _spread(rows, order, column, samples) for column in SIGNALS.values()}
        for name, rows in tables.measured.groupby("muscle")
    }
    outputs: list[MuscleChannel] = []
    for row in muscles.to_dict("records"):
        records = _collect_records(tables, spread, row["muscle"], joints, limits)
        area, arm = 1000.0 * np.pi * (0.5 * row["nominal_diameter_m"]) ** 2, row["sign"] * row["moment_arm_m"]
        if row["type"] not in settings.max_pressure_kpa:
            raise ValueError(
                f"discrepancy.max_pressure_kpa: expected the largest pressure of {row['type']}, the type of muscle "
                f"{row['muscle']}, got none; type +discrepancy.max_pressure_kpa.{row['type']}=600"
            )
        most, zero = settings.max_pressure_kpa[row["type"]], row["contraction_at_angle_0"]
        build = Build(row["muscle"], area, most, zero, arm / row["rest_length_m"], arm)
        for kind in (PressureChannel, ForceChannel):
            declared = tolerances[kind.channel]
            largest = float(np.abs(records.force_n[records.known["force_n"]]).max(initial=1.0))
            a, b = braid_coefficients(float(row.get("braid_angle_deg", np.nan)))
            scales = {"one": 1.0, "largest": largest, "full": area * most * (a - b)}
            constants = tuple(_constant(name, each, row, scales) for name, each in declared.items())
            output = kind(build, records, constants, load_cell_site, settings.detection)
            enough = output.present.sum() >= limits.least_samples and output.range > 0.0
            if enough and output.is_driven(limits.least_drive_kpa):
                outputs.append(output)
    return outputs


def _constant(name: str, tolerance: Tolerance, row: Mapping[Any, Any], scales: Mapping[str, float]) -> Parameter:
    start = float(row[name]) if tolerance.start is None else tolerance.start
    scale = abs(start) if tolerance.times == "start" else scales[tolerance.times]
    low, high = start + scale * tolerance.low, start + scale * tolerance.high
    sd, description = scale * tolerance.sd, tolerance.description
    return Parameter(name, tolerance.unit, low, high, start, sd, description, starts=(start,))
