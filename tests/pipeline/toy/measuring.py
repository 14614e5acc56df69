"""Measures: writes `readings`, from the device of the configuration."""

import pandas as pd

from pipeline.config import Section, Target
from pipeline.stage import stage
from pipeline.table import Table, column

READINGS = Table("readings", "A reading", {"reading": column(float, "what the device said", unit="m")})


class Config(Section):
    device: Target


@stage(READINGS)
def measuring(cfg: Config, ctx) -> pd.DataFrame:
    """Read the device once."""
    return pd.DataFrame({"reading": [ctx.device.read()]})
