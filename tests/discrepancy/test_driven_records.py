"""Drives, lags and joints that another integrator made: what was planted is named, and nothing where nothing was."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from stages.discrepancy.fitted_cell import prepare
from stages.discrepancy.naming import SearchSettings
from stages.discrepancy.search import search
from stages.discrepancy.whole_record_cell import WholeRecordCell, build_whole_records
from tests.discrepancy.simulated_records import drive, joint, lag, pendulum, tabulate
from tests.discrepancy.test_whole_records import read_plant
from tests.plant.machines import CONF

SEEDS = (1, 2)


def look(plant, recorded, **changes):
    """Return what the search finds in a record, and what was named."""
    settings = SearchSettings(**yaml.safe_load((CONF / "discrepancy" / "stated.yaml").read_text())["search"])
    cell = build_whole_records(*tabulate(*recorded), read_plant(plant, **changes))
    found = search([prepare(cell)], settings, np.random.default_rng(0))
    return found.cells[0], [each.name for each in found.named]


def read_values(state):
    """Return the fitted constants, and the parameters of each effect by its name."""
    constants, effects = state.current.fit.model.name_values(state.current.fit.values)
    return constants, {form.name: values for form, values in effects}


@pytest.mark.parametrize("seed", SEEDS)
def test_both_frictions_of_a_drive_are_named_with_their_sizes(seed):
    state, names = look("servo_drive", drive(seed, coulomb=15.0, viscous=150.0, samples=1600))
    assert set(names) == {"coulomb_friction", "viscous_friction"}
    constants, effects = read_values(state)
    plant = state.current.fit.model.cell.plant
    assert constants["mass"] == pytest.approx(50.0, rel=0.02)
    assert effects["viscous_friction"]["share"] == pytest.approx(150.0 / 50.0 * plant.pace_s, rel=0.1)
    rubbing = effects["coulomb_friction"]["share"] * plant.output_scale / plant.pace_s**2
    assert rubbing == pytest.approx(15.0 / 50.0, rel=0.1)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("held", [False, True])
def test_nothing_is_named_in_a_drive_without_friction(held, seed):
    between = "held" if held else "linear"
    state, names = look("servo_drive", drive(seed, held=held, samples=1600), between_samples=between)
    assert names == []
    assert state.ratio(state.nominal.raw) < 1.1
    assert read_values(state)[0]["mass"] == pytest.approx(50.0, rel=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_uneven_lag_is_named_with_its_size(seed):
    state, names = look("first_order", lag(seed, asymmetry=0.3, samples=2000))
    assert names == ["valve_asymmetry"]
    assert read_values(state)[1]["valve_asymmetry"]["asymmetry"] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_largest_rate_of_a_lag_is_named_with_its_size(seed):
    state, names = look("first_order", lag(seed, fastest=2.5, samples=2000))
    assert names == ["valve_rate_limit"]
    plant = state.current.fit.model.cell.plant
    fastest = plant.output_scale / plant.pace_s / read_values(state)[1]["valve_rate_limit"]["slowness"]
    assert fastest == pytest.approx(250.0, rel=0.05)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_named_in_a_lag_without_an_effect(seed):
    state, names = look("first_order", lag(seed, samples=2000))
    assert names == []
    constants = read_values(state)[0]
    assert constants["time_constant_s"] == pytest.approx(0.35, rel=0.01)
    assert constants["gain"] == pytest.approx(100.0, rel=0.002)


@pytest.mark.parametrize("seed", SEEDS)
def test_dry_friction_of_a_joint_is_named(seed):
    state, names = look("pam_joint", joint(seed, coulomb=2.0, samples=2000))
    assert names == ["coulomb_friction"]
    plant = state.current.fit.model.cell.plant
    rubbing = read_values(state)[1]["coulomb_friction"]["share"] * plant.output_scale / plant.pace_s**2
    assert rubbing == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_named_in_a_joint_without_an_effect(seed):
    state, names = look("pam_joint", joint(seed, samples=2000))
    assert names == []
    constants = read_values(state)[0]
    assert constants["gain"] == pytest.approx(0.5, rel=0.02)
    assert constants["damping"] == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_that_pushes_a_drive_is_no_effect_where_samples_become_their_means(seed):
    """It adds up to a walk that plain means of the force would miss: with them friction was named."""
    recorded = drive(seed, jitter=1.0, samples=3000)
    state, names = look("servo_drive", recorded)
    assert state.cell.averaged > 1
    assert names == []
    assert state.ratio(state.nominal.raw) < 1.1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_pendulum_s_spring_softens_and_nothing_else_is_named(seed):
    state, names = look("second_order", pendulum(seed))
    assert names == ["cubic_stiffness"]
    size = state.cell.plant.output_scale
    assert read_values(state)[1]["cubic_stiffness"]["share"] == pytest.approx(-(size**2) / 6.0, rel=0.15)


def test_a_name_beside_a_spring_that_may_soften_no_further_is_doubted(monkeypatch):
    offered = WholeRecordCell.forms.fget

    def narrow(cell):
        told = [each if each.name != "cubic_stiffness" else soften(each) for each in offered(cell)]
        return tuple(told)

    def soften(form):
        return replace(form, parameters=(replace(form.parameters[0], low=-0.1),))

    monkeypatch.setattr(WholeRecordCell, "forms", property(narrow))
    settings = SearchSettings(**yaml.safe_load((CONF / "discrepancy" / "stated.yaml").read_text())["search"])
    cell = build_whole_records(*tabulate(*pendulum(2)), read_plant("second_order"))
    named = search([prepare(cell)], settings, np.random.default_rng(0)).named
    assert named[0].name == "cubic_stiffness"
    assert len(named) > 1
    assert all(each.probability <= 0.5 for each in named[1:])


CLIPPED = {"first_order": (lag, "pressure_kpa"), "pam_joint": (joint, "angle_rad")}


@pytest.mark.parametrize(
    ("plant", "low", "high"),
    [("first_order", None, 0.9), ("pam_joint", 0.15, None), ("pam_joint", 0.1, 0.85)],
)
def test_a_reading_that_ends_at_one_side_or_both_is_named_with_its_ends(plant, low, high):
    make, output = CLIPPED[plant]
    signals, step_s = make(1, samples=2000)
    ends = {"lowest": low, "highest": high}
    ends = {name: float(np.quantile(signals[output], share)) for name, share in ends.items() if share is not None}
    cut = np.clip(signals[output], ends.get("lowest"), ends.get("highest"))
    state, names = look(plant, ({**signals, output: cut}, step_s))
    assert names == ["saturation"]
    scale = state.current.fit.model.cell.plant.output_scale
    found = {name: scale * value for name, value in read_values(state)[1]["saturation"].items() if name != "share"}
    assert found == pytest.approx(ends, abs=2e-3 * scale)
