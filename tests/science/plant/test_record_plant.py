"""Sections of machines of records: what they may leave to the data, what is refused, and how one is amended."""

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from stages.science.plant.effect import find_effect, list_effects
from stages.science.plant.effect_config import list_effects_at
from stages.science.plant.machine import read_machine
from stages.science.plant.record_plant import read_initial_state
from tests.science.discrepancy.simulated_records import build_records, drive, joint, lag, tabulate
from tests.science.discrepancy.simulated_records import configured as configured_oscillator
from tests.science.plant.columns import begin, label
from tests.science.plant.machines import begin_surely, read_plant, simulate
from tests.science.plant.test_static_map import sweep

RIM = {"name": "overflow", "scale_over_rim": 1.0, "share_down": 0.1}
SPRING = {"name": "cubic_stiffness", "share": 0.2}
LONE = {"unit": "1", "of": [], "start": 1.0, "low": 0.0, "high": 2.0, "sd": 1.0}
NO_OTHER = "expected another signal than those it is told from, got "


@pytest.mark.parametrize(
    ("kind", "changes", "told"),
    [
        ("first_order", {"effects": [{"name": "creep"}]}, "creep does not act at a lag"),
        ("first_order", {"effects": [{"name": "valve_lag", "paces": 0.1}] * 2}, "sets the same term"),
        ("first_order", {"effects": [{"name": "valve_lagg"}]}, "did you mean 'valve_lag'"),
        ("first_order", {"output_scale": 0.0}, "greater than 0"),
        ("first_order", {"constants": None}, "constants"),
        ("static_map", {"constants": None}, "constants"),
        ("first_order", {"input": "pressure_kpa"}, NO_OTHER),
        ("first_order", {"offset": 1.0}, "Extra inputs are not permitted"),
        ("pam_joint", {"pressures": ["p1_kpa"]}, "at least 2 items"),
        ("pam_joint", {"pressures": ["p1_kpa", "angle_rad"]}, f"{NO_OTHER}angle_rad"),
        ("pam_joint", {"effects": [{"name": "coulomb_friction", "form": "cable"}]}, "does not act at a motion"),
        ("pam_joint", {"effects": [{"name": "coulomb_friction", "share": 3.0, "sliding": 0.1}]}, "0.0 to 2.0, got 3"),
        ("servo_drive", {"output": "force_n"}, NO_OTHER),
        ("servo_drive", {"effects": [{"name": "overflow"}]}, "effect overflow does not act at a motion"),
        ("servo_drive", {"effects": [{"name": "viscous_friction", "share": 0.1}] * 2}, "sets the same term"),
        ("servo_drive", {"between_samples": "hold"}, "'band_limited', 'linear', 'held' or 'averaged'"),
        ("static_map", {"output": "position_m"}, NO_OTHER),
        ("static_map", {"kind": "static_mpa"}, "did you mean 'static_map'"),
        ("static_map", {"effects": [{"name": "leakage", "per_s": 1.0}]}, "does not act at an element"),
        (
            "static_map",
            {"effects": [{"name": "creep", "share": 0.1, "paces": 1.0, "begun": 0.0}] * 2},
            "each name once",
        ),
        ("static_map", {"constants": {"k": LONE | {"high": None}}}, "null for all"),
        ("static_map", {"constants": {"k": LONE | {"sd": None}}}, "null for all of them"),
        ("static_map", {"constants": {"k": LONE | {"start": 3.0}}}, "expected low <= start <= high"),
        ("static_map", {"constants": {"k": LONE | {"sd": 0.0}}}, "sd > 0"),
        ("cascaded_tanks", {"effects": [RIM, RIM]}, "sets the same term"),
        ("cascaded_tanks", {"effects": [{"name": "creep", "share": 0.1}]}, "does not act at a tank"),
        ("cascaded_tanks", {"substeps": 0}, "greater than or equal to 1"),
        ("second_order", {"effects": [{"name": "cubic_stifness"}]}, "did you mean 'cubic_stiffness'"),
        ("second_order", {"effects": [SPRING | {"form": "hardening"}]}, "form hardening, does not act at a motion"),
        ("second_order", {"effects": [SPRING | {"share": 99.0}]}, "share: expected a number from -0.9 to 10.0, got 99"),
    ],
)
def test_what_cannot_be_is_refused(kind, changes, told):
    with pytest.raises((ValidationError, ValueError), match=told):
        read_plant(kind, **changes)


