"""A second lag behind the valve: a hose and a volume that fill through it.

Two first-order lags in series turn a step of command into an S, which starts flat.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter
from stages.science.plant.filters import lag

EFFECT = ChainEffect(
    name="valve_lag",
    form="second_first_order",
    site="valve",
    signal="pressure_kpa",
    parameters=(Parameter("lag_s", "s", 0.0, 0.5, 0.015, 0.02, "time constant of the second lag", (0.015, 0.06)),),
    source=(
        "Richer, Hurmuzlu, A high performance pneumatic force actuator system: part I, nonlinear mathematical model, "
        "J. Dyn. Syst. Meas. Control 122 (2000): hose and chamber behind the valve"
    ),
    signature="pressure starts later than the model after a step and then catches up more steeply",
    split_by="steps of command, or a chirp to 10 Hz: a lag loses amplitude, a delay does not",
    apply=lambda signal, state, parameters: lag(signal, parameters["lag_s"], state.step_s),
)

SECOND_LAG = DynamicEffect(
    name="valve_lag",
    form="lag",
    site="lag",
    parameters=(Parameter("paces", "1", 0.0, 20.0, 0.0, 0.5, "time constant of the second lag, paces", (0.1, 0.5)),),
    source=EFFECT.source,
    signature="the output starts later than the model after a step and then catches up more steeply",
    split_by="steps of the input, or a chirp: a lag loses amplitude, a delay does not",
    terms=name_terms(second_lag="paces"),
)

FORMS = (EFFECT, SECOND_LAG)
