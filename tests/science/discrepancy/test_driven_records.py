"""Drives, lags, joints, oscillators of another integrator: what was planted is named, nothing where nothing was."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.ranking import rank_first
from stages.science.output_channels.whole_record_channel import WholeRecordChannel
from tests.science.discrepancy.searches import DISCREPANCY, look, read_values
from tests.science.discrepancy.simulated_records import (
    NOISE_V,
    WANDER_V,
    belt,
    bounce,
    build_records,
    configured,
    drive,
    joint,
    lag,
    motor,
    pendulum,
    release,
    shake,
    tabulate,
)
from tests.science.plant.machines import read_plant

approx = pytest.approx
DRIVE = "servo_drive"
PLANTS = {drive: DRIVE, lag: "first_order", joint: "pam_joint", pendulum: "second_order", belt: "second_order"}
SIZES = {
    "viscous_friction": lambda its, plant: its["share"] / plant.time_scale_s,
    "coulomb_friction": lambda its, plant: its["share"] * plant.output_scale / plant.time_scale_s**2,
    "valve_asymmetry": lambda its, plant: its["asymmetry"],
    "valve_rate_limit": lambda its, plant: plant.output_scale / plant.time_scale_s / its["slowness"],
    "cubic_stiffness": lambda its, plant: -its["swing"] / 6.0 / plant.output_scale**2,
    "actuator_lag": lambda its, plant: its["paces"] * plant.time_scale_s,
    "sign_blind_sensor": lambda its, plant: its["share"],
    "transport_delay": lambda its, plant: its["periods"] * 2.0 * np.pi * plant.time_scale_s,
}
"""What the parameters of an effect say in the machine's own units."""

FRICTIONS = {"viscous_friction": approx(3.0, rel=0.1), "coulomb_friction": approx(0.3, rel=0.1)}
PLANTED = {
    "both frictions of a drive": (
        (drive, {"coulomb": 15.0, "viscous": 150.0, "samples": 1600}),
        FRICTIONS | {"mass": approx(50.0, rel=0.02)},
    ),
    "an uneven lag": ((lag, {"asymmetry": 0.3, "samples": 1400}), {"valve_asymmetry": approx(0.3, abs=0.02)}),
    "the rate limit of a lag": ((lag, {"fastest": 2.5, "samples": 2000}), {"valve_rate_limit": approx(250, rel=0.05)}),
    "dry friction of a joint": ((joint, {"coulomb": 2.0, "samples": 2000}), {"coulomb_friction": approx(2.0, rel=0.1)}),
    "the softening spring of a pendulum": ((pendulum, {}), {"cubic_stiffness": approx(-1.0 / 6.0, rel=0.02)}),
    "the late air of a joint": (
        (joint, {"late": 8, "samples": 2000}),
        {"transport_delay": approx(0.08, abs=0.002), "stiffness": approx(20.0, rel=0.05)},
    ),
    "the motor of a belt, read without a sign": (
        (belt, {}),
        {"actuator_lag": approx(0.13, rel=0.05), "sign_blind_sensor": approx(1.0, abs=0.02)},
    ),
}
MASS = {"mass": approx(50.0, rel=1e-3)}
FILLING = {"time_constant_s": approx(0.35, rel=0.01), "gain": approx(100.0, rel=0.002)}
TURNING = {"gain": approx(0.5, rel=0.02), "damping": approx(4.0, rel=0.02)}
PLAIN = {
    "a drive": ((drive, {"samples": 1600}), {}, MASS),
    "a drive whose force is held": ((drive, {"held": True, "samples": 1600}), {"between_samples": "held"}, MASS),
    "a lag": ((lag, {"samples": 1400}), {}, FILLING),
    "a joint": ((joint, {"samples": 1400}), {}, TURNING),
    "a drive that noise pushes": ((drive, {"jitter": 1.0, "samples": 3000}), {}, {}),
}
"""The noise adds up to a walk that plain means of the force would miss: with them friction was named."""


def look_into(make, recorded, **changes):
    """Return the state of the record's output after the search, and what was named."""
    found, names = look(build_records(*tabulate(*recorded), read_plant(PLANTS[make], **changes)))
    return found.outputs[0], names


