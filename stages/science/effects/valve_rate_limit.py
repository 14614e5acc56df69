"""A valve whose flow saturates: pressure changes no more quickly than a limit, however far the command is.

The magnitude is the inverse of the limit: at zero there is none. Small and slow changes are not touched.
"""

import numpy as np
from numba import njit

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter, State, Values
from stages.science.plant.filters import respond
from stages.science.signals.trajectories import Array

KPA_PER_MPA = 1000.0


@njit(cache=True, error_model="numpy")
def _follow_limited(command: Array, tau_s: Array, limit: float, step_s: float) -> Array:
    """Solve dP/dt = (u - P) / tau, cut at the limit, exactly for a held command."""
    pressure = np.empty_like(command)
    pressure[0] = command[0]
    for k in range(command.shape[0] - 1):
        for m in range(command.shape[1]):
            tau = max(tau_s[m], 1e-9)
            gap = pressure[k, m] - command[k, m]
            limited_s = max(abs(gap) / limit - tau, 0.0)
            straight = min(limited_s, step_s)
            gap -= np.sign(gap) * limit * straight
            pressure[k + 1, m] = command[k, m] + gap * np.exp(-(step_s - straight) / tau)
    return pressure


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    slowness, tau = parameters["slowness_s_per_mpa"], state.muscles.valve_tau_s
    if slowness == 0.0:
        return signal
    limited = _follow_limited(np.ascontiguousarray(state.command_kpa), tau, KPA_PER_MPA / slowness, state.step_s)
    plain = respond(state.command_kpa, tau, tau, state.step_s)
    return signal + state.muscles.regulator_gain * (limited - plain)


EFFECT = ChainEffect(
    name="valve_rate_limit",
    form="saturated_flow",
    site="valve",
    signal="pressure_kpa",
    parameters=(
        Parameter("slowness_s_per_mpa", "s/MPa", 0.0, 20.0, 0.5, 1.0, "inverse of the largest rate", (0.5, 1.5, 5.0)),
    ),
    source=(
        "Beater, Pneumatic drives: system design, modelling and control (2007): choked flow does not grow "
        "with the pressure drop"
    ),
    signature="pressure climbs straight after large steps, late by more the larger the step",
    split_by="small and large steps of command from one level",
    apply=_apply,
)

LIMITED_LAG = DynamicEffect(
    name="valve_rate_limit",
    form="lag",
    site="lag",
    parameters=(
        Parameter(
            "slowness", "1", 0.0, 50.0, 0.0, 2.0, "inverse of the largest rate, paces per scale", (0.7, 1.5, 4.0)
        ),
    ),
    source=EFFECT.source,
    signature="the output climbs straight after large steps, late by more the larger the step",
    split_by="small and large steps of the input from one level",
    terms=name_terms(rate_cut="slowness"),
    scales=False,
)

FORMS = (EFFECT, LIMITED_LAG)
