"""Hidden effects between the command and the pressure in the muscle.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: the command or the pressure, kPa, (4, trials, fine samples).
"""

import numpy as np

from stages.benchmark.blinded_rig.kernels import (
    fill_first_order,
    fill_leaking,
    fill_limited,
    fill_through_tube,
    fill_unevenly,
    late_by,
)
from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

SOFT_DROP_KPA = 12.0
TURBULENT_KPA = 150.0


def delay_command(s: Signals, seconds: Array) -> Array:
    """Pure delay, interpolated at the fine step."""
    return late_by(s.command_kpa, seconds.ravel() / s.step_s)


def add_tube(s: Signals, seconds: Array) -> Array:
    """Set a tube's volume and its turbulent resistance in series with the valve."""
    tube = np.maximum(seconds.ravel(), 1e-6)
    return fill_through_tube(s.command_kpa, s.machine.valve_tau_s, tube, TURBULENT_KPA, s.step_s)


def limit_flow(s: Signals, seconds: Array) -> Array:
    """Flow saturates: a step of 600 kPa takes ``seconds`` at least."""
    fastest = 600.0 / np.maximum(seconds.ravel(), 1e-6)
    return fill_limited(s.command_kpa, s.machine.valve_tau_s, fastest, s.step_s)


def vent_slower(s: Signals, log_ratio: Array) -> Array:
    """Venting is slower than filling by exp(log_ratio), blended around equal pressures."""
    return fill_unevenly(s.command_kpa, s.machine.valve_tau_s, log_ratio.ravel(), SOFT_DROP_KPA, s.step_s)


def leak(s: Signals, per_s: Array) -> Array:
    """Flow out of the muscle in proportion to its pressure."""
    return fill_leaking(s.command_kpa, s.machine.valve_tau_s, per_s.ravel(), s.step_s)


def sag_supply(s: Signals, share: Array) -> Array:
    """Dip the supply while the other muscles fill, and this muscle's pressure with it."""
    filling = np.maximum(np.gradient(s.pressure_kpa, s.step_s, axis=-1), 0.0)
    others = filling.sum(axis=0, keepdims=True) - filling
    return s.pressure_kpa - share * fill_first_order(0.1 * others, np.full(4, 0.06), s.step_s)


EFFECTS = (
    Effect("transport_delay", "transport_delay", "command", "pressure_kpa", "s", 0.15, delay_command, only_form=True),
    Effect("valve_lag", "valve_lag", "valve", "pressure_kpa", "s", 0.4, add_tube),
    Effect("valve_rate_limit", "valve_rate_limit", "valve", "pressure_kpa", "s", 3.0, limit_flow),
    Effect("valve_asymmetry", "valve_asymmetry", "valve", "pressure_kpa", "log_ratio", 1.8, vent_slower),
    Effect("leakage", "leakage", "valve", "pressure_kpa", "per_s", 3.0, leak, only_form=True),
    Effect("supply_sag", "supply_sag", "pressure", "pressure_kpa", "share", 1.0, sag_supply, outsider=True),
)
