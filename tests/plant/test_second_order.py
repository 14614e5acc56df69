import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stages.plant.effect import DynamicEffect, find_effect, list_effects, list_forms
from stages.plant.second_order import (
    OscillatorConstants,
    OscillatorTerms,
    collect_terms,
    refine,
    simulate_oscillator,
)

STEP, SUBSTEPS = 0.0016, 4
LINEAR = OscillatorConstants(
    static_gain=2.0,
    natural_frequency_hz=60.0,
    damping_ratio=0.05,
    input_offset=0.0,
    output_offset=0.0,
    output_scale=0.3,
)
OMEGA = 2 * np.pi * 60.0
FORMS = [
    form
    for name in list_effects()
    for form in list_forms(name)
    if isinstance(form, DynamicEffect) and form.site == "oscillator"
]


def answer(signal, terms=OscillatorTerms(), constants=LINEAR, between="linear", start=None, substeps=SUBSTEPS):  # noqa: B008
    fine = refine(np.asarray(signal, dtype=float)[:, None], substeps, between)
    return simulate_oscillator(fine, constants, terms, STEP, substeps, start)[:, 0]


def test_free_decay_has_its_closed_form():
    instants = np.arange(400) * STEP
    moved = answer(np.zeros(400), start=np.array([[0.2], [0.0]]))
    damped = OMEGA * np.sqrt(1 - 0.05**2)
    truth = 0.2 * np.exp(-0.05 * OMEGA * instants)
    truth *= np.cos(damped * instants) + 0.05 / np.sqrt(1 - 0.05**2) * np.sin(damped * instants)
    assert moved == pytest.approx(truth, abs=1e-4)


def test_it_settles_at_the_static_gain_with_both_offsets():
    shifted = LINEAR._replace(input_offset=0.01, output_offset=-0.02)
    assert answer(np.full(800, 0.1), constants=shifted)[-1] == pytest.approx(2.0 * 0.11 - 0.02, rel=1e-6)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.5])
def test_the_steady_response_to_a_sine_has_its_closed_form(ratio):
    instants = np.arange(1500) * STEP
    moved = answer(0.01 * np.sin(ratio * OMEGA * instants), between="band_limited")[-500:]
    transfer = 2.0 / (1 - ratio**2 + 2j * 0.05 * ratio)
    truth = 0.01 * np.imag(transfer * np.exp(1j * ratio * OMEGA * instants))[-500:]
    assert moved[:450] == pytest.approx(truth[:450], abs=2e-3 * abs(transfer) * 0.01)


def test_between_samples_an_input_is_held_straight_or_smooth():
    instants = np.arange(300) * STEP
    fine_instants = np.arange(299 * 8 + 1) * STEP / 8
    signal = np.sin(2 * np.pi * 180.0 * instants)
    smooth = refine(signal, 4, "band_limited")
    middle = slice(400, 2000)
    assert smooth[middle] == pytest.approx(np.sin(2 * np.pi * 180.0 * fine_instants)[middle], abs=2e-3)
    assert refine(signal, 4, "linear") == pytest.approx(np.interp(fine_instants, instants, signal))
    assert (refine(signal, 4, "held")[:17] == np.repeat(signal[:3], 8)[:17]).all()


RATES = {
    "cubic_stiffness": ({"share": 0.8}, lambda x, w: -0.8 * x**3),
    "viscous_friction": ({"share": 0.3}, lambda x, w: -0.3 * w * abs(w)),
    "coulomb_friction": ({"share": 0.1, "sliding": 0.2}, lambda x, w: -0.1 * np.tanh(w / 0.2)),
}


@pytest.mark.parametrize("name", RATES)
def test_motion_agrees_with_an_adaptive_solver(name, generator):
    signal = 0.2 * generator.standard_normal(300)
    instants = np.arange(300) * STEP
    effect = next(form for form in FORMS if form.name == name)
    values, more = RATES[name]

    def rates(now, state):
        x, w = state
        drive = 2.0 / 0.3 * np.interp(now, instants, signal)
        return [OMEGA * w, OMEGA * (drive - x - 0.1 * w + more(x, w))]

    solved = solve_ivp(rates, (0, instants[-1]), [0, 0], t_eval=instants, rtol=1e-8, atol=1e-9, max_step=STEP / 4)
    moved = answer(signal, collect_terms([(effect, values)]), substeps=16)
    assert np.abs(moved).max() > 0.3
    assert moved == pytest.approx(0.3 * solved.y[0], abs=2e-4 * np.abs(moved).max())


def work_per_cycle(hertz, terms):
    """Work that the input does in one slow cycle, over that of stretching the spring by one scale."""
    instants = np.arange(round(3 / hertz / STEP)) * STEP
    signal = 0.3 * np.sin(2 * np.pi * hertz * instants)
    last = slice(-round(1 / hertz / STEP) - 1, None)
    return np.trapezoid(2.0 * signal[last] / 0.3, answer(signal, terms)[last] / 0.3)


def test_a_hysteretic_spring_takes_the_same_work_at_any_speed():
    terms = collect_terms([(find_effect("hysteresis", "bouc_wen_spring"), {"share": 0.5, "turning": 0.2})])
    slow, quick = (work_per_cycle(hertz, terms) - work_per_cycle(hertz, OscillatorTerms()) for hertz in (0.5, 1.0))
    assert slow > 1.0
    assert slow == pytest.approx(quick, rel=0.02)


@pytest.mark.parametrize("effect", FORMS, ids=lambda form: f"{form.name}-{form.form}")
def test_zero_magnitude_is_absence_and_each_start_is_not(effect, generator):
    signal = 0.3 * generator.standard_normal(400)
    starts = {parameter.name: parameter.starts[0] for parameter in effect.parameters}
    absent = answer(signal, collect_terms([(effect, {**starts, effect.parameters[0].name: 0.0})]))
    assert (absent == answer(signal)).all()
    for start in effect.parameters[0].starts:
        present = answer(signal, collect_terms([(effect, {**starts, effect.parameters[0].name: start})]))
        assert np.isfinite(present).all()
        assert np.abs(present - absent).max() > 1e-4
    for parameter in effect.parameters:
        assert all(parameter.low <= start <= parameter.high for start in parameter.starts)


def test_a_delay_shifts_the_response():
    signal = np.zeros(300)
    signal[50:] = np.sin(2 * np.pi * 20.0 * np.arange(250) * STEP)
    late = collect_terms([(find_effect("transport_delay", "late_input"), {"periods": 3 * STEP * 60.0})])
    assert answer(signal, late)[3:] == pytest.approx(answer(signal)[:-3], abs=1e-9)


def test_combining_effects_compiles_nothing():
    signal = np.zeros(50)
    answer(signal)
    began = time.perf_counter()
    for effect in FORMS:
        values = {parameter.name: parameter.starts[0] for parameter in effect.parameters}
        answer(signal, collect_terms([(effect, values)]))
    assert time.perf_counter() - began < 0.2


def test_an_effect_twice_or_of_another_machine_is_refused():
    effect = next(form for form in FORMS if form.name == "cubic_stiffness")
    with pytest.raises(ValueError, match="same term"):
        collect_terms([(effect, {"share": 0.1}), (effect, {"share": 0.2})])


def test_a_spring_that_lets_go_gives_finite_numbers(generator):
    assert np.isfinite(answer(5.0 * generator.standard_normal(300), OscillatorTerms(cubic=-0.3))).all()
