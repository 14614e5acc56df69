"""Air through orifices: a leak, and a valve that chokes.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: pressure, kPa, (4, trials, fine samples). Flows follow ISO 6358: full
below the critical ratio of pressures, an ellipse above it.
"""

import numpy as np
from numba import njit

from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

AMBIENT_KPA = 101.3
SUPPLY_KPA = 801.3
CRITICAL = 0.35
LEAST_FLOW = 0.08
VENT_PORT = 0.6


@njit(cache=True)
def conductance(ratio: float) -> float:
    """Share of the choked flow at a ratio of outlet to inlet pressure, at least ``LEAST_FLOW``."""
    if ratio <= CRITICAL:
        return 1.0
    over = min((ratio - CRITICAL) / (1.0 - CRITICAL), 1.0)
    return max(np.sqrt(1.0 - over * over), LEAST_FLOW)


@njit(cache=True)
def fill_with_hole(target: Array, tau: Array, hole: Array, step: float) -> Array:
    """Lag with an orifice to the open; ``hole`` per second of the absolute pressure, where it is choked."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        for k in range(target.shape[1]):
            state = target[m, k, 0]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                inside = max(state, 0.0) + AMBIENT_KPA
                flow = inside * conductance(AMBIENT_KPA / inside)
                flow *= min(max(state, 0.0) / 5.0, 1.0)
                state += (1.0 - np.exp(-step / tau[m])) * (target[m, k, i] - state) - step * hole[m] * flow
    return out


@njit(cache=True)
def fill_choking(target: Array, tau: Array, power: Array, step: float) -> Array:
    """Lag whose speed is a port's flow to the ``power``, over that at the middle of the range."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        for k in range(target.shape[1]):
            state = target[m, k, 0]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                inside = max(state, 0.0) + AMBIENT_KPA
                if target[m, k, i] > state:
                    flow = conductance(inside / SUPPLY_KPA)
                else:
                    flow = VENT_PORT * inside / 350.0 * conductance(AMBIENT_KPA / inside)
                now = tau[m] / flow ** power[m]
                state += (1.0 - np.exp(-step / now)) * (target[m, k, i] - state)
    return out


def orifice_leak(s: Signals, per_s: Array) -> Array:
    """Lose air through a hole in the bladder."""
    return fill_with_hole(s.command_kpa, s.machine.valve_tau_s, per_s.ravel(), s.step_s)


def choked_valve(s: Signals, power: Array) -> Array:
    """Fill from the supply and vent to the open through ports that choke; 1 is an ideal orifice."""
    return fill_choking(s.command_kpa, s.machine.valve_tau_s, power.ravel(), s.step_s)


EFFECTS = (
    Effect("orifice_leak", "leakage", "valve", "pressure_kpa", "per_s", 3.0, orifice_leak),
    Effect("choked_valve", "valve_asymmetry", "valve", "pressure_kpa", "power", 3.5, choked_valve),
)
