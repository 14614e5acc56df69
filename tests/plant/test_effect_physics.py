"""Forms of effects against closed forms, one physical fact each."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from stages.plant.effect import find_effect
from stages.plant.filters import lag, shift
from stages.plant.muscle import compute_tension
from stages.plant.operators import follow_bouc_wen
from stages.plant.passage import predict_force, predict_pressure
from tests.plant.columns import STEP_S, begin, constants

FULL = constants(1).full_force_n[0]


def force(form, pressure, contraction, velocity=None, muscle="pam1", start=0.0, **parameters):
    """Force with an effect and without, of one column at the joint's end."""
    shape = np.broadcast(pressure, contraction).shape
    pressure, contraction = (
        np.broadcast_to(np.asarray(each, float), shape)[:, None] for each in (pressure, contraction)
    )
    velocity = np.zeros_like(pressure) if velocity is None else np.broadcast_to(velocity, shape)[:, None]
    effect = find_effect(*form.split("-"))
    args = (pressure, contraction, velocity, constants(1, muscle))
    chosen = [(effect, begin(effect, **parameters))]
    ends = STEP_S, np.array([start]), "joint_end"
    return tuple(predict_force(*args, effects, *ends)[:, 0] for effects in (chosen, []))


def pressure(form, command, start=0.0, **parameters):
    """Pressure with an effect and without, of one column."""
    effect = find_effect(*form.split("-"))
    chosen = [(effect, begin(effect, **parameters))]
    command = np.asarray(command, float)[:, None]
    return tuple(
        predict_pressure(command, constants(1), effects, STEP_S, np.array([start]))[:, 0] for effects in (chosen, [])
    )


def cycles(amplitude=0.05, samples=2000):
    return 0.1 + amplitude * np.sin(2 * np.pi * np.arange(2 * samples + 1) / samples)


def loop_area(y, x):
    half = len(x) // 2
    y, x = y[half:], x[half:]
    return abs(float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x))))


def test_plays_dissipate_the_sum_of_their_parallelograms_at_any_pressure():
    x, width = cycles(), 0.02
    radii = width * np.array([0.25, 0.5, 0.75, 1.0])
    area = 0.05 * FULL * np.sum(2 * radii * (0.1 - 2 * radii)) / radii.sum()
    for kpa in (250.0, 350.0):
        bent, plain = force("hysteresis-prandtl_ishlinskii", kpa, x, share=0.05, width=width)
        assert loop_area(bent - plain, x) == pytest.approx(area, rel=1e-3)


def test_bouc_wen_solves_its_equation(generator):
    way = np.cumsum(generator.normal(0.0, 0.01, 60))
    state, truth = follow_bouc_wen(way[:, None], 0.02)[:, 0], [0.0]
    for step in np.diff(way):

        def rate(_, z, step=step):
            direction = np.sign(step)
            return direction * (1.0 - 0.5 * np.abs(z) * (1.0 + np.sign(direction * z))) / 0.02

        truth.append(solve_ivp(rate, (0, abs(step)), [truth[-1]], rtol=1e-9, atol=1e-10, max_step=1e-4).y[0, -1])
    assert state == pytest.approx(np.array(truth), abs=2e-4)


def test_bouc_wen_saturates_at_its_share_of_the_pressures_force():
    bent, plain = force("hysteresis-bouc_wen", np.full(500, 300.0), np.linspace(0.0, 0.1, 500), share=0.05, width=0.01)
    assert (plain - bent)[-1] == pytest.approx(0.05 * FULL * 300 / 600, rel=1e-3)


def test_force_scaled_hysteresis_is_a_share_of_the_force():
    bent, plain = force("hysteresis-force_scaled", 300.0, np.linspace(0.0, 0.1, 500), share=0.05, width=0.01)
    assert (bent / plain)[100:] == pytest.approx(0.95, rel=1e-9)


def test_a_regulators_play_holds_half_its_loop_off():
    staircase = np.repeat([100.0, 200.0, 300.0, 200.0, 100.0, 103.0], 250)
    held = pressure("hysteresis-regulator", staircase, play_kpa=5.0)[0][249::250]
    assert held == pytest.approx([100.0, 195.0, 295.0, 205.0, 105.0, 105.0])


