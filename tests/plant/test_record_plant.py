"""Sections of machines of records: what they may leave to the data, what is refused, and how one is amended."""

from typing import Literal

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from stages.plant.declaration import Declared
from stages.plant.effect import find_effect
from stages.plant.element_plant import ElementPlant
from stages.plant.listed import NominalConstant, constant
from stages.plant.machine import read_machine
from stages.plant.plant import Plant
from tests.discrepancy.oscillators import configured as configured_oscillator
from tests.plant.machines import begin_surely, configured, read_plant


class Constants(Declared):
    stiffness: NominalConstant = constant("N/m", "force over way")


class Spring(ElementPlant):
    kind: Literal["spring"]
    constants: Constants

    def answer(self, signals, constants):
        return constants["stiffness"] * signals[self.along]

    def guess(self, signals):
        return {"stiffness": (float(signals[self.output] @ signals[self.along]), 0.0, 1e9, 1.0)}


SECTION = {"kind": "spring", "along": "position_m", "output": "force_n", "effects": []}


def test_all_that_may_be_left_open_is_the_data_s_own():
    way = np.array([0.0, 0.6, -0.8])
    plant = Spring.model_validate({**SECTION, "constants": None})
    assert plant.constants.stiffness.unit == "N/m"
    settled = plant.settle([{"position_m": way, "force_n": 30.0 * way}], 0.1)
    assert settled.starts == {"stiffness": pytest.approx(30.0)}
    assert settled.along_scale == pytest.approx(0.7)
    assert Spring.model_validate(settled.model_dump()) == settled


def test_where_constants_are_told_so_is_all_else():
    told = {"stiffness": {"unit": "N/m", "start": 1.0, "low": 0.0, "high": 9.0, "sd": 1.0}}
    with pytest.raises(ValidationError, match="along_middle\n  Field required"):
        Spring.model_validate({**SECTION, "constants": told})


@pytest.mark.parametrize("kind", ["first_order", "static_map"])
def test_a_machine_that_does_not_declare_its_constants_units_has_a_section_for_them(kind):
    with pytest.raises(ValidationError, match="constants"):
        read_machine({**SECTION, "kind": kind, "input": "command_v", "constants": None})


SPRING = {"name": "cubic_stiffness", "share": 0.2}
LONE = {"unit": "1", "of": [], "start": 1.0, "low": 0.0, "high": 2.0, "sd": 1.0}
NO_OTHER = "expected another signal than those it is told from, got "


@pytest.mark.parametrize(
    ("kind", "changes", "told"),
    [
        ("first_order", {"input": "pressure_kpa"}, NO_OTHER),
        ("first_order", {"effects": [{"name": "coulomb_friction"}]}, "coulomb_friction does not act at a lag"),
        ("first_order", {"effects": [{"name": "valve_lag", "paces": 0.1}] * 2}, "sets the same term"),
        ("first_order", {"effects": [{"name": "valve_lagg"}]}, "did you mean 'valve_lag'"),
        ("first_order", {"output_scale": 0.0}, "greater than 0"),
        ("first_order", {"offset": 1.0}, "Extra inputs are not permitted"),
        ("pam_joint", {"pressures": ["p1_kpa"]}, "at least 2 items"),
        ("pam_joint", {"pressures": ["p1_kpa", "angle_rad"]}, f"{NO_OTHER}angle_rad"),
        ("pam_joint", {"effects": [{"name": "coulomb_friction", "form": "cable"}]}, "does not act at a motion"),
        (
            "pam_joint",
            {"effects": [{"name": "coulomb_friction", "share": 3.0, "sliding": 0.1}]},
            "expected a number from 0.0 to 2.0, got 3.0",
        ),
        ("servo_drive", {"output": "force_n"}, NO_OTHER),
        ("servo_drive", {"effects": [{"name": "overflow"}]}, "effect overflow does not act at a motion"),
        ("servo_drive", {"effects": [{"name": "viscous_friction", "share": 0.1}] * 2}, "sets the same term"),
        ("servo_drive", {"between_samples": "hold"}, "'band_limited', 'linear', 'held' or 'averaged'"),
        ("static_map", {"output": "position_m"}, NO_OTHER),
        ("static_map", {"kind": "static_mpa"}, "did you mean 'static_map'"),
        ("static_map", {"effects": [{"name": "leakage", "per_s": 1.0}]}, "does not act at an element"),
        ("static_map", {"effects": [{"name": "creep", "share": 0.1, "paces": 1.0}] * 2}, "each name once"),
        ("static_map", {"constants": {"k": LONE | {"high": None}}}, "null for all"),
        ("static_map", {"constants": {"k": LONE | {"start": 3.0}}}, "low <= start"),
        ("cascaded_tanks", {"effects": [{"name": "creep", "share": 0.1}]}, "does not act at a tank"),
        (
            "cascaded_tanks",
            {"effects": [{"name": "overflow", "scale_over_rim": 1.0, "share_down": 0.1}] * 2},
            "sets the same term",
        ),
        ("cascaded_tanks", {"substeps": 0}, "greater than or equal to 1"),
        ("second_order", {"effects": [SPRING | {"form": "hardening"}]}, "form hardening, does not act at a motion"),
        ("second_order", {"effects": [{"name": "cubic_stifness"}]}, "did you mean 'cubic_stiffness'"),
        ("second_order", {"effects": [SPRING | {"share": 99.0}]}, "share: expected a number from -0.9 to 10.0, got 99"),
    ],
)
def test_what_cannot_be_is_refused(kind, changes, told):
    with pytest.raises((ValidationError, ValueError), match=told):
        read_plant(kind, **changes)


