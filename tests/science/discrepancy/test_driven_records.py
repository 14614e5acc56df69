"""Drives, lags and joints that another integrator made: what was planted is named, and nothing where nothing was."""

from dataclasses import replace

import numpy as np
import pytest

from stages.science.output_channels.whole_record_channel import WholeRecordChannel
from tests.science.discrepancy.searches import look, read_values
from tests.science.discrepancy.simulated_records import build_records, drive, joint, lag, pendulum, tabulate
from tests.science.plant.machines import read_plant

both_seeds = pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])

SIZES = {
    "viscous_friction": lambda its, plant: its["share"] / plant.time_scale_s,
    "coulomb_friction": lambda its, plant: its["share"] * plant.output_scale / plant.time_scale_s**2,
    "valve_asymmetry": lambda its, plant: its["asymmetry"],
    "valve_rate_limit": lambda its, plant: plant.output_scale / plant.time_scale_s / its["slowness"],
    "cubic_stiffness": lambda its, plant: its["share"] / plant.output_scale**2,
}
"""What the parameters of an effect say in the machine's own units."""

PLANTED = {
    "both frictions of a drive": (
        ("servo_drive", drive, {"coulomb": 15.0, "viscous": 150.0, "samples": 1600}),
        {
            "viscous_friction": pytest.approx(150.0 / 50.0, rel=0.1),
            "coulomb_friction": pytest.approx(15.0 / 50.0, rel=0.1),
        },
        {"mass": pytest.approx(50.0, rel=0.02)},
    ),
    "an uneven lag": (
        ("first_order", lag, {"asymmetry": 0.3, "samples": 1400}),
        {"valve_asymmetry": pytest.approx(0.3, abs=0.02)},
        {},
    ),
    "the largest rate of a lag": (
        ("first_order", lag, {"fastest": 2.5, "samples": 2000}),
        {"valve_rate_limit": pytest.approx(250.0, rel=0.05)},
        {},
    ),
    "dry friction of a joint": (
        ("pam_joint", joint, {"coulomb": 2.0, "samples": 2000}),
        {"coulomb_friction": pytest.approx(2.0, rel=0.1)},
        {},
    ),
    "the softening spring of a pendulum": (
        ("second_order", pendulum, {}),
        {"cubic_stiffness": pytest.approx(-1.0 / 6.0, rel=0.15)},
        {},
    ),
}
PLAIN = {
    "a drive": (("servo_drive", drive, {"samples": 1600}), {}, {"mass": pytest.approx(50.0, rel=1e-3)}),
    "a drive whose force is held": (
        ("servo_drive", drive, {"held": True, "samples": 1600}),
        {"between_samples": "held"},
        {"mass": pytest.approx(50.0, rel=1e-3)},
    ),
    "a lag": (
        ("first_order", lag, {"samples": 1400}),
        {},
        {"time_constant_s": pytest.approx(0.35, rel=0.01), "gain": pytest.approx(100.0, rel=0.002)},
    ),
    "a joint": (
        ("pam_joint", joint, {"samples": 1400}),
        {},
        {"gain": pytest.approx(0.5, rel=0.02), "damping": pytest.approx(4.0, rel=0.02)},
    ),
}


def look_into(plant, recorded, **changes):
    """Return the state of the record's output after the search, and what was named."""
    found, names = look(build_records(*tabulate(*recorded), read_plant(plant, **changes)))
    return found.outputs[0], names


@pytest.mark.parametrize(
    ("planted", "seed"),
    [
        ("an uneven lag", 1),
        pytest.param("dry friction of a joint", 1, marks=pytest.mark.slow),
        pytest.param("both frictions of a drive", 1, marks=pytest.mark.slow),
        pytest.param("the largest rate of a lag", 2, marks=pytest.mark.slow),
        pytest.param("the softening spring of a pendulum", 1, marks=pytest.mark.slow),
    ],
)
def test_what_was_planted_is_named_with_its_size(planted, seed):
    (plant, make, given), sizes, constants = PLANTED[planted]
    state, names = look_into(plant, make(seed, **given))
    assert set(names) == set(sizes)
    assert len(names) == len(sizes)
    found, effects = read_values(state)
    assert {name: SIZES[name](its, state.output.plant) for name, its in effects.items()} == sizes
    assert {name: found[name] for name in constants} == constants


@pytest.mark.parametrize("plain", PLAIN)
@both_seeds
def test_nothing_is_named_where_nothing_was_planted(plain, seed):
    (plant, make, given), changes, constants = PLAIN[plain]
    state, names = look_into(plant, make(seed, **given), **changes)
    assert names == []
    assert state.ratio(state.nominal.raw) < 1.1
    found = read_values(state)[0]
    assert {name: found[name] for name in constants} == constants


@both_seeds
def test_noise_that_pushes_a_drive_is_no_effect_where_samples_become_their_means(seed):
    """It adds up to a walk that plain means of the force would miss: with them friction was named."""
    state, names = look_into("servo_drive", drive(seed, jitter=1.0, samples=3000))
    assert state.output.averaged > 1
    assert names == []
    assert state.ratio(state.nominal.raw) < 1.1


@pytest.mark.slow
def test_a_name_beside_a_spring_that_may_soften_no_further_is_doubted(monkeypatch):
    offered = WholeRecordChannel.forms.fget

    def narrow(output):
        told = [each if each.name != "cubic_stiffness" else soften(each) for each in offered(output)]
        return tuple(told)

    def soften(form):
        return replace(form, parameters=(replace(form.parameters[0], low=-0.1),))

    monkeypatch.setattr(WholeRecordChannel, "forms", property(narrow))
    named = look(build_records(*tabulate(*pendulum(2)), read_plant("second_order")))[0].named
    assert named[0].name == "cubic_stiffness"
    assert len(named) > 1
    assert all(each.probability <= 0.5 for each in named[1:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "make", "output", "low", "high"),
    [("first_order", lag, "pressure_kpa", None, 0.9), ("pam_joint", joint, "angle_rad", 0.1, 0.85)],
)
def test_a_reading_that_ends_at_one_side_or_both_is_named_with_its_ends(plant, make, output, low, high):
    signals, step_s = make(1, samples=2000)
    ends = {"lowest": low, "highest": high}
    ends = {name: float(np.quantile(signals[output], share)) for name, share in ends.items() if share is not None}
    cut = np.clip(signals[output], ends.get("lowest"), ends.get("highest"))
    state, names = look_into(plant, ({**signals, output: cut}, step_s))
    assert names == ["saturation"]
    scale = state.output.plant.output_scale
    found = {name: scale * value for name, value in read_values(state)[1]["saturation"].items() if name != "share"}
    assert found == pytest.approx(ends, abs=2e-3 * scale)