@pytest.mark.parametrize("muscle", ["pam1", "pam2"])
def test_cable_friction_of_constant_size(muscle):
    full = constants(1, muscle).full_force_n[0]
    velocity = np.repeat([-0.1, 0.0, 0.1], 5)
    bent, plain = force(
        "coulomb_friction-cable", 300.0, np.full(15, 0.1), velocity, muscle, share=0.02, sliding_per_s=1e-3
    )
    assert (bent - plain)[::5] == pytest.approx([0.02 * full, 0.0, -0.02 * full])


def test_stribeck_friction_falls_from_breakaway_and_nests_coulombs():
    velocity = np.array([0.003, 0.5])
    shape = {"share": 0.02, "stribeck_per_s": 0.05, "sliding_per_s": 0.0005}
    bent, plain = force("stribeck_friction", 300.0, np.full(2, 0.1), velocity, rise=1.5, **shape)
    assert (plain - bent) / (0.02 * FULL) == pytest.approx([2.5, 1.0], rel=0.01)
    nested = force("stribeck_friction", 300.0, np.full(2, 0.1), velocity, rise=0.0, **shape)[0]
    coulomb = force("coulomb_friction-cable", 300.0, np.full(2, 0.1), velocity, share=0.02, sliding_per_s=0.0005)[0]
    assert np.array_equal(nested, coulomb)


def test_the_joints_end_alone_sees_cable_friction():
    velocity = np.full((5, 1), 0.1)
    for form in ("capstan_friction", "coulomb_friction-cable", "stribeck_friction"):
        effect = find_effect(*form.split("-"))
        args = (np.full((5, 1), 300.0), np.full((5, 1), 0.1), velocity, constants(1))
        ends = STEP_S, np.zeros(1)
        at_tip = predict_force(*args, [(effect, begin(effect))], *ends, "muscle_tip")
        assert np.array_equal(at_tip, predict_force(*args, [], *ends, "muscle_tip"))


def test_viscous_frictions_powers_and_pressure():
    velocity = np.array([-0.2, -0.1, 0.1, 0.2])
    at = {"pressure": np.full(4, 300.0), "contraction": 0.1, "velocity": velocity, "share": 0.02}
    lost = {
        form: np.subtract(*force(f"viscous_friction-{form}", **at, **more)[::-1]) / (0.02 * FULL)
        for form, more in (("linear", {}), ("power_law", {"exponent": 0.5}), ("pressure_scaled", {}))
    }
    assert lost["linear"] == pytest.approx([-2, -1, 1, 2])
    assert lost["power_law"] == pytest.approx([-np.sqrt(2), -1, 1, np.sqrt(2)])
    assert lost["pressure_scaled"] == pytest.approx([-1, -0.5, 0.5, 1], rel=1e-3)


def test_linear_friction_is_the_nominal_damping():
    velocity = np.linspace(-0.2, 0.2, 9)[:, None]
    row, linear = constants(1), find_effect("viscous_friction", "linear")
    args = (np.full((9, 1), 300.0), np.full((9, 1), 0.1), velocity)
    ends = STEP_S, np.zeros(1), "muscle_tip"
    damped = row._replace(damping_n_s=row.damping_n_s + 0.02 * row.full_force_n / 0.1)
    bent = predict_force(*args, row, [(linear, {"share": 0.02})], *ends)
    assert bent == pytest.approx(predict_force(*args, damped, [], *ends))


def relax(form, **parameters):
    """What creep takes after a step of contraction at time 0."""
    contraction = np.where(np.arange(3000) < 500, 0.06, 0.08)
    bent, plain = force(form, 300.0, contraction, **parameters)
    return (plain - bent)[500:], np.arange(2500) * STEP_S


