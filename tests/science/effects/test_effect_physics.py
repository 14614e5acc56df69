"""Forms of effects against closed forms, one physical fact each."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from stages.science.plant.actuator_path import predict_force, predict_pressure
from stages.science.plant.effect import find_effect
from stages.science.plant.filters import lag, shift
from stages.science.plant.muscle import compute_tension
from stages.science.signals.operators import follow_bouc_wen
from tests.science.plant.columns import STEP_S, begin, constants

FULL = constants(1).full_force_n[0]


def choose(form, **parameters):
    effect = find_effect(*form.split("-"))
    return effect, begin(effect, **parameters)


def force(form, pressure, contraction, velocity=None, muscle="pam1", start=0.0, site="joint_end", **parameters):
    """Force with an effect and without, of one column."""
    shape = np.broadcast(pressure, contraction, 0.0 if velocity is None else velocity).shape
    signals = (pressure, contraction, 0.0 if velocity is None else velocity)
    columns = (np.broadcast_to(np.asarray(each, float), shape)[:, None] for each in signals)
    args, ends = (*columns, constants(1, muscle)), (STEP_S, np.array([start]), site)
    return tuple(predict_force(*args, effects, *ends)[:, 0] for effects in ([choose(form, **parameters)], []))


def nominal(pressure, contraction):
    return force("none", pressure, contraction)[1]


def pressure(form, command, start=0.0, **parameters):
    """Pressure with an effect and without, of one column."""
    command = np.asarray(command, float)[:, None]
    return tuple(
        predict_pressure(command, constants(1), effects, STEP_S, np.array([start]))[:, 0]
        for effects in ([choose(form, **parameters)], [])
    )


V = np.array([-0.2, -0.1, -0.003, 0.0, 0.003, 0.1, 0.5])
X = np.array([0.05, 0.1, 0.125, 0.15])
KPA = np.array([-1.0, 0.0, 0.5, 10.0, 20.0, 34.0, 41.0, 100.0, 600.0])
BEYOND = np.array([-0.05, 0.0, 0.02, 0.04])
SWEEP, SLACKENING = np.linspace(0.0, 500.0, 400), np.linspace(0.0, 0.3, 50)
SINCE = 600.0 + np.arange(400) * STEP_S
STRIBECK = {"share": 0.02, "stribeck_per_s": 0.05, "sliding_per_s": 0.0005}
MOVED, STILL = {"pressure": 300.0, "contraction": 0.1, "velocity": V}, {"pressure": SWEEP, "contraction": 0.05}
LAWS = [
    # form, where it is asked, its parameters, the force that it should give for the plain one
    ("coulomb_friction-cable", MOVED, {"share": 0.02, "sliding_per_s": 1e-3},
     lambda f: f - 0.02 * FULL * np.tanh(V / 1e-3)),
    ("capstan_friction", MOVED, {"friction_times_wrap": 0.2, "sliding_per_s": 1e-3},
     lambda f: f * np.exp(-0.2 * np.tanh(V / 1e-3))),
    ("stribeck_friction", MOVED, {"rise": 1.5, **STRIBECK},
     lambda f: f - 0.02 * FULL * (1 + 1.5 * np.exp(-((V / 0.05) ** 2))) * np.tanh(V / 0.0005)),
    ("viscous_friction-linear", MOVED, {"share": 0.02}, lambda f: f - 0.2 * FULL * V),
    ("viscous_friction-power_law", MOVED, {"share": 0.02, "exponent": 0.5},
     lambda f: f - 0.02 * FULL * np.sign(V) * np.sqrt(np.abs(V) / 0.1)),
    ("viscous_friction-pressure_scaled", MOVED, {"share": 0.02}, lambda f: f - 0.1 * FULL * V),
    ("threshold_pressure", {"pressure": KPA, "contraction": -0.03}, {"threshold_kpa": 30.0},
     lambda f: nominal(np.maximum(KPA - 30.0, np.minimum(KPA, 0.0)), -0.03)),
    ("threshold_pressure-exponential", {"pressure": KPA, "contraction": -0.03},
     {"threshold_kpa": 20.0, "scale_kpa": 40.0},
     lambda f: nominal(KPA - 20.0 * (1 - np.exp(-np.maximum(KPA, 0.0) / 40.0)), -0.03)),
    ("pressure_dead_band", {"pressure": KPA, "contraction": -0.01}, {"band_kpa": 40.0, "softness": 0.1},
     lambda f: np.where(KPA < 40.0, nominal(np.minimum(KPA, 0.0), -0.01), f)),
    ("cable_slack-offset_length", {"pressure": 300.0, "contraction": SLACKENING}, {"slack": 0.02},
     lambda f: nominal(300.0, SLACKENING + 0.02)),
    ("cable_slack-hanging", {"pressure": 300.0, "contraction": X}, {"lost": 1.0, "onset": 0.1, "width": 0.05},
     lambda f: f * [1.0, 1.0, 0.5, 0.0]),
    ("cable_slack-opening", {"pressure": KPA, "contraction": 0.02},
     {"slack": 0.03, "load": 0.2, "width": 0.05, "tau_s": 0.0},
     lambda f: nominal(KPA, 0.02 + 0.03 / (1.0 + np.exp((f / FULL - 0.2) / 0.05)))),
    ("cubic_stiffness", {"pressure": 500.0, "contraction": X}, {"share": 0.01, "middle": 0.05},
     lambda f: f - 0.01 * FULL * ((X - 0.05) / 0.1) ** 3),
    ("end_stiffening-contracted_end", {"pressure": 400.0, "contraction": 0.1 + BEYOND},
     {"share": 0.01, "onset": 0.1, "length": 0.02}, lambda f: f - 0.01 * FULL * np.expm1(np.maximum(BEYOND, 0) / 0.02)),
    ("end_stiffening-stretched_end", {"pressure": 400.0, "contraction": 0.1 - BEYOND},
     {"share": 0.01, "onset": 0.1, "length": 0.02}, lambda f: f + 0.01 * FULL * np.expm1(np.maximum(BEYOND, 0) / 0.02)),
    ("saturation-force", STILL, {"full_force_over_level": 3.0}, lambda f: np.minimum(f, FULL / 3.0)),
    ("quantisation-force", STILL, {"count_share": 0.01}, lambda f: 0.01 * FULL * np.round(f / (0.01 * FULL))),
    ("sensor_offset-force", STILL, {"share": -0.02}, lambda f: f - 0.02 * FULL),
    ("sensor_gain-force", STILL, {"error": 0.05}, lambda f: 1.05 * f),
    ("sensor_drift-force_linear", STILL, {"share_per_min": 0.003}, lambda f: f + 0.003 * FULL * SINCE / 60.0),
    ("sensor_drift-force_warming", STILL, {"share": 0.05, "tau_s": 300.0},
     lambda f: f + 0.05 * FULL * (1 - np.exp(-SINCE / 300.0))),
]  # fmt: skip


@pytest.mark.parametrize(("form", "where", "parameters", "law"), LAWS, ids=[each[0] for each in LAWS])
def test_an_effect_without_memory_is_its_law(form, where, parameters, law):
    bent, plain = force(form, **where, start=600.0, **parameters)
    near = {"rel": 1e-3, "abs": 1e-3} if form.endswith("pressure_scaled") else {"rel": 1e-6, "abs": 1e-9 * FULL}
    assert bent == pytest.approx(law(plain), **near)
    assert np.abs(bent - plain).max() > 1e-3 * FULL


def test_a_law_is_that_of_the_muscles_own_size_and_the_joints_end_alone_sees_cable_friction():
    velocity, full = np.array([-0.1, 0.0, 0.1]), constants(1, "pam2").full_force_n[0]
    bent, plain = force("coulomb_friction-cable", 300.0, 0.1, velocity, "pam2", share=0.02, sliding_per_s=1e-3)
    assert bent - plain == pytest.approx([0.02 * full, 0.0, -0.02 * full])
    for form in ("capstan_friction", "coulomb_friction-cable", "stribeck_friction"):
        assert np.array_equal(*force(form, 300.0, 0.1, V, site="muscle_tip"))
    nested = force("stribeck_friction", 300.0, 0.1, V, rise=0.0, **STRIBECK)[0]
    coulomb = force("coulomb_friction-cable", 300.0, 0.1, V, share=0.02, sliding_per_s=0.0005)[0]
    assert np.array_equal(nested, coulomb)


FLAT, WARMING = np.full(400, 200.0), {"drift_kpa": 5.0, "tau_s": 300.0}
READINGS = [
    # form, command, its parameters, the pressure that it should show for the plain one
    ("saturation-pressure", SWEEP, {"mpa_over_level": 4.0}, lambda p: np.minimum(p, 250.0)),
    ("quantisation-pressure", SWEEP, {"count_kpa": 5.0}, lambda p: 5.0 * np.round(p / 5.0)),
    ("sensor_offset-pressure", FLAT, {"offset_kpa": 4.0}, lambda p: p + 4.0),
    ("sensor_gain-pressure", FLAT, {"error": -0.1}, lambda p: p - 20.0),
    ("sensor_drift-pressure_linear", FLAT, {"drift_kpa_per_min": 2.0}, lambda p: p + SINCE / 30.0),
    ("sensor_drift-pressure_warming", FLAT, WARMING, lambda p: p + 5.0 * (1 - np.exp(-SINCE / 300.0))),
]


@pytest.mark.parametrize(("form", "command", "parameters", "law"), READINGS, ids=[each[0] for each in READINGS])
def test_a_sensor_of_pressure_errs_by_its_law(form, command, parameters, law):
    shown, plain = pressure(form, command, start=600.0, **parameters)
    assert shown == pytest.approx(law(plain))
    assert np.abs(shown - plain).max() > 1.0


def dissipate(form, kpa, samples=2000, **parameters):
    """Return the work that an effect takes in the second of two cycles, N."""
    x = 0.1 + 0.05 * np.sin(2 * np.pi * np.arange(2 * samples + 1) / samples)
    bent, plain = force(form, kpa, x, **parameters)
    lost, x = (plain - bent)[samples:], x[samples:]
    return float(np.sum(0.5 * (lost[1:] + lost[:-1]) * np.diff(x)))


@pytest.mark.parametrize("kpa", [250.0, 350.0])
@pytest.mark.parametrize("samples", [2000, 1000])
def test_loops_dissipate_the_sum_of_their_parallelograms_at_any_speed(kpa, samples):
    share, width = 0.05, 0.02
    radii = width * np.array([0.25, 0.5, 0.75, 1.0])
    plays = share * FULL * np.sum(2 * radii * (0.1 - 2 * radii)) / radii.sum()
    slips = share * FULL * kpa / 600 * np.mean(2 * (0.1 - 2 * radii))
    for form, expected, rel in (("prandtl_ishlinskii", plays, 1e-3), ("maxwell_slip", slips, 2e-3)):
        lost = dissipate(f"hysteresis-{form}", kpa, samples, share=share, width=width)
        assert lost == pytest.approx(expected, rel=rel)


def test_bouc_wen_solves_its_equation(generator):
    way = np.cumsum(generator.normal(0.0, 0.01, 60))
    state, truth = follow_bouc_wen(way[:, None], 0.02)[:, 0], [0.0]
    for step in np.diff(way):

        def rate(_, z, step=step):
            direction = np.sign(step)
            return direction * (1.0 - 0.5 * np.abs(z) * (1.0 + np.sign(direction * z))) / 0.02

        truth.append(solve_ivp(rate, (0, abs(step)), [truth[-1]], rtol=1e-9, atol=1e-10, max_step=1e-4).y[0, -1])
    assert state == pytest.approx(np.array(truth), abs=2e-4)


@pytest.mark.parametrize(
    ("form", "of"),
    [("bouc_wen", lambda f: FULL / 2), ("force_scaled", lambda f: f), ("maxwell_slip", lambda f: FULL / 2)],
)
def test_a_long_way_turns_all_of_a_hysteresis(form, of):
    bent, plain = force(f"hysteresis-{form}", 300.0, np.linspace(0.0, 0.1, 500), share=0.05, width=0.01)
    assert (plain - bent)[400:] == pytest.approx(0.05 * np.broadcast_to(of(plain), 500)[400:], rel=1e-3)


def test_a_regulators_play_holds_half_its_loop_off():
    staircase = np.repeat([100.0, 200.0, 300.0, 200.0, 100.0, 103.0], 250)
    held = pressure("hysteresis-regulator", staircase, play_kpa=5.0)[0][249::250]
    assert held == pytest.approx([100.0, 195.0, 295.0, 205.0, 105.0, 105.0])


SINCE_STEP = np.arange(2500) * STEP_S
BEFORE_STEP = np.arange(3000) < 500
MOVES = {"pressure": 300.0, "contraction": np.where(BEFORE_STEP, 0.06, 0.08)}
FILLS = {"pressure": np.where(BEFORE_STEP, 100.0, 200.0), "contraction": 0.1}
TWICE = {"tau_s": 0.5, "ratio": 8.0}


def fade(*taus):
    return np.mean([np.exp(-SINCE_STEP / tau) for tau in taus], axis=0)


@pytest.mark.parametrize(
    ("form", "where", "values", "lost"),
    [
        ("creep", MOVES, {"tau_s": 0.8}, lambda plain: 0.2 * FULL * 0.02 * fade(0.8)),
        ("creep-pressure_scaled", MOVES, {"tau_s": 0.8}, lambda plain: 0.1 * FULL * 0.02 * fade(0.8)),
        ("creep-two_branches", MOVES, TWICE, lambda plain: 0.2 * FULL * 0.02 * fade(0.5, 4.0)),
        ("creep-force_relaxation", FILLS, {"tau_s": 0.8}, lambda plain: 0.2 * np.ptp(plain) * fade(0.8)),
        ("creep-stress_relaxation", FILLS, TWICE, lambda plain: -0.2 * np.ptp(plain) * fade(0.5, 4.0)),
    ],
)
def test_what_creeps_fades_exponentially_after_a_step(form, where, values, lost):
    bent, plain = force(form, **where, share=0.2, **values)
    assert (plain - bent)[500:] == pytest.approx(lost(plain), rel=0.01, abs=1e-3 * (form != "creep-force_relaxation"))


def test_a_muscle_behind_a_play_stands_still_after_a_reversal():
    way = 0.05 - np.abs(np.linspace(-0.05, 0.05, 401))
    bent = force("backlash", 300.0, way, play=0.01)[0]
    assert bent[20:200] == pytest.approx(nominal(300.0, way[20:200] - 0.005))
    assert bent[201:240] == pytest.approx(bent[200])
    assert bent[241:] == pytest.approx(nominal(300.0, way[241:] + 0.005))


def test_strands_rub_as_hard_as_pressure_presses_them():
    x = 0.1 + 0.02 * np.linspace(-1.0, 1.0, 200)
    low, high = (np.subtract(*force("coulomb_friction-sleeve", kpa, x, share=0.05)) for kpa in (200.0, 400.0))
    assert np.abs(low[20:]).min() > 1.0
    assert high == pytest.approx(2.0 * low)


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
    for form, shift_kpa, shift_x in (("force", late, late), ("pressure", -late, 0.0), ("contraction", 0.0, -late)):
        shown = force(f"channel_misalignment-{form}", kpa, x, late_s=late)[0]
        truth = nominal(200 + 50 * np.sin(3 * (time - shift_kpa)), 0.1 + 0.03 * np.sin(2 * (time - shift_x)))
        assert shown[20:-20] == pytest.approx(truth[20:-20], rel=1e-4)


@pytest.mark.parametrize("tau_s", [0.01, 0.06])
def test_a_filtered_force_follows_a_sine_as_a_first_order_low_pass_does(tau_s):
    time, rate = np.arange(1000) * STEP_S, 3.0
    slow, turn = 1.0 / np.hypot(1.0, rate * tau_s), np.arctan(rate * tau_s)
    x = np.full(len(time), 0.1)
    shown = force("channel_misalignment-filtered_force", 200 + 50 * np.sin(rate * time), x, tau_s=tau_s)[0]
    truth = nominal(200 + 50 * slow * np.sin(rate * time - turn), x)  # at rest force is linear in pressure
    assert shown[100:] == pytest.approx(truth[100:], rel=1e-4)


def test_a_shift_by_whole_samples_is_exact(generator):
    signal = generator.normal(size=(50, 2))
    assert np.array_equal(shift(signal, 3.0)[3:], signal[:-3])
    assert np.array_equal(shift(signal, -3.0)[:-3], signal[3:])
    assert np.array_equal(shift(signal, 3.0)[:3], np.repeat(signal[:1], 3, axis=0))
    assert shift(signal, 2.25)[10] == pytest.approx(0.75 * signal[8] + 0.25 * signal[7])


def step(low=100.0, high=200.0, samples=300):
    """A command that steps at once, and the time since the valve knows of it."""
    return np.where(np.arange(samples) < 1, low, high), np.maximum(np.arange(samples) - 1, 0) * STEP_S


def test_a_lag_is_exact_for_a_ramp_and_a_second_lag_makes_an_s():
    ramp = np.arange(200.0)[:, None] * STEP_S
    expected = ramp - 0.05 * (1 - np.exp(-ramp / 0.05))
    assert lag(ramp, 0.05, STEP_S) == pytest.approx(expected, abs=1e-12)
    (command, since), tau, second = step(), constants(1).valve_tau_s[0], 0.02
    two = 200 - 100 * (tau * np.exp(-since / tau) - second * np.exp(-since / second)) / (tau - second)
    assert pressure("valve_lag", command, lag_s=second)[0] == pytest.approx(two, abs=0.2)


@pytest.mark.parametrize("asymmetry", [-0.3, 0.5])
def test_asymmetry_is_two_time_constants(asymmetry):
    tau = constants(1).valve_tau_s[0]
    for low, high, quicker in ((100.0, 200.0, 1 + asymmetry), (200.0, 100.0, 1 / (1 + asymmetry))):
        command, since = step(low, high)
        found = pressure("valve_asymmetry", command, asymmetry=asymmetry)[0]
        assert found == pytest.approx(high + (low - high) * np.exp(-since * quicker / tau), rel=1e-9)


@pytest.mark.parametrize("delay", [0.004, 0.010])
def test_delay_moves_a_ramp(delay):
    late, plain = pressure("transport_delay", np.arange(300.0), delay_s=delay)
    assert (plain - late)[-1] == pytest.approx(delay / STEP_S, rel=1e-9)


def test_a_limited_rate_is_straight_and_then_settles():
    (command, since), tau, limit = step(0.0, 300.0, 500), constants(1).valve_tau_s[0], 1000.0
    knee = 300.0 / limit - tau
    expected = np.where(since < knee, limit * since, 300 - limit * tau * np.exp(-(since - knee) / tau))
    limited, plain = pressure("valve_rate_limit", command, slowness_s_per_mpa=1.0)
    assert limited == pytest.approx(expected, abs=1e-6)
    small = pressure("valve_rate_limit", 0.1 * command, slowness_s_per_mpa=1.0)
    assert small[0] == pytest.approx(0.1 * plain, abs=1e-9)


def test_a_linear_leak_is_another_gain_and_time_constant():
    command, row = step()[0], constants(1)
    left = 1.0 / (1.0 + 2.0 * row.valve_tau_s)
    other = row._replace(valve_tau_s=row.valve_tau_s * left, regulator_gain=left)
    expected = predict_pressure(command[:, None], other, [], STEP_S, np.zeros(1))[:, 0]
    assert pressure("leakage-linear", command, leak_per_s=2.0)[0] == pytest.approx(expected)


def test_a_hole_leaks_by_the_root_of_pressure():
    command = np.concatenate([[100.0], np.repeat([200.0, 50.0], 400)])
    tau = constants(1).valve_tau_s[0]
    leaky = pressure("leakage-orifice", command, leak_per_s=2.0)[0]

    def flow(p, u):
        return (u - p) / tau - 2.0 * np.sqrt(100.0 * p)

    settled = [brentq(flow, 0.0, u, args=(u,)) for u in (100.0, 200.0, 50.0)]
    assert leaky[[0, 400, -1]] == pytest.approx(settled, rel=1e-3)
    times = np.arange(50) * STEP_S
    truth = solve_ivp(lambda _, p: flow(p, 200.0), (0, 0.2), [leaky[1]], t_eval=times, rtol=1e-9, atol=1e-9).y[0]
    assert leaky[1:51] == pytest.approx(truth, abs=0.3)
