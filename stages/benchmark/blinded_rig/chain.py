"""The true chain: command, valve, pressure, muscle, cable, load cell.

Flows in: a machine, a stimulus (commands, joint angles, the supply's ripple) and the effects with their sizes. Flows
out: what ideal sensors behind the true filters, gains and zeros would read, (4, trials, samples) at the sampling rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.benchmark.blinded_rig.kernels import fill_first_order
from stages.benchmark.blinded_rig.machine import Array, Machine, build_machine, column
from stages.benchmark.blinded_rig.sensors import Noise, low_pass
from stages.benchmark.blinded_rig.signals import Effect, LoadCellSite, Signals, Site

RATE_HZ = 250.0
OVERSAMPLED = 8
LEAD_SAMPLES = 150
STEP_S = 1.0 / (RATE_HZ * OVERSAMPLED)
LEAD_S = LEAD_SAMPLES / RATE_HZ
SHEET_FULL_FORCE_N = build_machine(np.random.default_rng(0), varied=False).full_force_n

Carried = Sequence[tuple[Effect, Array]]


@dataclass(frozen=True)
class Stimulus:
    """What is imposed: commands (4, trials, samples), kPa; angles (2, trials, fine samples with lead-in), rad.

    ``ripple_kpa`` (trials, fine samples) is common to all muscles.
    """

    command_kpa: Array
    joint_rad: Array
    start_s: Array
    rate_hz: float = RATE_HZ
    ripple_kpa: Array | None = None

    @property
    def oversampled(self) -> int:
        """Fine steps per sample."""
        return round(1.0 / (STEP_S * self.rate_hz))


@dataclass(frozen=True)
class Readings:
    """Pressure, kPa, and force, N, (4, trials, samples).

    Angles (2, trials, samples), rad and rad/s, stand here only where an effect lies on the encoder's channel.
    """

    pressure_kpa: Array
    force_n: Array
    joint_rad: Array | None = None
    joint_rad_per_s: Array | None = None


def fine_time(samples: int, oversampled: int = OVERSAMPLED) -> Array:
    """Fine time base, s from the trial's start, with the lead-in before zero."""
    return STEP_S * np.arange(-LEAD_SAMPLES * OVERSAMPLED, samples * oversampled, dtype=float)


def run_chain(machine: Machine, stimulus: Stimulus, carried: Carried, load_cell_site: LoadCellSite) -> Readings:
    """Return readings without noise; muscles whose size is zero pass untouched, to the bit."""
    lead = round(LEAD_S * stimulus.rate_hz)
    held = np.concatenate([np.repeat(stimulus.command_kpa[..., :1], lead, -1), stimulus.command_kpa], -1)
    time_s = fine_time(stimulus.command_kpa.shape[-1], stimulus.oversampled)
    command = np.repeat(held, stimulus.oversampled, axis=-1)
    signals = Signals(machine, STEP_S, time_s, stimulus.start_s, stimulus.joint_rad, command)
    pressurise(signals, carried, stimulus.ripple_kpa)
    pull(signals, carried, load_cell_site)
    sense(signals, carried)
    shown = slice(lead * stimulus.oversampled, None, stimulus.oversampled)
    return Readings(signals.sensed_kpa[..., shown], signals.sensed_n[..., shown])


def pressurise(signals: Signals, carried: Carried, ripple_kpa: Array | None = None) -> None:
    """Command to the pressure in the muscle."""
    machine = signals.machine
    command = apply(signals, carried, "command", signals.command_kpa)
    regulated = column(machine.regulator_gain, command) * command + column(machine.regulator_offset_kpa, command)
    signals.command_kpa = regulated
    plain = fill_first_order(regulated, machine.valve_tau_s, signals.step_s)
    signals.pressure_kpa = apply(signals, carried, "valve", plain)
    signals.pressure_kpa = apply(signals, carried, "pressure", signals.pressure_kpa)
    if ripple_kpa is not None:
        signals.pressure_kpa = signals.pressure_kpa + ripple_kpa


def pull(signals: Signals, carried: Carried, load_cell_site: LoadCellSite) -> None:
    """Pressure and joint angle to the tension that reaches the load cell."""
    signals.acting_kpa = apply(signals, carried, "acting_pressure", signals.pressure_kpa)
    signals.contraction = signals.machine.contraction(signals.travel_rad)
    signals.contraction = apply(signals, carried, "geometry", signals.contraction)
    signals.velocity_per_s = np.gradient(signals.contraction, signals.step_s, axis=-1)
    signals.tension_n = muscle_tension(signals)
    signals.tension_n = apply(signals, carried, "muscle", signals.tension_n)
    signals.tension_n = np.maximum(signals.tension_n, 0.0)
    if load_cell_site == "joint_end":
        signals.tension_n = np.maximum(apply(signals, carried, "cable", signals.tension_n), 0.0)


def muscle_tension(signals: Signals) -> Array:
    """Braid, sleeve and damping, N."""
    braid = signals.machine.static_force(signals.acting_kpa, signals.contraction)
    damping = column(signals.machine.damping_n_s, braid) * signals.velocity_per_s
    return braid + signals.machine.passive_force(signals.contraction) - damping


def sense(signals: Signals, carried: Carried) -> None:
    """Apply filters, gains and zeros of the sensors, and what ails their wires."""
    machine = signals.machine
    signals.sensed_n = apply(signals, carried, "force_wire", signals.tension_n)
    zero = machine.force_zero_share * machine.full_force_n
    filtered = low_pass(signals.sensed_n, machine.force_filter_hz, signals.step_s)
    signals.sensed_n = column(machine.force_gain, filtered) * filtered + column(zero, filtered)
    signals.sensed_kpa = apply(signals, carried, "pressure_wire", signals.pressure_kpa)
    filtered = low_pass(signals.sensed_kpa, machine.pressure_filter_hz, signals.step_s)
    signals.sensed_kpa = column(machine.pressure_gain, filtered) * filtered
    signals.sensed_kpa = signals.sensed_kpa + column(machine.pressure_zero_kpa, filtered)


def apply(signals: Signals, carried: Carried, site: Site, plain: Array) -> Array:
    """Return the site's signal with every effect that sits there, in the order given."""
    attribute = ATTRIBUTES[site]
    for effect, size in carried:
        if effect.site == site and size.any():
            setattr(signals, attribute, plain)
            changed = effect.act(signals, size[:, None, None])
            plain = np.where(size[:, None, None] > 0.0, changed, plain)
    return plain


ATTRIBUTES = {
    "command": "command_kpa",
    "valve": "pressure_kpa",
    "pressure": "pressure_kpa",
    "acting_pressure": "acting_kpa",
    "geometry": "contraction",
    "muscle": "tension_n",
    "cable": "tension_n",
    "force_wire": "sensed_n",
    "pressure_wire": "sensed_kpa",
    "count": "sensed_n",
    "pressure_count": "sensed_kpa",
}


def read(
    readings: Readings, noise: Noise, machine: Machine, carried: Carried, oversampled: int = OVERSAMPLED
) -> Readings:
    """Noise on the readings; then what the converters do to the numbers."""
    added = column(SHEET_FULL_FORCE_N, noise.force_added_share) * noise.force_added_share
    force = np.maximum(readings.force_n * noise.force_gain + added, 0.0)
    pressure = readings.pressure_kpa * noise.pressure_gain + noise.pressure_added_kpa
    nothing = np.empty(0)
    counted = Signals(machine, STEP_S * oversampled, nothing, nothing, nothing, nothing)
    return Readings(apply(counted, carried, "pressure_count", pressure), apply(counted, carried, "count", force))