@pytest.mark.parametrize(
    ("form", "values", "fading"),
    [
        ("creep", {"tau_s": 0.8}, lambda since: np.exp(-since / 0.8)),
        ("creep-pressure_scaled", {"tau_s": 0.8}, lambda since: 0.5 * np.exp(-since / 0.8)),
        (
            "creep-two_branches",
            {"tau_s": 0.5, "ratio": 8.0},
            lambda since: 0.5 * (np.exp(-since / 0.5) + np.exp(-since / 4.0)),
        ),
    ],
)
def test_creep_relaxes_exponentially_and_as_stiff_as_pressure_makes_it(form, values, fading):
    lost, since = relax(form, share=0.2, **values)
    assert lost == pytest.approx(0.2 * FULL * 0.02 * fading(since), rel=0.01, abs=1e-3)


def test_force_relaxes_after_a_step_of_pressure():
    step = np.where(np.arange(3000) < 500, 100.0, 200.0)
    bent, plain = force("creep-force_relaxation", step, 0.1, share=0.2, tau_s=0.8)
    expected = 0.2 * (plain[-1] - plain[0]) * np.exp(-np.arange(2500) * STEP_S / 0.8)
    assert (plain - bent)[500:] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("muscle", ["pam1", "pam2"])
def test_a_stretched_cable_is_in_balance(generator, muscle):
    kpa, x = generator.uniform(0.0, 600.0, 200), generator.uniform(-0.02, 0.25, 200)
    v = generator.normal(0.0, 0.2, 200)
    row = constants(1, muscle)
    bent = force("series_elasticity", kpa, x, v, muscle, stretch=0.1)[0]

    def imbalance(tension, n):
        at = np.array([[kpa[n]]]), np.array([[x[n] + 0.1 * tension / row.full_force_n[0]]]), np.array([[v[n]]])
        return compute_tension(*at, row)[0, 0] - tension

    truth = [brentq(imbalance, -1.0, 3 * row.full_force_n[0], args=(n,), xtol=1e-10) for n in range(200)]
    assert bent == pytest.approx(np.array(truth), abs=1e-6 * row.full_force_n[0])


def test_a_stiffening_tube_takes_its_threshold_in_the_end():
    kpa = np.array([0.0, 10.0, 600.0])
    bent = force("threshold_pressure-exponential", kpa, 0.02, threshold_kpa=20.0, scale_kpa=40.0)[0]
    shifted = np.array([0.0, 10.0 - 20.0 * (1 - np.exp(-0.25)), 580.0])
    assert bent == pytest.approx(force("none", shifted, 0.02)[0], rel=1e-6)


def test_a_dead_band_gives_nothing_below_and_all_above():
    kpa = np.array([20.0, 34.0, 41.0, 100.0])
    bent, plain = force("pressure_dead_band", kpa, -0.01, band_kpa=40.0, softness=0.1)
    nothing = force("none", np.zeros(4), -0.01)[0]
    assert bent == pytest.approx([*nothing[:2], *plain[2:]])


def test_slack_is_taken_up_first():
    x = np.linspace(0.0, 0.3, 50)
    bent, plain = force("cable_slack-offset_length", 300.0, x, slack=0.02)
    assert bent == pytest.approx(force("none", 300.0, x + 0.02)[0])
    assert (bent == 0.0).sum() > (plain == 0.0).sum() > 0


def test_a_hanging_cable_passes_nothing():
    x = np.array([0.05, 0.1, 0.125, 0.15])
    bent, plain = force("cable_slack-hanging", 300.0, x, lost=1.0, onset=0.1, width=0.05)
    assert bent == pytest.approx(plain * [1.0, 1.0, 0.5, 0.0])


