"""A machine of one's own that tells the least it may, and what is said of one that tells less."""

import sys
from types import SimpleNamespace
from typing import ClassVar, Literal

import numpy as np
import pytest
from pydantic import ValidationError

from stages.science.plant.declaration import Declared
from stages.science.plant.effect_config import EffectConfig, NominalConstant, constant
from stages.science.plant.machine import read_machine
from stages.science.plant.record_plant import RecordPlant, Watched
from tests.science.discrepancy.simulated_records import build_records, tabulate

OPEN = {"output_scale": None, "time_scale_s": None, "constants": None, "effects": []}


class LeverConstants(Declared):
    ratio: NominalConstant = constant("1", "way out over way in")


class LeverEffect(EffectConfig):
    SITE = "lever"


class Lever(RecordPlant):
    SITE: ClassVar[str] = "lever"

    kind: Literal["lever"]
    pushed: str
    arms: int = 2
    constants: LeverConstants
    effects: list[LeverEffect]

    def guess(self, signals):
        return {"ratio": (1.0, 0.1, 10.0, 1.0)}

    def simulate(self, signals, step_s, start_s, constants, effects=(), begun=None):
        return constants["ratio"] * signals[self.pushed]


def read_lever(**changes):
    return Lever.model_validate({"kind": "lever", "pushed": "in_m", "output": "out_m", **OPEN, **changes})


def build(plant):
    way = 0.2 * np.sin(0.05 * np.arange(1200)) + 0.1 * np.sin(0.021 * np.arange(1200))
    return build_records(*tabulate({"in_m": way, "out_m": 1.5 * way}, 0.01), plant)


def test_scales_constants_and_what_is_watched_have_defaults():
    output = build(read_lever(arms=None))
    plant = output.plant
    assert plant.arms == 2
    assert plant.constants.ratio.unit == "1"
    assert Lever.model_validate(plant.model_dump()) == plant
    assert plant.output_scale == pytest.approx(0.5 * np.ptp(output.records[0]["out_m"]))
    assert 0.2 < plant.time_scale_s < 0.5  # the quicker wave of a radian in 0.2 s, the slower in 0.48 s
    assert plant.memory_s == plant.movement_s == pytest.approx(4.0 * np.pi * plant.time_scale_s)
    assert {each.name: each.rate for each in output.drivers()} == {"state": False, "rate of state": True, "in_m": False}
    assert output.loop == ("state", "rate of state")


def test_what_is_not_told_is_named(monkeypatch):
    told = {"ratio": {"unit": "1", "start": 1.0, "low": 0.0, "high": 9.0, "sd": 1.0}}
    with pytest.raises(ValidationError, match="output_scale\n  Field required"):
        Lever.model_validate({"kind": "lever", "pushed": "in_m", "output": "out_m", "constants": told, "effects": []})
    monkeypatch.setattr(Lever, "watch", lambda plant, signals, *_: [Watched("way", signals["in_m"], False)])
    with pytest.raises(ValueError, match=r"Lever.watch: expected a state.*and a rate.*got way \(rate=False\)"):
        build(read_lever()).drivers()
    expected = r"Lever.guess: expected \(start, low, high, sd\) of ratio, low < high and sd > 0, got "
    monkeypatch.setattr(Lever, "guess", RecordPlant.guess)
    with pytest.raises(ValueError, match=f"{expected}none"):
        build(read_lever())
    for wrong in ((1.0, 0.0, 9.0), (1.0, 9.0, 0.0, 1.0)):
        monkeypatch.setattr(Lever, "guess", lambda *_, wrong=wrong: {"ratio": wrong})
        with pytest.raises(ValueError, match=expected):
            build(read_lever())


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ({}, "lever to end in PLANT = its class"),
        ({"PLANT": RecordPlant}, "expected RecordPlant to tell simulate, SITE; docs/"),
    ],
)
def test_a_file_that_lacks_something_is_refused(monkeypatch, module, said):
    monkeypatch.setitem(sys.modules, "stages.science.plant.machines.lever", SimpleNamespace(**module))
    monkeypatch.setattr("stages.science.plant.machine.list_kinds", lambda: ("lever",))
    with pytest.raises(ValueError, match=said):
        read_machine({"kind": "lever"})
