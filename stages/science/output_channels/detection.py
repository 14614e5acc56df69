"""The section of the configuration by which saturation, quantisation, spectral lines and noise are detected."""

from __future__ import annotations

from pydantic import Field

from stages.science.plant.declaration import Declared


class DetectionSettings(Declared):
    """From where on measured values show something by themselves."""

    saturation_share: float = Field(gt=0.0, lt=1.0)
    saturation_samples: int = Field(ge=2)
    saturation_ratio: float = Field(ge=1.0)
    quantised_share: float = Field(gt=0.0, lt=1.0)
    quantised_deviation: float = Field(gt=0.0, lt=0.5)
    lowest_line_hz: float = Field(gt=0.0)
    line_chance: float = Field(gt=0.0, lt=1.0)
    least_white: float = Field(ge=0.0, le=1.0)
    least_white_share: float = Field(gt=0.0, le=1.0)
