"""What a section of a machine of records may leave to the data."""

from typing import Literal

import numpy as np
import pytest
from pydantic import ValidationError

from stages.plant.declaration import Declared
from stages.plant.element_plant import ElementPlant
from stages.plant.listed import NominalConstant, constant
from stages.plant.machine import read_machine


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
