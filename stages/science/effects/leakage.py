"""Air that leaves the muscle as long as there is pressure in it.

`linear` outflow scales gain and time constant of the valve, which take it up. `orifice` outflow goes with the root of
pressure, as through a small hole, and weighs more at low pressure.
"""

from dataclasses import replace

import numpy as np
from numba import njit

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.plant.filters import respond
from stages.science.signals.trajectories import Array

USUAL_KPA = 100.0


@njit(cache=True, error_model="numpy")
def _leak_by_root(command: Array, tau_s: Array, rate: float, step_s: float) -> Array:
    """Solve dP/dt = (u - P) / tau - rate sqrt(100 kPa P), with the outflow of each sample's start."""
    pressure = np.empty_like(command)
    for m in range(command.shape[1]):
        tau = max(tau_s[m], 1e-9)
        decay, loss = np.exp(-step_s / tau), rate * tau * np.sqrt(USUAL_KPA)
        settled = max(np.sqrt(max(command[0, m], 0.0) + 0.25 * loss**2) - 0.5 * loss, 0.0)
        pressure[0, m] = settled**2 if command[0, m] > 0.0 else command[0, m]
        for k in range(command.shape[0] - 1):
            aim = command[k, m] - loss * np.sqrt(max(pressure[k, m], 0.0))
            pressure[k + 1, m] = aim + decay * (pressure[k, m] - aim)
    return pressure


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    tau = state.muscles.valve_tau_s
    left = 1.0 / (1.0 + parameters["leak_per_s"] * tau)
    leaky = left * respond(state.command_kpa, left * tau, left * tau, state.step_s)
    plain = respond(state.command_kpa, tau, tau, state.step_s)
    return signal + state.muscles.regulator_gain * (leaky - plain)


def _apply_orifice(signal: Array, state: State, parameters: Values) -> Array:
    tau = state.muscles.valve_tau_s
    command = np.ascontiguousarray(state.command_kpa)
    leaky = _leak_by_root(command, tau, parameters["leak_per_s"], state.step_s)
    return signal + state.muscles.regulator_gain * (leaky - _leak_by_root(command, tau, 0.0, state.step_s))


LEAK = Parameter("leak_per_s", "1/s", 0.0, 10.0, 0.5, 0.5, "rate of outflow over pressure", (0.5, 2.0))

EFFECT = ChainEffect(
    name="leakage",
    form="linear",
    site="valve",
    signal="pressure_kpa",
    parameters=(LEAK,),
    source="Beater, Pneumatic drives: system design, modelling and control (2007): leakage",
    signature="pressure settles below the command, by a share of it",
    split_by="a staircase of commands, each held until it settles, and the supply shut off",
    apply=_apply,
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="orifice",
        parameters=(replace(LEAK, description="rate of outflow over pressure at 100 kPa"),),
        signature="pressure settles below the command, by a larger share at low pressure",
        apply=_apply_orifice,
    ),
)
