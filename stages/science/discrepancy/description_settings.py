"""The section of the configuration by which what stays unexplained is described."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

from pydantic import Field, field_validator

from stages.science.plant.declaration import Declared

Regression = Literal["stepwise", "pysindy"]


class DescriptionSettings(Declared):
    """How what stays unexplained is described."""

    most_inputs: int = Field(ge=1, le=5)
    least_errors: float = Field(ge=0.0)
    least_help: float = Field(ge=0.0, le=1.0)
    range_part: float = Field(gt=0.0, le=1.0)
    pseudo_inputs: int = Field(ge=2, le=200)
    most_terms: int = Field(ge=1, le=10)
    least_own: float = Field(ge=0.0, le=1.0)
    regression: Regression

    @field_validator("regression")
    @classmethod
    def _is_installed(cls, chosen: Regression) -> Regression:
        if chosen == "pysindy" and find_spec("pysindy") is None:
            raise ValueError('pysindy is not installed: pip install -e ".[sketch]", or choose stepwise')
        return chosen