@pytest.mark.parametrize(
    ("kind", "name", "values", "message"),
    [
        ("first_order", "time_constant_s", {"low": 0.0}, "time_constant_s: expected low above 0 s"),
        ("silverbox", "natural_frequency_hz", {"low": 0.0}, "natural_frequency_hz: expected low above 0 Hz"),
        ("silverbox", "damping_ratio", {"low": -0.1}, "damping_ratio: expected low of at least 0"),
        ("silverbox", "static_gain", {"start": 9.0}, "expected low <= start <= high"),
        ("silverbox", "static_gain", {"sd": 0.0}, "sd > 0"),
        ("silverbox", "static_gain", {"sd": None}, "null for all of them"),
    ],
)
def test_an_impossible_constant_is_refused(kind, name, values, message):
    told = (configured_oscillator(kind) if kind == "silverbox" else read_plant(kind)).model_dump()
    told["constants"][name] |= {"start": 0.1, "high": 1.0, "sd": 0.1} | values if kind == "first_order" else values
    with pytest.raises(ValidationError, match=message):
        read_machine(told)


def test_a_plant_of_muscles_takes_no_effect_of_an_oscillator():
    told = configured().plant.model_dump() | {"effects": [SPRING | {"form": "duffing", "muscles": None}]}
    with pytest.raises(ValidationError, match="acts at the motion, not at a muscle or joint"):
        Plant.model_validate(told)


AMENDED = {
    "static_map": ({"stiffness": 800.0, "offset": 1.0}, ("cubic_stiffness", "element", {"share": 0.2})),
    "cascaded_tanks": ({"lower_outflow": 0.04}, ("overflow", "rim", {"scale_over_rim": 1.0, "share_down": 0.4})),
    "silverbox": ({"static_gain": 1.2}, ("cubic_stiffness", "duffing", {"share": 0.2})),
}


@pytest.mark.parametrize("kind", AMENDED)
def test_an_amended_plant_simulates_as_fitted_and_reads_back(kind, generator):
    plant, step_s = (configured_oscillator(kind), 0.0016) if kind == "silverbox" else (read_plant(kind), 4.0)
    values, (name, form, given) = AMENDED[kind]
    signals = {each: 4.0 + np.cumsum(generator.standard_normal(400)) / 9.0 for each in plant.inputs}
    settled = plant.settle([{**signals, plant.output: 900.0 * signals[plant.inputs[0]]}], step_s)
    constants = {**settled.starts, **values}
    amended = settled.amend(constants, [(name, form, given)])
    assert amended.model_dump()["effects"] in ([{"name": name, **given}], [{"name": name, "form": form, **given}])
    again = read_machine(yaml.safe_load(yaml.safe_dump(amended.model_dump())))
    assert type(again) is type(plant)
    assert again.starts == constants
    columns = plant.refine({each: column[:, None] for each, column in signals.items()}, step_s)
    rest = (step_s, np.zeros(1), constants)
    begun = begin_surely(6.3, 0.0)
    fitted, plain = (settled.simulate(columns, *rest, each, begun) for each in ([(find_effect(name, form), given)], []))
    np.testing.assert_array_equal(again.simulate(columns, *rest, (), begun), fitted)
    np.testing.assert_array_equal(amended.simulate(columns, *rest, (), begun), fitted)
    assert np.abs(fitted - plain).max() > 0.01 * np.ptp(plain)
