"""A sensor whose zero wanders off along the session, evenly or until it has warmed up, or changes at one moment.

So may its gain, as that of a load cell that slips or is knocked.

Time is that of the session: the trial's start, and the time within it. Where starts are not known, only the time within
the trial counts.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import FROM_START, Bench, ChainEffect, ElementEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array

MINUTE_S = 60.0


def _session_s(state: State) -> Array:
    return state.time_s[:, None] + state.start_s


def _warm(state: State, tau_s: float) -> Array:
    return -np.expm1(-_session_s(state) / tau_s)


TAU = Parameter("tau_s", "s", 5.0, 3600.0, 200.0, 200.0, "time constant of warming up", (40.0, 200.0))

EFFECT = ChainEffect(
    name="sensor_drift",
    form="force_linear",
    site="sensor",
    signal="sensed_force_n",
    parameters=(
        Parameter("share_per_min", "1/min", -0.1, 0.1, 0.0, 0.005, "drift over the largest force", (0.003, -0.003)),
    ),
    source="JCGM 200, International vocabulary of metrology (2012), 4.21: instrumental drift",
    signature="force errs by an amount that changes along the session and not with what is done",
    split_by="the same reference trial at the session's start, middle and end",
    apply=lambda signal, state, parameters: (
        signal + parameters["share_per_min"] * state.muscles.full_force_n * (_session_s(state) / MINUTE_S)
    ),
)

DRIFTING_ELEMENT = ElementEffect(
    name="sensor_drift",
    parameters=(
        Parameter("share_per_100_paces", "1", -5.0, 5.0, 0.0, 0.3, "drift over the answer's scale", (0.1, -0.1)),
    ),
    source=EFFECT.source,
    signature="the answer errs by an amount that changes along the session and not with what is done",
    split_by="the same movement at the beginning and at the end",
    apply=lambda answer, bench, parameters: (
        answer + parameters["share_per_100_paces"] * bench.session_s / (100.0 * bench.time_scale_s)
    ),
    changes="reading",
)


def _apply_warming_to_element(answer: Array, bench: Bench, parameters: Values) -> Array:
    since = bench.session_s / (100.0 * bench.time_scale_s)
    return answer + parameters["share"] * (1.0 - np.exp(-since * parameters["rate_per_100_paces"]))


WARMING_ELEMENT = replace(
    DRIFTING_ELEMENT,
    form="element_warming",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.3, "drift in the end over the answer's scale", (0.1, -0.1)),
        Parameter("rate_per_100_paces", "1", 0.01, 20.0, 1.0, 2.0, "how quickly it ends, in 100 paces", (0.3, 2.0)),
    ),
    apply=_apply_warming_to_element,
)

WITHIN = 0.5
"""Paces within which a sensor changes at one moment, so that a fit finds it; assumed: less than a movement takes."""


def _change_at_once(bench: Bench, parameters: Values) -> Array:
    since = bench.session_s / bench.time_scale_s - parameters[FROM_START]
    return 0.5 + 0.5 * np.tanh(since / (2.0 * WITHIN))


SHIFTING_ELEMENT = replace(
    DRIFTING_ELEMENT,
    form="element_shift",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.3, "change of the zero over the answer's scale", (0.1, -0.1)),
        Parameter(FROM_START, "1", 0.0, 1e4, 0.0, 2e3, "when it changes, in paces of the session", (10.0, 30.0, 100.0)),
    ),
    signature="the answer errs by another amount from one moment on, whatever is done",
    apply=lambda answer, bench, parameters: answer + parameters["share"] * _change_at_once(bench, parameters),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="force_warming",
        parameters=(Parameter("share", "1", -0.3, 0.3, 0.0, 0.02, "drift over the largest force", (0.02, -0.02)), TAU),
        apply=lambda signal, state, parameters: (
            signal + parameters["share"] * state.muscles.full_force_n * _warm(state, parameters["tau_s"])
        ),
    ),
    replace(
        EFFECT,
        form="pressure_linear",
        signal="sensed_pressure_kpa",
        parameters=(Parameter("drift_kpa_per_min", "kPa/min", -50.0, 50.0, 0.0, 2.0, "drift", (1.0, -1.0)),),
        signature="pressure errs by an amount that changes along the session and not with what is done",
        apply=lambda signal, state, parameters: (
            signal + parameters["drift_kpa_per_min"] * (_session_s(state) / MINUTE_S)
        ),
    ),
    replace(
        EFFECT,
        form="pressure_warming",
        signal="sensed_pressure_kpa",
        parameters=(Parameter("drift_kpa", "kPa", -100.0, 100.0, 0.0, 5.0, "drift in the end", (6.0, -6.0)), TAU),
        signature="pressure errs by an amount that changes along the session and not with what is done",
        apply=lambda signal, state, parameters: signal + parameters["drift_kpa"] * _warm(state, parameters["tau_s"]),
    ),
    DRIFTING_ELEMENT,
    WARMING_ELEMENT,
    SHIFTING_ELEMENT,
    replace(
        SHIFTING_ELEMENT,
        form="element_gain_shift",
        parameters=(
            Parameter("share", "1", -0.9, 5.0, 0.0, 0.1, "change of the gain, less 1", (0.05, -0.05)),
            SHIFTING_ELEMENT.parameters[1],
        ),
        signature="the answer errs in proportion to itself, by another share from one moment on",
        split_by="known loads on the sensor before and after",
        apply=lambda answer, bench, parameters: (
            answer * (1.0 + parameters["share"] * _change_at_once(bench, parameters))
        ),
    ),
)
