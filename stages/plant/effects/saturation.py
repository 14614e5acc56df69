"""A sensor that shows no more than a level, however much there is.

The magnitude is the inverse of the level: at zero the level is infinite. Values exactly equal to the largest, again and
again, give it away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stages.plant.effect import Bench, ChainEffect, DynamicEffect, ElementEffect, Parameter, State
from stages.signals.trajectories import Array

SCALE_KPA = 1000.0


def _clip(signal: Array, scale: Array | float, ratio: float) -> Array:
    return np.minimum(signal, scale / ratio) if ratio > 0.0 else signal


def apply(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the force, N, up to the level."""
    return _clip(signal, state.muscles.full_force_n, parameters["full_force_over_level"])


def apply_to_pressure(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the pressure, kPa, up to the level."""
    return _clip(signal, SCALE_KPA, parameters["mpa_over_level"])


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
    relatives=(),
    apply=apply,
)


def cut_drive(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the oscillator's term: one scale of motion over the one that the largest drive holds at rest."""
    return {"drive_cut": parameters["scale_over_level"]}


def cut_reading(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the oscillator's term: one scale of motion over the largest that is read."""
    return {"sensor_cut": parameters["scale_over_level"]}


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
    relatives=(),
    terms=cut_drive,
    scales=False,
)

READING = replace(
    DRIVE,
    form="reading",
    signature="the response stays at one value wherever it should exceed it",
    split_by="a resonant motion beyond the level",
    terms=cut_reading,
)


def cut_tank_reading(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the tanks' term: scale over the largest reading."""
    return {"reading_cut": parameters["scale_over_level"]}


TANK_READING = replace(
    READING,
    form="tank_reading",
    site="tank",
    signature="the reading stays at one value wherever the level should exceed it",
    split_by="a gauge on the glass beside the sensor",
    relatives=("overflow",),
    terms=cut_tank_reading,
)


def fill_tank(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the tanks' term: scale over the reading at which the lower tank is full."""
    return {"level_cut": parameters["scale_over_level"]}


FULL_TANK = replace(
    TANK_READING,
    form="full_tank",
    source=(
        "Schoukens, Noel, Three benchmarks addressing open challenges in nonlinear system identification, IFAC "
        "PapersOnLine 50-1 (2017): the lower tank runs over, too"
    ),
    signature="the level stays at one value however much runs in, and falls from there as soon as less does",
    terms=fill_tank,
)


def apply_to_element(answer: Array, bench: Bench, parameters: Mapping[str, float]) -> Array:
    """Return an element's answer up to a level."""
    return _clip(answer, 1.0, parameters["scale_over_level"])


CUT_ELEMENT = ElementEffect(
    name="saturation",
    form="element",
    parameters=(
        Parameter("scale_over_level", "1", 0.0, 20.0, 0.5, 1.0, "the answer's scale over the level", (0.6, 1.2, 2.0)),
    ),
    source=EFFECT.source,
    signature="the answer stays at one value wherever it should exceed it",
    split_by=EFFECT.split_by,
    relatives=("cubic_stiffness",),
    apply=apply_to_element,
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
    signature="the reading stays at one value wherever the output should exceed it",
    split_by="a second sensor of a wider range",
    relatives=(),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        parameters=(Parameter("mpa_over_level", "1", 0.0, 50.0, 0.5, 2.0, "1000 kPa over the level", (1.5, 3.0, 6.0)),),
        signature="pressure stays at one value wherever it should exceed it",
        apply=apply_to_pressure,
    ),
    DRIVE,
    READING,
    CUT_ELEMENT,
    TANK_READING,
    FULL_TANK,
    LAG_DRIVE,
    LAG_READING,
)