@pytest.mark.parametrize(
    "planted", [pytest.param(each, marks=[] if each == "an uneven lag" else [pytest.mark.slow]) for each in PLANTED]
)
def test_what_was_planted_is_named_with_its_size(planted):
    (make, given), expected = PLANTED[planted]
    state, names = look_into(make, make(2 if "fastest" in given else 1, **given))
    assert sorted(names) == sorted({*expected} & {*SIZES})
    found, effects = read_values(state)
    found |= {name: SIZES[name](its, state.output.plant) for name, its in effects.items()}
    assert {name: found[name] for name in expected} == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "named"),
    [({"coulomb": 0.15}, {"coulomb_friction": 1.5}), ({"fan": 0.3}, {"viscous_friction": 0.03}), ({}, {})],
    ids=["dry friction", "a fan", "neither"],
)
def test_friction_of_a_motor_is_named_and_none_in_a_chamber(given, named):
    """By its size: dry friction in rad/s, a fan in 1 over rad/s."""
    plant = read_plant("first_order", input="command_v", output="speed_rad_per_s")
    found, names = look(build_records(*tabulate(*motor(1, **given)), plant))
    (state,) = found.outputs
    assert names == list(named)
    assert state.ratio(state.current.raw) < 1.15
    for name, its in read_values(state)[1].items():
        scale = state.output.plant.output_scale
        size = its["share"] * scale if name == "coulomb_friction" else its["share"] / scale
        assert size == approx(named[name], rel=0.1)
    chamber = build_records(*tabulate(*lag(1, samples=1400)), read_plant("first_order"))
    assert not {"coulomb_friction", "viscous_friction"} & {form.name for form in chamber.forms}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "named"), [({"stop": 75.0}, "end_stiffening"), ({"play": 0.6}, "hysteresis"), ({}, None)]
)
def test_a_stop_and_a_play_of_the_drive_are_named_with_their_sizes(given, named):
    plant = read_plant("second_order", input="drive_v", output="response_v")
    found, names = look(build_records(*tabulate(*bounce(1, **given)), plant))
    (state,) = found.outputs
    assert names == ([named] if named else [])
    assert state.ratio(state.current.raw) < 1.1
    constants, effects = read_values(state)
    scale, squared_pace = state.output.plant.output_scale, state.output.plant.time_scale_s**2
    if named == "end_stiffening":
        place = scale / effects[named]["scale_over_place"]
        assert place + constants["output_offset"] == approx(0.2, abs=0.02)
        assert effects[named]["stiffness"] / squared_pace == approx(75.0, rel=0.1)
    elif named:
        assert effects[named]["half_width"] * scale / squared_pace == approx(0.6, rel=0.1)


@pytest.mark.slow
def test_two_effects_are_named_where_a_third_alone_is_like_both():
    """A spring that softens and dry friction are a loop of force and motion, which softens too.

    The friction that is found yields a little before it slides, and takes a part of the softening.
    """
    plant = read_plant("second_order", input="nothing", output="angle_rad")
    found, names = look(build_records(*release(1), plant))
    (state,) = found.outputs
    effects = read_values(state)[1]
    sizes = {name: SIZES[name](its, state.output.plant) for name, its in effects.items()}
    assert names == ["coulomb_friction", "cubic_stiffness"]
    assert sizes["coulomb_friction"] == approx(0.35, rel=0.05)
    assert -6.0 < sizes["cubic_stiffness"] / state.output.plant.time_scale_s**2 < -3.0
    assert state.ratio(state.current.raw) < 1.1
    rows = rank_first(found, decide(found, DISCREPANCY, np.random.default_rng(1)), 0.99)
    assert "hysteresis" in [row["name"] for row in rows if row["round"] == 1]
    assert sum(row["probability"] for row in rows if row["round"] == 1) == approx(1.0)


@pytest.mark.parametrize("plain", PLAIN)
def test_nothing_is_named_where_nothing_was_planted(plain):
    (make, given), changes, constants = PLAIN[plain]
    state, names = look_into(make, make(1, **given), **changes)
    assert names == []
    assert state.ratio(state.nominal.raw) < 1.1
    assert state.output.averaged > 1 or "noise" not in plain
    found = read_values(state)[0]
    assert {name: found[name] for name in constants} == constants


def test_drives_that_begin_in_motion_are_simulated_to_the_noise_of_their_sensor():
    noise, tables = 3e-4, []
    for k in range(4):
        signals, step_s = drive(10 + k, noise=noise, samples=1000)
        tables.append(tabulate(signals, step_s, f"drive {k}", blocks=1))
    state = build_records(
        *(pd.concat(each, ignore_index=True) for each in zip(*tables, strict=True)), read_plant(DRIVE)
    )
    found, names = look(state)
    assert names == []
    left = found.outputs[0].nominal.raw.sum() / found.outputs[0].samples.sum()
    assert np.sqrt(left * found.outputs[0].output.averaged) == approx(noise, rel=0.1)


