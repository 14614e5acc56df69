"""Machines of test benches: their laws in closed form, signals by the keys that name them, friction under load."""

import numpy as np
import pytest
from scipy.signal import lsim, lti

from tests.science.plant.machines import read_machine, read_plant, simulate

STEP_S = 0.01
TIME = np.arange(1000) * STEP_S
PATH = 0.2 + 0.1 * np.sin(1.3 * TIME)
SPEED = 0.13 * np.cos(1.3 * TIME)
PRESSURE, OTHER = 300.0 + 100.0 * np.sin(0.7 * TIME), 200.0 + 90.0 * np.cos(0.9 * TIME)
NAMED = {
    "muscle": {"pressure": "p_kpa", "length": "s_m", "output": "f_n"},
    "cylinder": {"pressure": "p_kpa", "second_pressure": "q_kpa", "along": "s_m", "output": "f_n"},
    "damper": {"along": "s_m", "drive": "p_kpa", "output": "f_n"},
    "finger": {"along": "p_kpa", "against": "q_kpa", "output": "f_n"},
}
LAWS = {
    "muscle": (
        {"pull": 2.0, "pull_slope": -3.0, "pull_curvature": 1.0, "tube_stiffness": -50.0, "tube_curvature": 7.0},
        PRESSURE * (2.0 - 3.0 * PATH + PATH**2) - 50.0 * PATH + 7.0 * PATH**2,
    ),
    "cylinder": (
        {"area": 0.8, "second_area": -0.7, "damping": -40.0, "spring": 9.0},
        0.8 * PRESSURE - 0.7 * OTHER - 40.0 * SPEED + 9.0 * PATH,
    ),
    "damper": (
        {"damping": 600.0, "damping_with_drive": 2.0, "spring": 800.0},
        (600.0 + 2.0 * PRESSURE) * SPEED + 800.0 * PATH,
    ),
    "finger": (
        {"gain": 4e-3, "curvature": 1e-6, "stiffening": -2e-8, "imbalance": 1e-3},
        4e-3 * (PRESSURE - OTHER) + 1e-6 * (PRESSURE - OTHER) ** 2 - 2e-8 * (PRESSURE - OTHER) ** 3 + 1e-3 * OTHER,
    ),
}
SIGNALS = {"p_kpa": PRESSURE, "q_kpa": OTHER, "s_m": PATH, "v_m_per_s": 2.0 * SPEED}


def settle(machine, **changes):
    plant = read_plant(machine, **NAMED[machine], **changes)
    return plant.resolve_from_data([SIGNALS | {"f_n": LAWS[machine][1]}], STEP_S)


@pytest.mark.parametrize("machine", LAWS)
def test_laws_in_closed_form(machine):
    constants, truth = LAWS[machine]
    found = simulate(settle(machine), SIGNALS, constants | {"offset": 5.0})
    np.testing.assert_allclose(found, truth + 5.0, atol=1e-4 * np.ptp(truth))


def test_a_measured_speed_is_taken_instead_of_differences():
    plant = settle("damper", speed="v_m_per_s")
    assert plant.inputs == ("s_m", "v_m_per_s", "p_kpa")
    constants = LAWS["damper"][0] | {"offset": 0.0}
    doubled = simulate(plant, SIGNALS, constants)
    np.testing.assert_allclose(doubled, (600.0 + 2.0 * PRESSURE) * 2.0 * SPEED + 800.0 * PATH)


@pytest.mark.parametrize("listed", [(0, 1), (1, 0)])
def test_a_sensor_reads_what_all_other_effects_have_made_of_the_answer(listed):
    effects = [
        {"name": "coulomb_friction", "form": "element", "share": 0.3, "sliding": 0.02},
        {"name": "channel_misalignment", "form": "element_filtered", "paces": 0.2},
    ]
    plant, constants = settle("cylinder", effects=[effects[place] for place in listed]), LAWS["cylinder"][0]
    found = simulate(plant, SIGNALS, constants | {"offset": 0.0})
    scale, pace_s = plant.output_scale, plant.time_scale_s
    slid = LAWS["cylinder"][1] + 0.3 * scale * np.tanh(10.0 * SPEED * pace_s / 0.02)
    np.testing.assert_allclose(found, follow(slid, 0.2 * pace_s), atol=0.01 * scale)


