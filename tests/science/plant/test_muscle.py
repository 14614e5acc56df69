import numpy as np
import pytest
from scipy.optimize import brentq

from stages.science.plant.muscle import MuscleConstants, braid_coefficients, compute_tension
from tests.science.plant.columns import constants


def tension(pressure, contraction, velocity, muscle):
    at = (np.full((1, 1), float(each)) for each in (pressure, contraction, velocity))
    return compute_tension(*at, muscle)[0, 0]


DATA_SHEET = [("pam1", 600.0, 6000.0), ("pam2", 800.0, 630.0), ("pam3", 600.0, 6000.0), ("pam4", 800.0, 630.0)]


@pytest.mark.parametrize(("name", "pressure", "force"), DATA_SHEET)
def test_largest_force_and_contraction_are_the_data_sheets(name, pressure, force):
    muscle = constants(1, name)
    assert tension(pressure, 0.0, 0.0, muscle) == pytest.approx(force, rel=0.01)
    loaded = brentq(lambda c: tension(pressure, c, 0.0, muscle) - 1e-3 * force, 0.0, 0.3)
    assert loaded == pytest.approx(0.25, abs=0.01)


def test_without_rubber_and_taper_the_law_is_virtual_work_on_the_braid():
    angle, radius, length = np.deg2rad(24.0), 0.005, 0.3
    thread = length / np.cos(angle)
    turns = thread * np.sin(angle) / (2 * np.pi * radius)

    def volume(of_length):
        braid_radius = np.sqrt(thread**2 - of_length**2) / (2 * np.pi * turns)
        return np.pi * braid_radius**2 * of_length

    law = {"area_n_per_kpa": 1000 * np.pi * radius**2, "contraction_factor": 1.0, "area_factor": 1.0}
    law["braid_a"], law["braid_b"] = braid_coefficients(24.0)
    braid = MuscleConstants(*(np.full(1, law.get(name, 0.0)) for name in MuscleConstants._fields))
    for contraction in (0.0, 0.1, 0.2):
        at, step = length * (1 - contraction), 1e-6
        work = -300e3 * (volume(at + step) - volume(at - step)) / (2 * step)
        assert tension(300.0, contraction, 0.0, braid) == pytest.approx(work, rel=1e-6)


@pytest.mark.parametrize("name", ["pam1", "pam2"])
def test_force_is_linear_in_pressure_quadratic_in_contraction_damped_and_slack(name):
    muscle = constants(1, name)
    at_pressure = [tension(p, 0.1, 0.0, muscle) for p in (200, 300, 400, 500)]
    assert np.diff(at_pressure, 2) == pytest.approx(0.0, abs=1e-9)
    at_contraction = [tension(400, c, 0.0, muscle) for c in (0.02, 0.06, 0.10, 0.14, 0.18)]
    assert np.diff(at_contraction, 3) == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(at_contraction) < 0).all()
    lost = tension(400, 0.1, 0.0, muscle) - tension(400, 0.1, 0.2, muscle)
    assert lost == pytest.approx(0.2 * muscle.damping_n_s[0])
    assert tension(10.0, 0.24, 0.0, muscle) == 0.0
