"""A dead time between the command and the valve: bus, driver and hose."""

import numpy as np

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    samples = parameters["delay_s"] / state.step_s
    whole = int(samples)
    share = samples - whole
    padded = np.concatenate([np.repeat(signal[:1], whole + 1, axis=0), signal])
    length = len(signal)
    return np.ascontiguousarray((1.0 - share) * padded[1 : length + 1] + share * padded[:length])


EFFECT = ChainEffect(
    name="transport_delay",
    form="fractional_delay",
    site="command",
    signal="pressure_command_kpa",
    parameters=(Parameter("delay_s", "s", 0.0, 0.2, 0.01, 0.01, "from command to valve", (0.01, 0.04, 0.1)),),
    source="Astrom, Hagglund, PID controllers: theory, design and tuning (1995), chapter 2: first order with dead time",
    signature="pressure lags behind the command by the same time at every rate of change",
    split_by="steps of command, or a chirp to 10 Hz: a delay keeps the amplitude",
    apply=_apply,
)

LATE_INPUT = DynamicEffect(
    name="transport_delay",
    form="late_input",
    site="motion",
    parameters=(
        Parameter("periods", "1", 0.0, 2.0, 0.0, 0.1, "how late the input acts, over 2 pi paces", (0.02, 0.1)),
    ),
    source="Ljung, System identification: theory for the user, 2nd edition (1999), section 4.2: input delay",
    signature="the residual leads the response by the same time at every frequency",
    split_by="a chirp or steps of the input",
    terms=name_terms(delay="periods"),
)

LATE_LAG = DynamicEffect(
    name="transport_delay",
    form="lag",
    site="lag",
    parameters=(Parameter("paces", "1", 0.0, 5.0, 0.0, 0.3, "how late the input acts, in paces", (0.05, 0.3, 1.0)),),
    source=EFFECT.source,
    signature="the output answers to steps late, and then as it should",
    split_by="steps of the input",
    terms=name_terms(delay="paces"),
)

FORMS = (EFFECT, LATE_INPUT, LATE_LAG)
