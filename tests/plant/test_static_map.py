"""An element's answer: constants times signals, effects along its way, and what is left open told by the data."""

import numpy as np
import pytest

from stages.plant.effect import ElementEffect, list_effects, list_forms
from tests.plant.machines import read_plant

STEP_S = 0.01
FORMS = [form for name in list_effects() for form in list_forms(name) if isinstance(form, ElementEffect)]


def test_the_spring_goes_with_the_way_that_is_named():
    spring = read_plant(along="s_m", output="f_n")
    assert spring.inputs == ("s_m",)
    assert spring.answer({"s_m": np.array([2.0])}, {"stiffness": 3.0, "offset": 1.0}) == pytest.approx([7.0])


def sweep(samples=2000):
    time = np.arange(samples) * STEP_S
    return {"position_m": 0.03 + 0.02 * np.sin(0.8 * time) + 0.004 * np.sin(3.1 * time)}


def settled(**changes):
    signals = sweep()
    return read_plant(**changes).settle([{**signals, "force_n": 900.0 * signals["position_m"] - 4.0}], STEP_S)


def answer(plant, effects=(), constants=None):
    columns = {name: values[:, None] for name, values in sweep().items()}
    return plant.simulate(columns, STEP_S, np.zeros(1), constants or {"stiffness": 900.0, "offset": -4.0}, effects)[
        :, 0
    ]


def test_the_answer_is_a_sum_of_products():
    constants = {
        "area": {"unit": "N/kPa", "of": ["pressure_kpa"], "start": 1.0, "low": 0.0, "high": 2.0, "sd": 1.0},
        "bend": {"unit": "N/m2", "of": ["position_m"] * 2, "start": 0.0, "low": -9.0, "high": 9.0, "sd": 1.0},
        "zero": {"unit": "N", "of": [], "start": 0.0, "low": -9.0, "high": 9.0, "sd": 1.0},
    }
    plant = read_plant(constants=constants)
    assert plant.inputs == ("position_m", "pressure_kpa")
    signals = {"position_m": np.array([[0.1], [0.2]]), "pressure_kpa": np.array([[100.0], [300.0]])}
    found = plant.simulate(signals, STEP_S, np.zeros(1), {"area": 0.5, "bend": 7.0, "zero": -3.0})
    np.testing.assert_allclose(found[:, 0], [50.0 + 0.07 - 3.0, 150.0 + 0.28 - 3.0])


def test_what_is_left_open_is_the_data_s_own():
    plant, way = settled(), sweep()["position_m"]
    assert plant.along_middle == pytest.approx(0.5 * (way.max() + way.min()))
    assert plant.along_scale == pytest.approx(0.5 * np.ptp(way))
    assert plant.output_scale == pytest.approx(450.0 * np.ptp(way))
    assert plant.pace_s == pytest.approx(plant.along_scale / np.abs(np.diff(way)).mean() * STEP_S)
    stiffness = next(each for each in plant.parameters if each.name == "stiffness")
    assert stiffness.low < -900.0 < 900.0 < stiffness.high
    assert settled(along_scale=0.5).along_scale == 0.5


def test_before_there_are_data_its_bounds_are_open():
    with pytest.raises(ValueError, match="there are no data yet"):
        _ = read_plant().parameters


def test_forms_against_closed_forms():
    plant, way = settled(), sweep()["position_m"]
    x = (way - plant.along_middle) / plant.along_scale
    rate = np.gradient(x, STEP_S) * plant.pace_s
    by_name = {(form.name, form.form): form for form in FORMS}
    expected = {
        ("cubic_stiffness", "element"): ({"share": 0.3}, 0.3 * x**3),
        ("viscous_friction", "element"): ({"share": 0.2}, 0.2 * rate),
        ("coulomb_friction", "element"): ({"share": -0.1, "sliding": 0.2}, -0.1 * np.tanh(rate / 0.2)),
    }
    for key, (values, added) in expected.items():
        np.testing.assert_allclose(
            (answer(plant, [(by_name[key], values)]) - answer(plant)) / plant.output_scale, added, atol=1e-9
        )


def test_a_play_turns_within_its_width_and_may_begin_in_mid_turn():
    plant = settled()
    form = next(each for each in FORMS if each.form == "element_play")
    loop = (answer(plant, [(form, {"share": 0.2, "width": 0.1, "begun": -1.0})]) - answer(plant)) / plant.output_scale
    x = (sweep()["position_m"] - plant.along_middle) / plant.along_scale
    stop, expected = -1.0, []
    for step in np.diff(x, prepend=x[0]):
        stop = min(max(stop + step / 0.1, -1.0), 1.0)
        expected.append(0.2 * stop)
    np.testing.assert_allclose(loop, expected, atol=1e-9)
