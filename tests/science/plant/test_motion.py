import numpy as np
import pytest

from stages.science.plant import motion
from stages.science.plant.effect import find_effect, list_effects
from stages.science.plant.effect_config import list_effects_at
from stages.science.plant.motion import SITE, MotionTerms, integrate, refine, turn
from stages.science.plant.record_plant import collect
from tests.science.plant.columns import begin
from tests.science.plant.machines import solve

STEP, SUBSTEPS, SCALE = 0.0016, 4, 0.3
OMEGA, DAMPING, GAIN = 2 * np.pi * 60.0, 0.05, 2.0
FORMS = list_effects_at(SITE, list_effects())


def terms_of(*placed):
    return collect(MotionTerms, SITE, placed)


def answer(signal, terms=MotionTerms(), substeps=SUBSTEPS, between="linear"):  # noqa: B008
    """A spring of 60 Hz that answers an input of 1 with 2, from rest."""
    fine = refine(np.asarray(signal, dtype=float)[:, None], substeps, between)
    drive, damping, late = GAIN / SCALE * fine.T, np.array([2 * DAMPING]), np.zeros(1)
    motion = integrate(drive, np.ones((1, 1)), np.zeros((2, 1)), damping, [terms], OMEGA * STEP, substeps, late)
    return SCALE * motion[:, 0]


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


STOP = {"scale_over_place": 2.5, "stiffness": 3.0}
RATES = {
    "duffing": ({"share": 0.8}, lambda x, w, z: -0.8 * x**3),
    "linear_damping": ({"share": 0.3}, lambda x, w, z: -0.3 * w),
    "quadratic_drag": ({"share": 0.3}, lambda x, w, z: -0.3 * w * abs(w)),
    "slider": ({"share": 0.1, "sliding": 0.2}, lambda x, w, z: -0.1 * np.tanh(w / 0.2)),
    "slider_stribeck": (
        {"share": 0.1, "sliding": 0.2, "rise": 0.8, "falling": 0.3},
        lambda x, w, z: -0.1 * np.tanh(w / 0.2) * (1.0 + 0.8 / (1.0 + (w / 0.3) ** 2)),
    ),
    "pendulum": ({"swing": 0.0225}, lambda x, w, z: x - np.sin(0.15 * x) / 0.15),
    "upper_stop": (STOP, lambda x, w, z: -3.0 * max(x - 0.4, 0.0)),
    "lower_stop": (STOP, lambda x, w, z: -3.0 * min(x + 0.4, 0.0)),
    "two_stops": (STOP, lambda x, w, z: -3.0 * (max(x - 0.4, 0.0) + min(x + 0.4, 0.0))),
    "bouc_wen_spring": ({"share": 0.5, "turning": 0.2}, lambda x, w, z: -0.5 * z),
}


@pytest.mark.parametrize("effect", [each for each in FORMS if each.form in RATES], ids=lambda each: each.form)
def test_motion_agrees_with_an_adaptive_solver(effect, generator):
    signal = 0.2 * generator.standard_normal(300)
    instants = np.arange(300) * STEP
    values, more = RATES[effect.form]

    def rates(now, state):
        x, w, z = state
        drive = 2.0 / 0.3 * np.interp(now, instants, signal)
        turned = w / 0.2 * (1.0 - (z**2 if w * z > 0.0 else 0.0))
        return OMEGA * np.array([w, drive - x - 0.1 * w + more(x, w, z), turned])

    truth = 0.3 * solve(rates, np.zeros(3), instants)[0]
    moved = answer(signal, terms_of((effect, values)), substeps=64)
    assert np.abs(moved).max() > 0.3
    assert moved == pytest.approx(truth, abs=2e-4 * np.abs(moved).max())


def test_a_delay_shifts_the_response():
    signal = np.zeros(300)
    signal[50:] = np.sin(2 * np.pi * 20.0 * np.arange(250) * STEP)
    late = terms_of((find_effect("transport_delay", "late_input"), {"periods": 3 * STEP * 60.0}))
    assert answer(signal, late)[3:] == pytest.approx(answer(signal)[:-3], abs=1e-9)


def test_a_drive_behind_a_lag_agrees_with_an_adaptive_solver(generator):
    signal = 0.2 * generator.standard_normal(300)
    instants = np.arange(300) * STEP

    def rates(now, state):
        x, w, drive = state
        return OMEGA * np.array([w, drive - x - 0.1 * w, (2.0 / 0.3 * np.interp(now, instants, signal) - drive) / 1.5])

    truth = 0.3 * solve(rates, np.zeros(3), instants)[0]
    lagging = terms_of((find_effect("actuator_lag"), {"paces": 1.5}))
    assert answer(signal, lagging, substeps=16) == pytest.approx(truth, abs=2e-4 * np.abs(truth).max())


def test_a_play_of_the_drive_ignores_small_moves_and_takes_its_width_from_large_ones():
    played = terms_of((find_effect("hysteresis", "drive_play"), {"half_width": 0.1}))
    wave = np.sin(2 * np.pi * 20.0 * np.arange(300) * STEP)
    assert (answer(0.0149 * wave, played) == 0.0).all()  # 0.1 of the drive is 0.015 of the input
    ramp = np.minimum(np.arange(300) * 0.001, 0.15)
    assert answer(ramp, played)[20:] == pytest.approx(answer(np.maximum(ramp - 0.015, 0.0))[20:], abs=1e-9)
    back, stays = (np.where(np.arange(300) < 150, ramp, each) for each in (0.3 - 0.001 * np.arange(300), 0.15))
    assert answer(back, played)[:180] == pytest.approx(
        answer(stays, played)[:180], abs=1e-9
    )  # 0.03 back, twice the width
    assert answer(back, played)[-1] < answer(stays, played)[-1] - 0.1


def test_combining_effects_compiles_nothing():
    signal = np.zeros(50)
    answer(signal)
    compiled = list(motion._integrate.signatures)
    for effect in FORMS:
        answer(signal, terms_of((effect, begin(effect))))
    assert motion._integrate.signatures == compiled


def test_a_spring_that_lets_go_gives_finite_numbers(generator):
    assert np.isfinite(answer(5.0 * generator.standard_normal(300), MotionTerms(cubic=-0.3))).all()


def test_motions_side_by_side_are_motions_one_by_one(generator):
    """Of a count that no instruction takes at once, with unlike terms, limits and delays, and springs that vary."""
    count, samples, substeps = 19, 120, 3
    drive = generator.standard_normal((count, (samples - 1) * 2 * substeps + 1))
    start, damping = generator.standard_normal((2, count)), generator.uniform(0.05, 0.5, count)
    terms = [MotionTerms(), *(terms_of((each, begin(each))) for each in (*FORMS, *FORMS))][:count]
    late = generator.uniform(-1.0, 1.0, count) * (np.arange(count) % 2)
    for hold in (np.ones((count, 1)), generator.uniform(0.5, 2.0, drive.shape)):
        together = integrate(drive, hold, start, damping, terms, 0.3, substeps, late)
        for k in range(count):
            its = (each[k : k + 1] for each in (drive, hold, start.T, damping, terms))
            drives, holds, starts, *rest = its
            single = integrate(drives, holds, starts.T, *rest, 0.3, substeps, late[k : k + 1])
            assert (single[:, 0] == together[:, k]).all()


def test_a_direction_turns_as_smoothly_as_the_textbook_s():
    speeds = np.concatenate([np.linspace(-30.0, 30.0, 6001), [1e-9, -1e-6, 1e9]])
    turned = np.array([turn(speed) for speed in speeds])
    assert turned == pytest.approx(np.tanh(speeds), abs=1e-14)