@pytest.mark.parametrize("effects", [[], [("coulomb_friction", "element", {"share": 0.1, "sliding": 0.1})]])
@pytest.mark.parametrize(("change", "shape"), [(lambda each: each[:1], "1, 1"), (np.transpose, "1, ")])
def test_an_answer_of_another_shape_than_the_signals_is_refused(change, shape, effects):
    class Other(type(settle("cylinder"))):
        def answer(self, signals, constants):
            return change(super().answer(signals, constants))

    other = Other.model_validate(settle("cylinder").model_dump())
    with pytest.raises(ValueError, match=rf"Other\.answer: expected an array of the signals' shape .* got \({shape}"):
        simulate(other, SIGNALS, LAWS["cylinder"][0] | {"offset": 0.0}, effects)


def test_products_of_a_signal_that_there_is_not_are_left_out():
    isometric = read_plant("muscle", **NAMED["muscle"] | {"length": None})
    assert (isometric.inputs, set(isometric.nominal)) == (("p_kpa",), {"pull", "offset"})
    open_chamber = read_plant("cylinder", **NAMED["cylinder"] | {"second_pressure": None})
    assert open_chamber.pressing == ["p_kpa"]
    assert "second_area" not in open_chamber.nominal
    assert set(read_plant("finger", **NAMED["finger"] | {"against": None}).inputs) == {"p_kpa"}


def follow(signal, tau_s):
    """What follows a signal, in a hundred steps from sample to sample."""
    late = np.full(len(signal), signal[0])
    for k in range(1, len(signal)):
        late[k] = late[k - 1]
        for i in range(100):
            straight = signal[k - 1] + (i + 0.5) / 100.0 * (signal[k] - signal[k - 1])
            late[k] += 0.01 * STEP_S / tau_s * (straight - late[k])
    return late


def test_an_answer_behind_a_filter_in_closed_form():
    plant, tau_s = settle("cylinder"), 0.08
    constants = LAWS["cylinder"][0] | {"offset": 0.0}
    effect = ("channel_misalignment", "element_filtered", {"paces": tau_s / plant.time_scale_s})
    found, plain = (simulate(plant, SIGNALS, constants, each) for each in ([effect], []))
    np.testing.assert_allclose(found, follow(plain, tau_s), atol=2e-3 * np.ptp(plain))
    assert np.abs(found - plain).max() > 0.02 * np.ptp(plain)


@pytest.mark.parametrize(
    ("effect", "behind"),
    [
        (("actuator_lag", "element", "paces"), ("p_kpa", "q_kpa")),
        (("channel_misalignment", "element_drive", "paces_late"), ("p_kpa", "q_kpa")),
        (("channel_misalignment", "element_displacement", "paces_late"), ("s_m", "v_m_per_s")),
    ],
)
def test_what_drives_or_moves_an_element_before_or_after_what_is_recorded(effect, behind):
    """The answer is that to other signals: what drives it, smoothed; or both, earlier than they were recorded."""
    plant, constants, late_s = settle("cylinder", speed="v_m_per_s"), LAWS["cylinder"][0] | {"offset": 3.0}, 4 * STEP_S
    name, form, parameter = effect
    lagged = parameter == "paces"
    changed = dict(SIGNALS)
    for signal in behind:
        earlier = np.concatenate([SIGNALS[signal][4:], np.full(4, SIGNALS[signal][-1])])
        changed[signal] = follow(SIGNALS[signal], late_s) if lagged else earlier
    found = simulate(plant, SIGNALS, constants, [(name, form, {parameter: late_s / plant.time_scale_s})])
    expected, plain = (simulate(plant, each, constants) for each in (changed, SIGNALS))
    np.testing.assert_allclose(found, expected, atol=(2e-3 if lagged else 1e-9) * np.ptp(plain))
    assert np.abs(found - plain).max() > 0.002 * np.ptp(plain)


def test_an_effect_of_what_drives_is_none_of_an_element_without():
    with pytest.raises(ValueError, match="actuator_lag needs a signal that drives it besides its displacement"):
        settle("finger", effects=[{"name": "actuator_lag", "form": "element", "paces": 0.1}])


