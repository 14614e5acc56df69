"""Units of others, against constants of physics and each other."""

import pytest
from scipy import constants

from stages.recording import known_units, own_unit
from tests.conftest import ROOT


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("force_n", "lbf", constants.lbf),
        ("force_n", "kgf", constants.kgf),
        ("pressure_kpa", "psi", constants.psi / 1000.0),
        ("pressure_kpa", "bar", constants.bar / 1000.0),
        ("joint_angle_rad", "deg", constants.degree),
        ("joint_velocity_rad_per_s", "rpm", constants.degree * 360.0 / 60.0),
        ("contraction_velocity_per_s", "percent/s", 0.01),
        ("time_s", "min", constants.minute),
        ("position_m", "in", constants.inch),
        ("speed_m_per_s", "mm/s", constants.milli),
        ("drive_v", "mV", constants.milli),
        ("contraction", "percent", 0.01),
    ],
)
def test_factors_are_those_of_physics(name, unit, factor):
    assert known_units(name)[unit] == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("name", ["force_n", "pressure_command_kpa", "x_m", "turn_rad_per_s", "gain", "rate_per_s"])
def test_a_columns_own_unit_has_factor_one(name):
    assert known_units(name)[own_unit(name)] == 1.0


def test_the_comments_beside_the_keys_list_every_unit():
    for line in (
        (ROOT / "conf/measurement/muscles.yaml")
        .read_text()
        .split("units:")[1]
        .split("measurement:")[0]
        .splitlines()[1:]
    ):
        if line.strip():
            name, _, told = line.partition(": null")
            units = told.strip(" #").removesuffix(" (all gauge)").split(", ")
            assert set(units) == set(known_units(name.strip())), name


def test_the_documentation_lists_every_unit():
    text = (ROOT / "docs/measured.md").read_text()
    for name in (
        "force_n",
        "pressure_kpa",
        "time_s",
        "x_rad",
        "x_rad_per_s",
        "x_m",
        "x_m_per_s",
        "x",
        "x_per_s",
        "x_v",
    ):
        assert ", ".join(known_units(name)) in text, name
