"""A valve that vents more slowly than it fills, or the other way round.

The time constant is multiplied by 1 + asymmetry while pressure falls and divided by it while pressure rises. The
signature is a pressure error whose sign goes with the direction of change.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter, State, Values
from stages.science.plant.filters import respond
from stages.science.signals.trajectories import Array


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    tau, factor = state.muscles.valve_tau_s, 1.0 + parameters["asymmetry"]
    unequal = respond(state.command_kpa, tau / factor, tau * factor, state.step_s)
    equal = respond(state.command_kpa, tau, tau, state.step_s)
    return signal + state.muscles.regulator_gain * (unequal - equal)


EFFECT = ChainEffect(
    name="valve_asymmetry",
    form="two_time_constants",
    site="valve",
    signal="pressure_kpa",
    parameters=(
        Parameter(
            "asymmetry", "1", -0.6, 1.5, 0.2, 0.3, "venting's time constant over the nominal one, less 1", (0.3, -0.25)
        ),
    ),
    source=(
        "Tassa, Wu, Movellan, Todorov, Modeling and identification of pneumatic actuators, IEEE ICMA (2013): filling "
        "and venting flows differ"
    ),
    signature="pressure errs after steps up and after steps down with the same sign: one is slow, the other quick",
    split_by="equal steps of command up and down",
    apply=_apply,
)

UNEQUAL_LAG = DynamicEffect(
    name="valve_asymmetry",
    form="lag",
    site="lag",
    parameters=(
        Parameter("asymmetry", "1", -0.6, 1.5, 0.0, 0.3, "time constant of falling over that of both, less 1", (0.3,)),
    ),
    source=EFFECT.source,
    signature="the output errs after steps up and after steps down with the same sign: one is slow, the other quick",
    split_by="equal steps of the input up and down",
    terms=name_terms(asymmetry="asymmetry"),
)

FORMS = (EFFECT, UNEQUAL_LAG)