@pytest.mark.slow
def test_a_name_beside_a_spring_that_may_soften_no_further_is_doubted(monkeypatch):
    offered = WholeRecordChannel.forms.fget

    def soften(form):
        first = form.parameters[0]
        return replace(form, parameters=(replace(first, low=-0.05),)) if form.name == "cubic_stiffness" else form

    def list_forms(output):
        others = [each for each in offered(output) if each.form != "pendulum" and each.name != "end_stiffening"]
        return tuple(map(soften, others))

    monkeypatch.setattr(WholeRecordChannel, "forms", property(list_forms))
    named = look(build_records(*tabulate(*pendulum(1)), read_plant("second_order")))[0].named
    beside = [each.probability for each in named if each.name != "cubic_stiffness"]
    assert 0 < len(beside) < len(named)
    assert max(beside) <= 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "output", "shares"),
    [(lag, "pressure_kpa", {"highest": 0.9}), (joint, "angle_rad", {"lowest": 0.1, "highest": 0.85})],
)
def test_a_reading_that_ends_at_one_side_or_both_is_named_with_its_ends(make, output, shares):
    signals, step_s = make(1, samples=2000)
    ends = {name: float(np.quantile(signals[output], share)) for name, share in shares.items()}
    cut = np.clip(signals[output], ends.get("lowest"), ends.get("highest"))
    state, names = look_into(make, ({**signals, output: cut}, step_s))
    assert names == ["saturation"]
    scale = state.output.plant.output_scale
    found = {name: scale * value for name, value in read_values(state)[1]["saturation"].items() if name != "share"}
    assert found == pytest.approx(ends, abs=2e-3 * scale)


@pytest.mark.slow
@pytest.mark.parametrize(("rub", "told"), [(0.02, ["coulomb_friction"]), (0.0, [])], ids=["dry friction", "nothing"])
def test_dry_friction_is_named_and_nothing_in_a_linear_oscillator(rub, told, generator):
    signals, blocks = shake(generator, lambda x, w: rub * w / np.sqrt(w**2 + 0.005**2), records=8)
    found, names = look(build_records(signals, blocks, configured("silverbox")))
    assert names == told
    assert told or decide(found, DISCREPANCY, generator).status == "no_discrepancy"


@pytest.mark.slow
def test_friction_that_falls_with_velocity_is_one_effect(generator):
    """It falls as an exponential of the squared velocity, unlike the library's; without it, a drag was named too."""
    signals, blocks = shake(
        generator, lambda x, w: 0.02 * (1.0 + np.exp(-((w / 0.03) ** 2))) * w / np.hypot(w, 0.003), records=8
    )
    found, _ = look(build_records(signals, blocks, configured("silverbox")))
    assert [(each.name, *each.forms) for each in found.named] == [("coulomb_friction", "slider_stribeck")]
    (state,) = found.outputs
    its = read_values(state)[1]["coulomb_friction"]
    assert state.output.plant.output_scale * its["share"] * (1.0 + its["rise"]) == approx(0.04, rel=0.15)
    assert state.ratio(state.current.raw) < 1.1


@pytest.fixture(scope="module")
def linear():
    """Signals and blocks of three records without any effect."""
    return shake(np.random.default_rng(20260701), lambda x, w: 0.0 * x, records=3)


def test_a_gap_in_the_input_is_not_judged_until_its_motion_has_died(linear):
    signals, blocks = linear
    lost = (signals["signal"] == "drive_v") & signals["time_s"].between(0.9995, 1.0505)
    lost &= signals["record"] == "record 0"
    output = build_records(signals.assign(value=signals["value"].mask(lost)), blocks, configured("silverbox"))
    unjudged = np.flatnonzero(~output.present[:, 0]) * output.step_s + blocks["start_s"].iloc[0]
    assert unjudged[0] == pytest.approx(1.0, abs=0.003)
    assert unjudged[-1] == pytest.approx(1.05 + np.log(1e3) / (2 * np.pi * 68.0 * 0.05), abs=0.005)
    assert output.present[:, 1:].all()


def test_the_end_of_a_short_block_is_not_judged(linear):
    signals, blocks = linear
    blocks = blocks[:2].assign(start_s=[0.0, 0.6], samples=[1000, 200])
    output = build_records(signals, blocks, configured("silverbox"))
    assert output.present[:, 0].sum() == 1000
    assert (np.flatnonzero(output.present[:, 1]) == np.arange(200)).all()


def test_a_record_begins_in_the_motion_that_its_first_samples_show(linear):
    signals, blocks = linear
    late = signals[signals["time_s"] > 0.5].copy()
    late["time_s"] -= late["time_s"].min()
    output = build_records(late, blocks.assign(start_s=0.0, samples=600), configured("silverbox"))
    constants = {each.name: each.prior_mean for each in output.constants}
    simulated = output.simulate(constants, [])
    assert np.sqrt(((output.measured - simulated)[:30] ** 2).mean()) < 3.0 * np.hypot(NOISE_V, WANDER_V)
    assert (output.take([2, 0]).simulate(constants, []) == simulated[:, [2, 0]]).all()
