"""An element's answer: constants times signals, effects along its way, and what is left open told by the data."""

import numpy as np
import pytest

from tests.science.plant.machines import read_plant, simulate

STEP_S = 0.01


def sweep(samples=2000):
    """A spring that is moved slowly and quickly."""
    time = np.arange(samples) * STEP_S
    way = 0.03 + 0.02 * np.sin(0.8 * time) + 0.004 * np.sin(3.1 * time)
    return {"position_m": way, "force_n": 900.0 * way - 4.0}


def settled(**changes):
    return read_plant(**changes).resolve_from_data([sweep()], STEP_S)


def add(plant, *effect):
    """Return what an effect adds, over the scale of the output."""
    constants = {"stiffness": 900.0, "offset": -4.0}
    with_it, without = (simulate(plant, sweep(), constants, effects) for effects in ([effect], []))
    return (with_it - without) / plant.output_scale


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
    assert plant.time_scale_s == pytest.approx(plant.along_scale / np.abs(np.diff(way)).mean() * STEP_S)
    stiffness = next(each for each in plant.parameters if each.name == "stiffness")
    assert stiffness.low < -900.0 < 900.0 < stiffness.high
    assert settled(along_scale=0.5).along_scale == 0.5


def test_before_there_are_data_its_bounds_are_open_and_it_goes_with_the_way_that_is_named():
    spring = read_plant(along="s_m", output="f_n")
    assert spring.inputs == ("s_m",)
    assert spring.answer({"s_m": np.array([2.0])}, {"stiffness": 3.0, "offset": 1.0}) == pytest.approx([7.0])
    with pytest.raises(ValueError, match="there are no data yet"):
        _ = read_plant().parameters


def test_forms_against_closed_forms():
    plant, way = settled(), sweep()["position_m"]
    x = (way - plant.along_middle) / plant.along_scale
    time = np.arange(len(way)) * STEP_S
    rate = (0.016 * np.cos(0.8 * time) + 0.0124 * np.cos(3.1 * time)) / plant.along_scale * plant.time_scale_s
    stop, turned = -1.0, []
    for step in np.diff(x, prepend=x[0]):
        stop = min(max(stop + step / 0.1, -1.0), 1.0)
        turned.append(stop)
    inner = slice(20, -20)  # at the ends, the rate is that of the end of a polynomial
    for name, form, values, added, error in (
        ("cubic_stiffness", "element", {"share": 0.3}, 0.3 * x**3, 1e-9),
        ("viscous_friction", "element", {"share": 0.2}, 0.2 * rate, 1e-4),
        ("coulomb_friction", "element", {"share": -0.1, "sliding": 0.2}, -0.1 * np.tanh(rate / 0.2), 1e-4),
        # a play turns within its width and may begin in mid turn
        ("hysteresis", "element_play", {"share": 0.2, "width": 0.1, "begun": -1.0}, 0.2 * np.array(turned), 1e-9),
    ):
        found = add(plant, name, form, values)
        np.testing.assert_allclose(found[inner], added[inner], atol=error, err_msg=name)
