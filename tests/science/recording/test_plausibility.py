"""Recordings that contradict how a muscle works: the sign of force and contraction, muscles that are swapped."""

import numpy as np
import pandas as pd
import pytest

from stages.discrepancy.measurement import MEASURED
from stages.science.recording.columns import RecordingError
from stages.science.recording.plausibility import check_readings, check_signals, suspect_muscles
from stages.science.recording.units import choose_unit, convert

DIAMETERS_M = {"big": 0.04, "small": 0.01}
MUSCLES = pd.DataFrame({"muscle": list(DIAMETERS_M), "nominal_diameter_m": list(DIAMETERS_M.values())})


def pull(generator, slope=-1.0, swapped=False):
    """The braid's law with an angle of 25 degrees; `slope` multiplies the contraction that is recorded."""
    frames = []
    for name, diameter_m in DIAMETERS_M.items():
        pressure, contraction = generator.uniform(50.0, 500.0, 400), generator.uniform(0.0, 0.2, 400)
        area_m2 = 0.25 * np.pi * diameter_m**2
        law = 3.0 / np.tan(0.4363) ** 2 * (1.0 - contraction) ** 2 - 1.0 / np.sin(0.4363) ** 2
        rows = {
            "pressure_kpa": pressure,
            "contraction": -slope * contraction,
            "force_n": 1e3 * pressure * area_m2 * law,
        }
        frames.append(pd.DataFrame(rows).assign(muscle=name))
    together = pd.concat(frames, ignore_index=True)
    return together.replace({"muscle": {"big": "small", "small": "big"}}) if swapped else together


def test_a_muscle_that_works_is_not_suspected(generator):
    assert suspect_muscles(pull(generator), MUSCLES) == []
    still = pull(generator).assign(contraction=0.1)
    assert suspect_muscles(still, MUSCLES) == []


def test_a_contraction_of_the_wrong_sign_and_swapped_muscles_are_told_with_what_to_type(generator):
    (told,) = suspect_muscles(pull(generator, slope=1.0), MUSCLES)
    assert told.startswith("The force of big, small grows as contraction does")
    assert told.endswith("units.contraction=-ratio.")
    (told,) = suspect_muscles(pull(generator, swapped=True), MUSCLES)
    assert "which no braid brings, on small (" in told


@pytest.mark.parametrize(
    ("name", "largest", "offered"), [("p_kpa", 6.1, "bar"), ("x_m", 250.0, "mm"), ("q_rad", 90.0, "deg")]
)
def test_a_signal_whose_unit_nothing_states_is_refused_with_both_units_where_its_values_are_unlikely(
    name, largest, offered
):
    samples = pd.DataFrame({name: np.linspace(0.0, largest, 50)})
    own = {"p_kpa": "kPa", "x_m": "m", "q_rad": "rad"}[name]
    told = (
        rf"column {name}: .* got {largest:.3g}.*; set \+units.{name}={offered}, or \+units.{name}={own} if it is right$"
    )
    with pytest.raises(RecordingError, match=told):
        check_signals(samples, [name], {})
    check_signals(samples, [name], {name: own})
    check_signals(samples.assign(**{name: np.linspace(0.0, 20.0, 50)}), [name], {})


@pytest.mark.parametrize(("unit", "offered"), [(None, "-N"), ("kN", "-kN")])
def test_a_force_of_the_wrong_sign_is_refused_and_the_unit_that_is_offered_mends_it(unit, offered, generator):
    samples = pull(generator)[["force_n"]]
    check_readings(samples, ["force_n"], MEASURED.columns, {"force_n": unit})
    with pytest.raises(RecordingError, match=f"expected tension, which is positive, .* set units.force_n={offered}$"):
        check_readings(-samples, ["force_n"], MEASURED.columns, {"force_n": unit})
    recorded = -samples["force_n"] / (1000.0 if unit == "kN" else 1.0)
    np.testing.assert_allclose(convert(recorded, "force_n", choose_unit("force_n", offered)), samples["force_n"])
