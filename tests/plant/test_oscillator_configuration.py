import numpy as np
import pytest
from pydantic import ValidationError

from stages.plant.machines.second_order import Oscillator
from stages.plant.plant import Plant
from tests.discrepancy.oscillators import configured as configured_oscillator
from tests.plant.machines import configured

SPRING = {"name": "cubic_stiffness", "share": 0.2}


@pytest.fixture
def plant():
    plant = configured_oscillator("silverbox")
    timing = plant.constants.timing_s.settle(0.0, -0.001, 0.001, 0.0005)
    return plant.model_copy(update={"constants": plant.constants.model_copy(update={"timing_s": timing})})


def changed(plant, **values):
    return Oscillator.model_validate(plant.model_dump() | values)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (SPRING | {"form": "hardening"}, "effect cubic_stiffness, form hardening, does not act at a motion"),
        ({"name": "creep"}, "effect creep does not act at a motion"),
        ({"name": "cubic_stifness"}, "did you mean 'cubic_stiffness'?"),
        (SPRING | {"share": 99.0}, "effect cubic_stiffness, share: expected a number from -0.9 to 10.0, got 99.0"),
    ],
)
def test_an_impossible_effect_is_refused(plant, effect, message):
    with pytest.raises(ValidationError, match=r"effects\.0") as refused:
        changed(plant, effects=[effect])
    assert message in str(refused.value)


def test_two_effects_on_one_term_are_refused(plant):
    with pytest.raises(ValidationError, match="another listed effect sets the same term"):
        changed(plant, effects=[SPRING, SPRING])


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("natural_frequency_hz", {"low": 0.0}, "natural_frequency_hz: expected low above 0 Hz"),
        ("damping_ratio", {"low": -0.1}, "damping_ratio: expected low of at least 0"),
        ("static_gain", {"start": 9.0}, "expected low <= start <= high"),
        ("static_gain", {"sd": 0.0}, "sd > 0"),
        ("static_gain", {"sd": None}, "null for all of them"),
    ],
)
def test_an_impossible_constant_is_refused(plant, name, values, message):
    told = plant.model_dump()
    told["constants"][name] |= values
    with pytest.raises(ValidationError, match=message):
        Oscillator.model_validate(told)


def test_a_plant_of_muscles_takes_no_effect_of_an_oscillator():
    told = configured().plant.model_dump() | {"effects": [SPRING | {"form": "duffing", "muscles": None}]}
    with pytest.raises(ValidationError, match="acts at the motion, not at a muscle or joint"):
        Plant.model_validate(told)


def test_an_amended_plant_comes_back_from_its_own_configuration(plant, generator):
    constants = {each.name: each.prior_mean for each in plant.parameters} | {"static_gain": 1.2}
    amended = plant.amend(constants, [("cubic_stiffness", "duffing", {"share": 0.2})])
    told = amended.model_dump()
    assert told["effects"] == [{"name": "cubic_stiffness", "form": "duffing", "share": 0.2}]
    signal = {"drive_v": 0.05 * generator.standard_normal((200, 1))}
    again, first, plain = (
        each.simulate(each.refine(signal, 0.0016), 0.0016, np.zeros(1), each.starts)
        for each in (Oscillator.model_validate(told), amended, plant)
    )
    assert (again == first).all()
    assert np.abs(again - plain).max() > 0.01