@pytest.mark.parametrize(
    ("kind", "name", "low", "message"),
    [
        ("first_order", "time_constant_s", 0.0, "time_constant_s: expected low above 0 s"),
        ("second_order", "natural_frequency_hz", 0.0, "natural_frequency_hz: expected low above 0 Hz"),
        ("second_order", "damping_ratio", -0.1, "damping_ratio: expected low of at least 0"),
    ],
)
def test_a_constant_that_may_be_impossible_is_refused(kind, name, low, message):
    told = read_plant(kind).model_dump()
    told["constants"][name] |= {"start": 0.1, "low": low, "high": 1.0, "sd": 0.1}
    with pytest.raises(ValidationError, match=message):
        read_machine(told)


AMENDED = {
    "static_map": ({"stiffness": 800.0, "offset": 1.0}, ("cubic_stiffness", "element", {"share": 0.2})),
    "cascaded_tanks": ({"lower_outflow": 0.04}, ("overflow", "rim", {"scale_over_rim": 1.0, "share_down": 0.4})),
    "silverbox": ({"static_gain": 1.2}, ("cubic_stiffness", "duffing", {"share": 0.2})),
}


@pytest.mark.parametrize("kind", AMENDED)
def test_an_amended_plant_simulates_as_fitted_and_reads_back(kind, generator):
    plant, step_s = (configured_oscillator(kind), 0.0016) if kind == "silverbox" else (read_plant(kind), 4.0)
    values, (name, form, given) = AMENDED[kind]
    signals = {each: 4.0 + np.cumsum(generator.standard_normal(400)) / 9.0 for each in plant.inputs}
    settled = plant.resolve_from_data([{**signals, plant.output: 900.0 * signals[plant.inputs[0]]}], step_s)
    constants = {**settled.starts, **values}
    amended = settled.amend(constants, [(name, form, given)])
    assert amended.model_dump()["effects"] in ([{"name": name, **given}], [{"name": name, "form": form, **given}])
    again = read_machine(yaml.safe_load(yaml.safe_dump(amended.model_dump())))
    assert type(again) is type(plant)
    assert again.starts == constants
    columns = plant.refine({each: column[:, None] for each, column in signals.items()}, step_s)
    rest = (step_s, np.zeros(1), constants)
    begun = begin_surely(6.3, 0.0)
    fitted, plain = (settled.simulate(columns, *rest, each, begun) for each in ([(find_effect(name, form), given)], []))
    np.testing.assert_array_equal(again.simulate(columns, *rest, (), begun), fitted)
    np.testing.assert_array_equal(amended.simulate(columns, *rest, (), begun), fitted)
    assert np.abs(fitted - plain).max() > 0.01 * np.ptp(plain)


RECORDED = {
    "first_order": (lag, {"gain": 100.0, "offset": 20.0, "time_constant_s": 0.35, "input_delay_s": 0.0}),
    "pam_joint": (
        joint,
        {"gain": 0.5, "bias": 1.0, "stiffness": 20.0, "stiffening": 0.1, "damping": 4.0, "input_delay_s": 0.0},
    ),
    "servo_drive": (drive, {"mass": 50.0}),
}
GUESSES = [
    # kind, seed, how it is recorded, shares by which guesses may err
    ("first_order", 5, {"noise": 0.3}, {"gain": 0.01, "offset": 0.1, "time_constant_s": 0.02}),
    ("first_order", 5, {"noise": 3.0}, {"gain": 0.01, "offset": 0.1, "time_constant_s": 0.02}),
    ("servo_drive", 5, {"noise": 2e-4}, {"mass": 0.005}),
    ("servo_drive", 5, {"noise": 2e-4, "coulomb": 15.0, "viscous": 150.0}, {"mass": 0.1}),
    *(("pam_joint", seed, {}, dict.fromkeys(RECORDED["pam_joint"][1], 0.25)) for seed in (1, 4, 5)),
]