def test_a_hardening_spring_is_a_cubic():
    x = np.array([-0.1, -0.05, 0.0, 0.1]) + 0.05
    bent, plain = force("cubic_stiffness", 500.0, x, share=0.01, middle=0.05)
    assert (plain - bent) / (0.01 * FULL) == pytest.approx([-1.0, -0.125, 0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize(("end", "side"), [("contracted_end", 1.0), ("stretched_end", -1.0)])
def test_an_end_stiffens_exponentially(end, side):
    beyond = np.array([-0.05, 0.0, 0.02, 0.04])
    bent, plain = force(f"end_stiffening-{end}", 400.0, 0.1 + side * beyond, share=0.01, onset=0.1, length=0.02)
    assert side * (plain - bent) / (0.01 * FULL) == pytest.approx([0, 0, np.e - 1, np.e**2 - 1], abs=1e-9)


@pytest.mark.parametrize(
    ("form", "values", "arm"),
    [
        ("linear", {"variation_per_rad": 0.3}, lambda q: 1 + 0.3 * q),
        ("eccentric", {"variation": 0.3, "phase_rad": 0.5}, lambda q: 1 + 0.3 * np.sin(q + 0.5)),
    ],
)
@pytest.mark.parametrize("muscle", ["pam1", "pam2"])
def test_contraction_is_the_integral_of_the_arm(form, values, arm, muscle):
    row, angle = constants(1, muscle), np.linspace(0.0, 1.2, 2001)
    at_zero, per_rad = row.contraction_at_angle_0[0], row.contraction_per_rad[0]
    wound = np.concatenate([[0.0], np.cumsum(0.5 * (arm(angle[1:]) + arm(angle[:-1])) * np.diff(angle))])
    bent = force(f"moment_arm_variation-{form}", 400.0, at_zero + per_rad * angle, muscle=muscle, **values)[0]
    assert bent == pytest.approx(force("none", 400.0, at_zero + per_rad * wound, muscle=muscle)[0], rel=1e-5)


@pytest.mark.parametrize("late", [0.010, -0.007])
def test_misaligned_channels_are_shifted(late):
    time = np.arange(1000) * STEP_S
    kpa, x = 200 + 50 * np.sin(3 * time), 0.1 + 0.03 * np.sin(2 * time)
    inside = slice(20, -20)

    def truth(shift_kpa, shift_x):
        return force("none", 200 + 50 * np.sin(3 * (time - shift_kpa)), 0.1 + 0.03 * np.sin(2 * (time - shift_x)))[0]

    shown = force("channel_misalignment-force", kpa, x, late_s=late)[0]
    assert shown[inside] == pytest.approx(truth(late, late)[inside], rel=1e-4)
    shown = force("channel_misalignment-contraction", kpa, x, late_s=late)[0]
    assert shown[inside] == pytest.approx(truth(0.0, -late)[inside], rel=1e-4)


def test_a_shift_by_whole_samples_is_exact(generator):
    signal = generator.normal(size=(50, 2))
    assert np.array_equal(shift(signal, 3.0)[3:], signal[:-3])
    assert np.array_equal(shift(signal, -3.0)[:-3], signal[3:])
    assert np.array_equal(shift(signal, 3.0)[:3], np.repeat(signal[:1], 3, axis=0))
    assert shift(signal, 2.25)[10] == pytest.approx(0.75 * signal[8] + 0.25 * signal[7])


def test_saturation_and_counts_show_in_exact_values():
    kpa = np.linspace(0.0, 500.0, 400)
    clipped, plain = force("saturation-force", kpa, 0.05, full_force_over_level=3.0)
    assert np.array_equal(clipped, np.minimum(plain, FULL / 3.0))
    assert pressure("saturation-pressure", kpa, mpa_over_level=4.0)[0].max() == 250.0
    counted, plain = force("quantisation-force", kpa, 0.05, count_share=0.01)
    assert counted / (0.01 * FULL) == pytest.approx(np.round(counted / (0.01 * FULL)))
    assert np.abs(counted - plain).max() <= 0.005 * FULL + 1e-9
    counted, plain = pressure("quantisation-pressure", kpa, count_kpa=5.0)
    assert set(np.unique(counted) % 5.0) == {0.0}
    assert np.abs(counted - plain).max() <= 2.5


def test_sensors_err_by_offset_gain_and_drift():
    kpa, flat = np.linspace(50.0, 300.0, 500), np.full(500, 200.0)
    since = 600.0 + np.arange(500) * STEP_S
    bent, plain = force("sensor_offset-force", kpa, 0.1, share=-0.02)
    assert bent - plain == pytest.approx(-0.02 * FULL)
    bent, plain = force("sensor_gain-force", kpa, 0.1, error=0.05)
    assert bent == pytest.approx(1.05 * plain)
    bent, plain = force("sensor_drift-force_linear", kpa, 0.1, start=600.0, share_per_min=0.003)
    assert bent - plain == pytest.approx(0.003 * FULL * since / 60.0)
    bent, plain = force("sensor_drift-force_warming", kpa, 0.1, start=600.0, share=0.05, tau_s=300.0)
    assert bent - plain == pytest.approx(0.05 * FULL * (1 - np.exp(-since / 300.0)))
    for form, values, error in (
        ("sensor_offset-pressure", {"offset_kpa": 4.0}, 4.0),
        ("sensor_gain-pressure", {"error": -0.1}, -20.0),
        ("sensor_drift-pressure_linear", {"drift_kpa_per_min": 2.0}, since / 30.0),
        ("sensor_drift-pressure_warming", {"drift_kpa": 5.0, "tau_s": 300.0}, 5.0 * (1 - np.exp(-since / 300.0))),
    ):
        bent, plain = pressure(form, flat, start=600.0, **values)
        assert bent - plain == pytest.approx(error)


def test_a_lag_is_exact_for_a_ramp_and_a_second_lag_makes_an_s():
    ramp = np.arange(200.0)[:, None] * STEP_S
    expected = ramp - 0.05 * (1 - np.exp(-ramp / 0.05))
    assert lag(ramp, 0.05, STEP_S) == pytest.approx(expected, abs=1e-12)
    step = np.where(np.arange(300) < 1, 100.0, 200.0)
    tau, second = constants(1).valve_tau_s[0], 0.02
    since = np.maximum(np.arange(300) - 1, 0) * STEP_S
    two = 200 - 100 * (tau * np.exp(-since / tau) - second * np.exp(-since / second)) / (tau - second)
    assert pressure("valve_lag", step, lag_s=second)[0] == pytest.approx(two, abs=0.2)


def test_a_limited_rate_is_straight_and_then_settles():
    step = np.where(np.arange(500) < 1, 0.0, 300.0)
    tau, limit = constants(1).valve_tau_s[0], 1000.0
    limited, plain = pressure("valve_rate_limit", step, slowness_s_per_mpa=1.0)
    since = np.maximum(np.arange(500) - 1, 0) * STEP_S
    knee = 300.0 / limit - tau
    expected = np.where(since < knee, limit * since, 300 - limit * tau * np.exp(-(since - knee) / tau))
    assert limited == pytest.approx(expected, abs=1e-6)
    small = pressure("valve_rate_limit", 0.1 * step, slowness_s_per_mpa=1.0)
    assert small[0] == pytest.approx(0.1 * plain, abs=1e-9)


def test_a_linear_leak_is_another_gain_and_time_constant():
    step = np.where(np.arange(300) < 1, 100.0, 200.0)
    row, leak = constants(1), find_effect("leakage", "linear")
    left = 1.0 / (1.0 + 2.0 * row.valve_tau_s)
    leaky = predict_pressure(step[:, None], row, [(leak, {"leak_per_s": 2.0})], STEP_S, np.zeros(1))
    other = row._replace(valve_tau_s=row.valve_tau_s * left, regulator_gain=left)
    assert leaky == pytest.approx(predict_pressure(step[:, None], other, [], STEP_S, np.zeros(1)))


def test_a_hole_leaks_by_the_root_of_pressure():
    command = np.concatenate([[100.0], np.repeat([200.0, 50.0], 400)])
    tau = constants(1).valve_tau_s[0]
    leaky = pressure("leakage-orifice", command, leak_per_s=2.0)[0]

    def settled(u):
        return brentq(lambda p: (u - p) / tau - 2.0 * np.sqrt(100.0 * p), 0.0, u)

    assert leaky[[0, 400, -1]] == pytest.approx([settled(u) for u in (100.0, 200.0, 50.0)], rel=1e-3)

    def flow(_, p):
        return (200.0 - p) / tau - 2.0 * np.sqrt(100.0 * p)

    truth = solve_ivp(flow, (0, 0.2), [leaky[1]], t_eval=np.arange(50) * STEP_S, rtol=1e-9, atol=1e-9).y[0]
    assert leaky[1:51] == pytest.approx(truth, abs=0.3)
