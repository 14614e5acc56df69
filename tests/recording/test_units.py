"""Units of others, against constants of physics and each other."""

import pandas as pd
import pytest
from scipy import constants

from stages.recording import convert, known_units, own_unit, read_heading, read_unit
from stages.recording.units import KINDS
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
    for kind, units in KINDS.items():
        assert ", ".join(units) in text, kind


@pytest.mark.parametrize(
    ("name", "unit", "value", "expected"),
    [
        ("water_k", "degC", 20.0, constants.convert_temperature(20.0, "C", "K")),
        ("water_k", "degF", 68.0, constants.convert_temperature(68.0, "F", "K")),
        ("water_degc", "K", 300.0, constants.convert_temperature(300.0, "K", "C")),
        ("water_degc", "degF", 50.0, constants.convert_temperature(50.0, "F", "C")),
        ("water_degf", "degC", -40.0, -40.0),
    ],
)
def test_temperatures_keep_their_zeros(name, unit, value, expected):
    assert convert(pd.Series([value]), name, unit)[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("kN", "kN"),
        ("KN", "kN"),
        ("°C", "degC"),
        ("µm", "um"),
        ("μs", "us"),
        ("N·m", "N m"),
        ("N*m", "N m"),
        ("m/s^2", "m/s2"),
        ("m/s²", "m/s2"),
        ("%", "percent"),
        ("1/min", "rpm"),
        ("x", None),
        ("", None),
        ("furlong", None),
    ],
)
def test_units_are_known_however_they_are_spelled(text, unit):
    assert read_unit(text) == unit


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [
        ("Force (kN)", "Force", "kN"),
        ("Force [kN]", "Force", "kN"),
        ("Force / kN", "Force", "kN"),
        ("Force in kN", "Force", "kN"),
        ("force_N", "force", "N"),
        ("p1_kPa", "p1", "kPa"),
        ("v_m_s", "v", "m/s"),
        ("w_rad_s", "w", "rad/s"),
        ("a_m_s2", "a", "m/s2"),
        ("v_m_per_s", "v", "m/s"),
        ("valve_in", "valve_in", None),
        ("gain_k", "gain_k", None),
        ("u", "u", None),
        ("m", "m", None),
        ("note (old)", "note (old)", None),
    ],
)
def test_headings_state_their_units(heading, name, unit):
    assert read_heading(heading)[:2] == (name, unit)