@pytest.mark.parametrize("damping", [0.05, 0.5])
def test_an_answer_of_a_sensor_that_rings_as_scipy_has_it(damping):
    plant, tau_s = settle("cylinder"), 0.05
    constants = LAWS["cylinder"][0] | {"offset": 0.0}
    effect = ("sensor_resonance", "element", {"paces": tau_s / plant.time_scale_s, "damping": damping})
    found, plain = (simulate(plant, SIGNALS, constants, each) for each in ([effect], []))
    sensor = lti([1.0], [tau_s**2, 2.0 * damping * tau_s, 1.0])
    rung = lsim(sensor, plain - plain[0], STEP_S * np.arange(len(plain)))[1] + plain[0]
    np.testing.assert_allclose(found, rung, atol=1e-9 * np.ptp(plain))
    assert np.abs(found - plain).max() > 0.005 * np.ptp(plain)


@pytest.mark.parametrize("form", ["element_shift", "element_gain_shift"])
def test_a_sensor_that_changes_at_one_moment_in_closed_form(form):
    plant, constants = settle("cylinder"), LAWS["cylinder"][0] | {"offset": 0.0}
    moment = 0.6 * STEP_S * len(PRESSURE) / plant.time_scale_s
    effect = ("sensor_drift", form, {"share": 0.05, "paces_from_start": moment})
    found, plain = (simulate(plant, SIGNALS, constants, each) for each in ([effect], []))
    since = STEP_S * np.arange(len(plain)) / plant.time_scale_s - moment
    added = 0.05 * (plant.output_scale if form == "element_shift" else plain) / (1.0 + np.exp(-since / 0.5))
    np.testing.assert_allclose(found - plain, added, atol=1e-9 * np.ptp(plain))


@pytest.mark.parametrize("lagged", [False, True])
def test_friction_under_load_in_closed_form(lagged):
    plant, tau_s = settle("cylinder"), 0.3
    load = 0.5 * (PRESSURE + OTHER)
    load = load / load.max()
    if lagged:
        load = follow(load, tau_s)
    values = {"share": -0.2, "sliding": 0.1, "unloaded": 0.3} | (
        {"paces": tau_s / plant.time_scale_s} if lagged else {}
    )
    effect = ("load_dependent_friction", "element_lagged" if lagged else "element", values)
    constants = LAWS["cylinder"][0] | {"offset": 0.0}
    with_it, without = (simulate(plant, SIGNALS, constants, each) for each in ([effect], []))
    slides = np.tanh(SPEED * plant.time_scale_s / plant.along_scale / 0.1)
    truth = -0.2 * (load + 0.3) * slides
    np.testing.assert_allclose(((with_it - without) / plant.output_scale)[20:-20], truth[20:-20], atol=5e-4)


def test_friction_under_load_needs_what_presses():
    entry = {"name": "load_dependent_friction", "share": 0.1, "sliding": 0.1, "unloaded": 0.0}
    with pytest.raises(ValueError, match=r"load_dependent_friction needs what presses; name it, as plant\.pressing"):
        read_plant("static_map", effects=[entry])
    assert read_plant("static_map", effects=[entry], pressing=["p_kpa"]).inputs == ("position_m", "p_kpa")


def test_an_element_that_is_not_moved_is_refused():
    plant = read_plant("muscle", **NAMED["muscle"])
    still = SIGNALS | {"s_m": 0.3 + 1e-12 * np.sin(TIME), "f_n": PRESSURE}
    with pytest.raises(ValueError, match=r"signal s_m: expected one along which the element is moved, got 0\.3 "):
        plant.resolve_from_data([still], STEP_S)


@pytest.mark.parametrize("machine", LAWS)
def test_an_amended_bench_reads_back(machine):
    plant = settle(machine)
    values = {"share": 0.1, "paces": 1.5, "begun": 0.4}
    amended = plant.amend(plant.starts | LAWS[machine][0], [("creep", "element", values)])
    again = read_machine(amended.model_dump())
    given = simulate(again, SIGNALS, again.starts)
    np.testing.assert_array_equal(given, simulate(plant, SIGNALS, again.starts, [("creep", "element", values)]))
