"""Units of others, against constants of physics and each other."""

import re

import pandas as pd
import pytest
from scipy import constants

from stages.science.recording.headings import read_heading
from stages.science.recording.units import KINDS, choose_unit, convert, known_units, own_unit, read_unit
from tests.conftest import ROOT


@pytest.mark.parametrize(
    ("name", "unit", "value", "expected"),
    [
        ("force_n", "lbf", 1.0, constants.lbf),
        ("force_n", "kgf", 1.0, constants.kgf),
        ("force_n", "gf", 1.0, constants.gram * constants.g),
        ("force_n", "daN", 1.0, constants.deka),
        ("pressure_kpa", "mmHg", 1.0, constants.mmHg / 1000.0),
        ("speed_m_per_s", "mm/min", 1.0, constants.milli / constants.minute),
        ("pressure_kpa", "psi", 1.0, constants.psi / 1000.0),
        ("pressure_kpa", "bar", 1.0, constants.bar / 1000.0),
        ("joint_angle_rad", "deg", 1.0, constants.degree),
        ("joint_velocity_rad_per_s", "rpm", 1.0, constants.degree * 360.0 / 60.0),
        ("contraction_velocity_per_s", "percent/s", 1.0, 0.01),
        ("time_s", "min", 1.0, constants.minute),
        ("time_s", "h", 1.0, constants.hour),
        ("time_s", "d", 1.0, constants.day),
        ("position_m", "in", 1.0, constants.inch),
        ("speed_m_per_s", "mm/s", 1.0, constants.milli),
        ("drive_v", "mV", 1.0, constants.milli),
        ("contraction", "percent", 1.0, 0.01),
        ("water_k", "degC", 20.0, constants.convert_temperature(20.0, "C", "K")),
        ("water_k", "degF", 68.0, constants.convert_temperature(68.0, "F", "K")),
        ("water_degc", "K", 300.0, constants.convert_temperature(300.0, "K", "C")),
        ("water_degc", "degF", 50.0, constants.convert_temperature(50.0, "F", "C")),
        ("water_degf", "degC", -40.0, -40.0),
    ],
)
def test_conversions_are_those_of_physics(name, unit, value, expected):
    assert convert(pd.Series([value]), name, unit)[0] == pytest.approx(expected, rel=1e-12)
    assert known_units(name)[own_unit(name)] == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_prefix_is_what_it_says(kind):
    prefixes = {
        "k": constants.kilo,
        "c": constants.centi,
        "m": constants.milli,
        "u": constants.micro,
        "n": constants.nano,
    }
    first, *others = KINDS[kind]
    for unit in [each for each in others if each[1:] == first]:
        assert KINDS[kind][unit] == pytest.approx(prefixes[unit[0]], rel=1e-12), unit


def test_the_comments_beside_the_keys_and_the_documentation_list_every_unit():
    section = (ROOT / "conf/measurement/muscles.yaml").read_text().split("units:")[1].split("measurement:")[0]
    lines = [line.partition(": null") for line in section.splitlines()[1:] if line.strip()]
    assert lines
    for name, _, told in lines:
        assert set(told.strip(" #").removesuffix(" (all gauge)").split(", ")) == set(known_units(name.strip())), name
    documented = (ROOT / "docs/measured.md").read_text()
    for kind, units in KINDS.items():
        assert ", ".join(units) in documented, kind


def test_units_are_known_however_they_are_spelled():
    spelled = {"kN": "kN KN", "degC": "°C", "um": "µm", "us": "μs", "N m": "N·m N*m", "m/s2": "m/s^2 m/s²"}
    for unit, texts in (spelled | {"percent": "%", "rpm": "1/min", None: "x furlong"}).items():
        assert [read_unit(each) for each in texts.split()] == [unit] * len(texts.split())
    assert read_unit("") is None


# fmt: off
HEADINGS = [
    ("Force (kN)", "Force", "kN"), ("Force [kN]", "Force", "kN"), ("Force / kN", "Force", "kN"),
    ("Force in kN", "Force", "kN"), ("force_N", "force", "N"), ("p1_kPa", "p1", "kPa"), ("v_m_s", "v", "m/s"),
    ("w_rad_s", "w", "rad/s"), ("a_m_s2", "a", "m/s2"), ("v_m_per_s", "v", "m/s"), ("Q_l/min", "Q", "l/min"),
    ("Q_l_min", "Q", "l/min"), ("Q l/min", "Q", "l/min"), ("flow in l/min", "flow", "l/min"),
    ("Durchfluss m3/h", "Durchfluss", "m3/h"), ("Q_m³/h", "Q", "m3/h"), ("Q [ml/min]", "Q", "ml/min"),
    ("v/m/s", "v", "m/s"), ("v_m/s", "v", "m/s"), ("a_m/s^2", "a", "m/s2"), ("omega_deg/s", "omega", "deg/s"),
    ("omega °/s", "omega", "deg/s"), ("n / 1/min", "n", "rpm"), ("n_1/min", "n", "rpm"),
    ("Temp °C", "Temp", "degC"), ("T°C", "T", "degC"), ("Level %", "Level", "percent"),
    ("Level_%", "Level", "percent"), ("Winkel °", "Winkel", "deg"), ("M_N m", "M", "N m"), ("M/Nm", "M", "N m"),
    ("t/s", "t", "s"), ("Zeit/ms", "Zeit", "ms"), ("t_min", "t", "min"), ("t_sec", "t", "s"),
    ("x_1/mm", "x_1", "mm"),
]
# fmt: on


@pytest.mark.parametrize(("heading", "name", "unit"), HEADINGS)
def test_headings_state_their_units(heading, name, unit):
    assert read_heading(heading)[:2] == (name, unit)


def test_other_headings_are_names():
    compound = "k_N/mm, k N/mm, k [N/mm], c_kN/m, c_kN_m, k_n_mm, k_Nm/rad, K/(N/mm), ramp_K/min, Q_gal/min, Q_nl_min"
    symbols = "Drehzahl n, Weg s, i_a_s, p_s, Kraft in 10 N, Force [x10 N]"
    names = "u, m, valve_in, gain_k, power_J/s, m_kg/s, frames/s, Level -, p_min, note (old)"
    for heading in f"{compound}, {symbols}, {names}".split(", "):
        assert read_heading(heading)[:2] == (heading, None)


@pytest.mark.parametrize(
    ("name", "unit", "told"),
    [
        ("flow_m3_s", "l/min", "no unit 'l/min' for a name that ends in s; name the signal flow_m3_per_s, with"),
        ("v_m_s", "mm/s", "no unit 'mm/s' for a name that ends in s; name the signal v_m_per_s, with per for /"),
        ("flow_l_min", "m3/h", "no unit 'm3/h' for a name that ends in min; name the signal flow_l_per_min, with per"),
        ("delay_s", "l/min", "no unit 'l/min'; choose from: s, ns, us, ms, min"),
        ("speed", "mm/s", "for a name that ends in no unit; name the signal speed_m_per_s"),
    ],
)
def test_a_unit_that_the_name_lacks_is_told_with_a_name_that_has_it(name, unit, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        choose_unit(name, unit)
