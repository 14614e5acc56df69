"""A sensor that shows no more than a level, however much there is; that of a machine may end at both sides.

Where there is one level, the magnitude is its inverse: at zero it is infinite. Where readings end at one side or both,
it is the share of what lies beyond that is not read. Values exactly equal to the largest or to the smallest, again and
again, give the ends away.
"""

import math
from dataclasses import replace

import numpy as np

from stages.science.effects import name_terms
from stages.science.plant.effect import Bench, ChainEffect, DynamicEffect, ElementEffect, Parameter, Values
from stages.science.plant.filters import read
from stages.science.signals.trajectories import Array

SCALE_KPA = 1000.0


def _clip(signal: Array, scale: Array | float, ratio: float) -> Array:
    return np.minimum(signal, scale / ratio) if ratio > 0.0 else signal


EFFECT = ChainEffect(
    name="saturation",
    form="force",
    site="sensor",
    signal="sensed_force_n",
    parameters=(
        Parameter("full_force_over_level", "1", 0.0, 50.0, 0.5, 2.0, "largest force over the level", (1.5, 3.0, 6.0)),
    ),
    source="Bendat, Piersol, Random data, 4th edition (2010), chapter 10: data acquisition",
    signature="force stays at one value wherever it should exceed it",
    split_by="a slow sweep to the largest pressure",
    apply=lambda signal, state, parameters: _clip(
        signal, state.muscles.full_force_n, parameters["full_force_over_level"]
    ),
)

FARTHEST = 1e6
"""Scales within which an end may lie: signals may be small beside their offset."""
ENDS = (
    Parameter("share", "1", 0.0, 1.1, 1.0, 0.5, "of what lies beyond an end that is not read", (1.0,)),
    Parameter("lowest", "1", -FARTHEST, FARTHEST, -1.0, 1.0, "least reading over the scale", (-0.3,), optional=True),
    Parameter("highest", "1", -FARTHEST, FARTHEST, 1.0, 1.0, "largest reading over the scale", (0.3,), optional=True),
)


def _find_ends(parameters: Values) -> dict[str, float]:
    """Return the ends that there are, by name; a `ValueError` tells none, or a lowest that is not below the highest."""
    ends = {end: parameters[end] for end in ("lowest", "highest") if end in parameters}
    if not ends:
        raise ValueError("effect saturation: expected lowest, highest or both, in scales of the output, got neither")
    low, high = ends.get("lowest", -math.inf), ends.get("highest", math.inf)
    if not low < high:
        raise ValueError(f"effect saturation: expected lowest below highest, got {low:g} and {high:g}")
    return ends


DRIVE = DynamicEffect(
    name="saturation",
    form="drive",
    site="motion",
    parameters=(
        Parameter("scale_over_level", "1", 0.0, 50.0, 0.0, 2.0, "scale of motion over the level", (0.7, 1.3, 3.0)),
    ),
    source=EFFECT.source,
    signature="the response stays behind where the input is largest, at any frequency",
    split_by="a slow sweep of the input to its largest value",
    terms=name_terms(drive_cut="scale_over_level"),
    scales=False,
)

READING = replace(
    DRIVE,
    form="reading",
    parameters=ENDS,
    signature="the response stays at one value wherever it should go beyond it, at one end or at both",
    split_by="a resonant motion beyond the ends",
    terms=lambda parameters: {"unread": parameters["share"], **_find_ends(parameters)},
)

TANK_READING = replace(
    READING,
    form="tank_reading",
    site="tank",
    signature="the reading stays at one value wherever the level should go beyond it",
    split_by="a gauge on the glass beside the sensor",
)

FULL_TANK = replace(
    TANK_READING,
    form="full_tank",
    parameters=DRIVE.parameters,
    source=(
        "Schoukens, Noel, Three benchmarks addressing open challenges in nonlinear system identification, IFAC "
        "PapersOnLine 50-1 (2017): the lower tank runs over, too"
    ),
    signature="the level stays at one value however much runs in, and falls from there as soon as less does",
    terms=name_terms(level_cut="scale_over_level"),
)


def _apply_to_element(answer: Array, bench: Bench, parameters: Values) -> Array:
    ends = _find_ends(parameters)
    return read(answer, parameters["share"], ends.get("lowest", -math.inf), ends.get("highest", math.inf))


CUT_ELEMENT = ElementEffect(
    name="saturation",
    parameters=ENDS,
    source=EFFECT.source,
    signature="the answer stays at one value wherever it should go beyond it, at one end or at both",
    split_by=EFFECT.split_by,
    apply=_apply_to_element,
    changes="reading",
)

LAG_DRIVE = replace(
    DRIVE,
    form="lag_drive",
    site="lag",
    signature="the output stays behind where the input is largest, however long it lasts",
)
LAG_READING = replace(
    TANK_READING,
    form="lag_reading",
    site="lag",
    signature="the reading stays at one value wherever the output should go beyond it",
    split_by="a second sensor of a wider range",
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        parameters=(Parameter("mpa_over_level", "1", 0.0, 50.0, 0.5, 2.0, "1000 kPa over the level", (1.5, 3.0, 6.0)),),
        signature="pressure stays at one value wherever it should exceed it",
        apply=lambda signal, state, parameters: _clip(signal, SCALE_KPA, parameters["mpa_over_level"]),
    ),
    DRIVE,
    READING,
    CUT_ELEMENT,
    TANK_READING,
    FULL_TANK,
    LAG_DRIVE,
    LAG_READING,
)