@pytest.mark.parametrize(("kind", "seed", "how", "shares"), GUESSES)
def test_constants_are_guessed_from_a_noisy_record_and_friction_does_not_mislead(kind, seed, how, shares):
    record, truth = RECORDED[kind]
    signals, step_s = record(seed, **how)
    plant = read_plant(kind, output_scale=None, time_scale_s=None).resolve_from_data([signals], step_s)
    for name, share in shares.items():
        assert plant.starts[name] == pytest.approx(truth[name], rel=share, abs=1e-9)
    assert plant.constants.input_delay_s.high == pytest.approx(step_s)
    assert plant.output_scale == pytest.approx(0.5 * np.ptp(signals[plant.output]))


@pytest.mark.parametrize(
    ("kind", "late", "near", "far"), [("first_order", 83, 0.6, 20.0), ("pam_joint", 700, 1e-3, 0.02)]
)
def test_a_record_that_begins_unsettled_is_taken_up_there(kind, late, near, far):
    record, constants = RECORDED[kind]
    signals, step_s = record(5, samples=1600)
    plant = read_plant(kind).resolve_from_data([signals], step_s)
    signals = {name: values[late:] for name, values in signals.items()}
    truth = signals[plant.output]
    begun = read_initial_state([truth[:50]], step_s)
    errors = [(simulate(plant, signals, constants, (), each, step_s) - truth)[:50] for each in (begun, None)]
    taken_up, at_rest = np.sqrt(np.mean(np.square(errors), axis=1))
    assert taken_up < near
    assert at_rest > far


@pytest.mark.parametrize(
    ("kind", "lost", "memory_of"),
    [
        ("first_order", "command_v", lambda starts: starts["time_constant_s"]),
        ("pam_joint", "pressure_2_kpa", lambda starts: 2.0 / starts["damping"]),
    ],
)
def test_after_a_gap_nothing_is_judged_until_it_is_forgotten(kind, lost, memory_of):
    signals, step_s = RECORDED[kind][0](5, samples=1600)
    signals[lost][500:520] = np.nan
    output = build_records(*tabulate(signals, step_s), read_plant(kind, output_scale=None, time_scale_s=None))
    memory = np.log(1e3) * memory_of(output.plant.starts)
    assert output.plant.memory_s == pytest.approx(memory)
    unjudged = np.flatnonzero(~output.present.T.ravel()) * output.step_s
    assert unjudged[0] == pytest.approx(500 * step_s, abs=2 * output.step_s)
    assert unjudged[-1] == pytest.approx(520 * step_s + memory, abs=3 * output.step_s)


def shake_oscillator():
    plant, source = configured_oscillator("silverbox"), np.random.default_rng(3)
    return plant, {each: 0.3 * source.standard_normal(400) for each in (*plant.inputs, plant.output)}, 0.0016


def sweep_under_pressure():
    free = {"start": None, "low": None, "high": None, "sd": None}
    told = {"stiffness": {"unit": "N/m", "of": ["along"]}, "pull": {"unit": "N/kPa", "of": ["pressure_kpa"]}}
    plant = read_plant("static_map", constants={name: each | free for name, each in told.items()})
    signals = sweep()
    return plant, signals | {"pressure_kpa": 200.0 + 90.0 * np.sin(0.05 * np.arange(len(signals["force_n"])))}, 0.01


SITES = {
    "lag": lambda: (read_plant("first_order"), *lag(5, samples=800)),
    "motion": shake_oscillator,
    "element": sweep_under_pressure,
}
FORMS = [form for site in SITES for form in list_effects_at(site, list_effects())]


@pytest.mark.parametrize("form", FORMS, ids=label)
def test_zero_magnitude_is_absence_and_each_start_is_not(form):
    plant, signals, step_s = SITES[form.site]()
    settled = plant.resolve_from_data([signals], step_s)
    first, values = form.parameters[0], begin(form)
    constants = settled.starts | ({"stiffness": 900.0, "pull": 0.1} if form.site == "element" else {})

    def answer(*effects):
        told = {name: signals[name] for name in plant.inputs}
        return simulate(settled, told, constants, effects, None, step_s)

    plain = answer()
    absent = answer((form.name, form.form, {**values, first.name: 0.0}))
    np.testing.assert_allclose(absent, plain, rtol=0.0, atol=1e-9 if form.site == "element" else 0.0)
    for start in first.starts:
        present = answer((form.name, form.form, {**values, first.name: start}))
        assert np.isfinite(present).all()
        assert np.abs(present - plain).max() > 1e-4 * np.ptp(plain)
