import numpy as np
import pytest

from stages.science.rig.limits import PressureLimit, apply_limits, check_limits
from tests.science.plant.machines import configured

LIMITS = {
    "MAS-40": PressureLimit(low_kpa=10.0, high_kpa=250.0, slew_kpa_per_s=1000.0),
    "MAS-10": PressureLimit(low_kpa=0.0, high_kpa=700.0, slew_kpa_per_s=4000.0),
}
EXOSKELETON = configured().exoskeleton
MUSCLES = EXOSKELETON.muscles


def test_range_and_slew_are_kept_and_a_command_within_them_is_applied_as_it_is(generator):
    command = np.linspace([20.0, 50.0, 20.0, 50.0], [200.0, 600.0, 150.0, 600.0], 1000)
    applied, clipped = apply_limits(command, LIMITS, EXOSKELETON)
    assert np.array_equal(applied, command)
    assert set(clipped.ravel()) == {""}
    command = generator.uniform(-200.0, 900.0, (500, 4))
    applied, clipped = apply_limits(command, LIMITS, EXOSKELETON)
    assert ((applied == command) == (clipped == "")).all()
    assert {"pressure", "rate"} <= set(clipped.ravel())
    assert (applied >= [10.0, 0.0, 10.0, 0.0]).all()
    assert (applied <= [250.0, 700.0, 250.0, 700.0]).all()
    assert (np.abs(np.diff(applied, axis=0)) <= np.array([4.0, 16.0, 4.0, 16.0]) + 1e-9).all()


def test_a_step_becomes_the_steepest_ramp_that_arrives():
    command = np.where(np.arange(60)[:, None] < 5, 100.0, 150.0) * np.ones(4)
    applied, clipped = apply_limits(command, LIMITS, EXOSKELETON)
    ramp = np.minimum(100.0 + 4.0 * np.maximum(np.arange(60) - 4, 0), 150.0)
    assert applied[:, 0] == pytest.approx(ramp)
    assert applied[-1].tolist() == [150.0] * 4
    assert (clipped[:, 0] == np.where((applied[:, 0] < command[:, 0]), "rate", "")).all()


def test_co_contraction_holds_the_lower_side_below_its_ceiling_within_all_rates(generator):
    command = generator.uniform(0.0, 260.0, (2000, 4))
    ceilings = {"SFE": 120.0, "EFE": 60.0}
    applied, clipped = apply_limits(command, LIMITS, EXOSKELETON, ceilings)
    assert (np.minimum(applied[:, 0], applied[:, 1]) <= 120.0).all()
    assert (np.minimum(applied[:, 2], applied[:, 3]) <= 60.0).all()
    assert (np.abs(np.diff(applied, axis=0)) <= np.array([4.0, 16.0, 4.0, 16.0]) + 1e-9).all()
    assert "co_contraction" in clipped
    one_side = np.array([[200.0, 0.0, 200.0, 0.0]] * 5)
    assert np.array_equal(apply_limits(one_side, LIMITS, EXOSKELETON, ceilings)[0], one_side)


def test_limits_must_exist_and_keep_to_the_data_sheet():
    with pytest.raises(ValueError, match="limits: none for type MAS-10 of muscle pam2"):
        check_limits({"MAS-40": LIMITS["MAS-40"]}, MUSCLES)
    high = LIMITS | {"MAS-40": PressureLimit(low_kpa=0.0, high_kpa=601.0, slew_kpa_per_s=1.0)}
    with pytest.raises(ValueError, match=r"MAS-40 may be commanded 601.0 kPa, but muscle pam1 is permitted 600.0 kPa"):
        check_limits(high, MUSCLES)
    with pytest.raises(ValueError, match="expected low_kpa < high_kpa"):
        PressureLimit(low_kpa=5.0, high_kpa=5.0, slew_kpa_per_s=1.0)
