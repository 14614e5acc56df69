"""The force that a plant gives at measured pressure and motion: closed forms, time in the session, samples amiss."""

import numpy as np
import pandas as pd
import pytest

from stages.science.plant.learned_map import LearnedInput, LearnedMap
from stages.science.plant.measured_motion import simulate_force
from stages.science.plant.muscle import braid_coefficients
from tests.science.plant.machines import configured, with_effects

SAMPLES, SMOOTHING_S = 200, 0.044


def record(trials=2):
    """Rows of trials in which nothing moves: each muscle at a pressure and contraction of its own."""
    rig = configured()
    rows = [
        {"trial": trial, "muscle": name, "pressure_kpa": 100.0 + 20.0 * place, "contraction": 0.05 + 0.02 * place}
        for trial in range(trials)
        for place, name in enumerate(rig.exoskeleton.muscle_names)
        for _ in range(SAMPLES)
    ]
    frame = pd.DataFrame(rows).assign(contraction_velocity_per_s=0.0, status="ok")
    return rig, frame


def test_muscles_at_rest_pull_by_the_static_law():
    rig, rows = record()
    force = simulate_force(rig.plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S)
    for muscle in rig.exoskeleton.muscles:
        model = rig.plant.find_model(muscle.name, muscle.type)
        own = rows["muscle"] == muscle.name
        pressure, contraction = rows.loc[own, "pressure_kpa"].iloc[0], rows.loc[own, "contraction"].iloc[0]
        a, b = braid_coefficients(model.braid_angle_deg)
        area = 1000.0 * np.pi * (0.5 * muscle.nominal_diameter_m) ** 2
        expected = pressure * area * (a * (1.0 - model.contraction_factor * contraction) ** 2 - b)
        np.testing.assert_allclose(force[own], expected - model.passive_linear_n * contraction, rtol=1e-9)


def test_rows_may_come_in_any_order_of_muscles_and_trials():
    rig, rows = record()
    rows["pressure_kpa"] += np.random.default_rng(3).normal(size=len(rows)).cumsum()
    force = pd.Series(simulate_force(rig.plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S), rows.index)
    turned = rows.sort_values(["muscle", "trial"], ascending=False, kind="stable")
    found = simulate_force(rig.plant, rig.exoskeleton, turned, ["trial"], SMOOTHING_S)
    np.testing.assert_array_equal(found, force[turned.index])


def test_a_sensor_drifts_over_the_session_and_not_over_what_was_recorded_apart():
    rig, rows = record()
    drift = {"name": "sensor_drift", "form": "force_linear", "muscles": ["pam1"], "share_per_min": 0.05}
    plant = with_effects(rig.plant, drift)
    force = simulate_force(plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S, in_session=True)
    apart = simulate_force(plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S)
    muscle = rig.exoskeleton.muscles[0]
    a, b = braid_coefficients(rig.plant.find_model(muscle.name, muscle.type).braid_angle_deg)
    full_n = 1000.0 * np.pi * (0.5 * muscle.nominal_diameter_m) ** 2 * muscle.max_pressure_kpa * (a - b)
    minutes = SAMPLES / rig.exoskeleton.sampling_rate_hz / 60.0
    first, second = ((rows["trial"] == trial) & (rows["muscle"] == "pam1") for trial in (0, 1))
    np.testing.assert_allclose(force[second] - force[first], 0.05 * full_n * minutes, rtol=1e-9)
    np.testing.assert_array_equal(apart[second], apart[first])


def test_a_learned_map_is_added_to_its_own_muscle():
    rig, rows = record()
    pressure = LearnedInput(name="pressure_kpa", middle=90.0, spread=20.0, length=2.0, low=0.0, high=300.0)
    limits = {"deviation": 1.0, "lowest": -50.0, "highest": 50.0}
    told = LearnedMap(channel="force_n", element="pam1", inputs=[pressure], points=[[0.0]], weights=[30.0], **limits)
    before = simulate_force(rig.plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S)
    plant = rig.plant.model_copy(update={"learned": [told]})
    added = simulate_force(plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S) - before
    own = rows["muscle"] == "pam1"
    np.testing.assert_allclose(added[own], 30.0 * np.exp(-0.5 * (0.5 / 2.0) ** 2), rtol=1e-9)
    assert not added[~own].any()


def test_samples_amiss_are_bridged():
    rig, rows = record()
    expected = simulate_force(rig.plant, rig.exoskeleton, rows, ["trial"], SMOOTHING_S)
    amiss = rows.index.isin(range(30, 60))
    broken = rows.assign(
        pressure_kpa=rows["pressure_kpa"].mask(amiss, 1e4), status=rows["status"].mask(amiss, "frozen")
    )
    found = simulate_force(rig.plant, rig.exoskeleton, broken, ["trial"], SMOOTHING_S)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_muscle_without_rows_is_refused():
    rig, rows = record()
    with pytest.raises(ValueError, match="expected rows of every muscle in each trial, got none of pam3"):
        simulate_force(rig.plant, rig.exoskeleton, rows[rows["muscle"] != "pam3"], ["trial"], SMOOTHING_S)
