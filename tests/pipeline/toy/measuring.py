"""Measures: writes `readings`, from a device: one real, which says what stands in a file, or one simulated."""

from pathlib import Path
from typing import ClassVar

import pandas as pd

from pipeline.config import Section, Target
from pipeline.stage import stage
from pipeline.table import Table, column

READINGS = Table("readings", "A reading", {"reading": column(float, "what the device said", unit="m")})


class Simulated(Section):
    real: ClassVar[bool] = False

    def read(self) -> float:
        return 1.0


class Real(Section):
    real: ClassVar[bool] = True

    file: str

    def read(self) -> float:
        return float(Path(self.file).read_text())


class Config(Section):
    device: Target


@stage(READINGS)
def measuring(cfg: Config, ctx) -> pd.DataFrame:
    """Read the device once."""
    return pd.DataFrame({"reading": [ctx.device.read()]})
