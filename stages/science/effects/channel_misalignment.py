"""Channels that were sampled at different times: the force, the pressure or the motion is late against the others.

`force` shifts the load cell, `pressure` the pressure sensor; `filtered_force`, `filtered_pressure` and
`element_filtered` are first-order filters of their amplifiers; `contraction` says by how much the recorded motion is
later than the one that acted. The rate of contraction, which enters the mild damping alone, is left where it is. In an
element on a bench the answer is late, what drives it, or how it is moved. Within a sample, signals run straight.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, ElementEffect, Parameter, State, Values
from stages.science.plant.filters import lag, shift
from stages.science.signals.trajectories import Array


def _take_back(signal: Array, state: State, parameters: Values) -> Array:
    return shift(signal, -parameters["late_s"] / state.step_s)


def _sharpen(signal: Array, state: State, parameters: Values) -> Array:
    return np.asarray(signal + parameters["tau_s"] * np.gradient(signal, state.step_s, axis=0))


EFFECT = ChainEffect(
    name="channel_misalignment",
    form="force",
    site="sensor",
    signal="sensed_force_n",
    parameters=(
        Parameter(
            "late_s", "s", -0.3, 0.3, 0.0, 0.05, "by which force is later than pressure and motion", (0.02, -0.02)
        ),
    ),
    source="Ljung, System identification: theory for the user, 2nd edition (1999), chapter 14: preprocessing data",
    signature="force errs in proportion to its own rate of change, whether pressure or motion changes it",
    split_by="steps of pressure at rest, and quick reversals at constant pressure",
    apply=lambda signal, state, parameters: shift(signal, parameters["late_s"] / state.step_s),
)

LATE_ELEMENT = ElementEffect(
    name="channel_misalignment",
    parameters=(
        Parameter("paces_late", "1", -0.3, 0.3, 0.0, 0.03, "by which the answer is late, over the pace", (0.03, -0.03)),
    ),
    source=EFFECT.source,
    signature="the answer errs in proportion to its own rate of change",
    split_by="the same loop at three speeds: its width grows with speed and with stiffness",
    apply=lambda answer, bench, parameters: shift(answer, parameters["paces_late"] * bench.time_scale_s / bench.step_s),
    changes="reading",
)

FILTERED = replace(
    EFFECT,
    form="filtered_force",
    parameters=(Parameter("tau_s", "s", 0.0, 0.16, 0.0, 0.05, "time constant of the sensor's filter", (0.02, 0.08)),),
    source="Doebelin, Measurement systems: application and design, 5th edition (2004), chapter 3: instruments",
    signature="force errs in proportion to its own rate of change, and less so after a sudden step",
    apply=lambda signal, state, parameters: lag(signal, parameters["tau_s"], state.step_s),
)

FILTERED_ELEMENT = replace(
    LATE_ELEMENT,
    form="element_filtered",
    parameters=(
        Parameter("paces", "1", 0.0, 0.5, 0.0, 0.1, "time constant of the sensor's filter over the pace", (0.03, 0.1)),
    ),
    source=FILTERED.source,
    signature="the answer errs in proportion to its own rate of change, and less so after a sudden step",
    apply=lambda answer, bench, parameters: lag(answer, parameters["paces"] * bench.time_scale_s, bench.step_s),
)

LATE_DRIVE = replace(
    LATE_ELEMENT,
    form="element_drive",
    parameters=(
        replace(LATE_ELEMENT.parameters[0], description="by which what drives is recorded late, over the pace"),
    ),
    signature="the answer errs in proportion to the rate of change of what drives the element",
    split_by="steps of what drives it, while it is held",
    apply=lambda drive, bench, parameters: shift(drive, -parameters["paces_late"] * bench.time_scale_s / bench.step_s),
    changes="drive",
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        parameters=(replace(EFFECT.parameters[0], description="by which pressure is later than force and motion"),),
        signature="pressure errs in proportion to its own rate of change, and force as if it came before the pressure",
        invert=_take_back,
    ),
    replace(
        EFFECT,
        form="contraction",
        signal="contraction",
        parameters=(replace(EFFECT.parameters[0], description="by which motion is later than pressure and force"),),
        signature="force errs in proportion to the velocity of the joint and to pressure",
        apply=_take_back,
    ),
    FILTERED,
    replace(
        FILTERED,
        form="filtered_pressure",
        signal="sensed_pressure_kpa",
        signature="pressure errs in proportion to its own rate of change, and force as if it came before the pressure",
        invert=_sharpen,
    ),
    LATE_ELEMENT,
    FILTERED_ELEMENT,
    LATE_DRIVE,
    replace(
        LATE_DRIVE,
        form="element_displacement",
        parameters=(
            replace(
                LATE_ELEMENT.parameters[0], description="by which it is recorded late how it is moved, over the pace"
            ),
        ),
        signature="the answer errs in proportion to the rate at which the element is moved",
        split_by="the same motion at two speeds, while what drives it is constant",
        changes="displacement",
    ),
)
