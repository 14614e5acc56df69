"""Judges: writes `verdicts`, which depend on the environment if that says so, as no stage's result should."""

import os

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

VERDICTS = Table("verdicts", "A verdict", {"number": column(int, "from zero"), "value": column(float, "drifting")})


class Config(Section):
    seed: int


@stage(VERDICTS)
def judging(cfg: Config, readings, ctx) -> pd.DataFrame:
    """Judge a reading three times."""
    drift = float(os.environ.get("TOY_DRIFT", "0"))
    values = [readings["reading"].iloc[0] + number for number in range(2 + int(os.environ.get("TOY_ROWS", "1")))]
    values[1] += drift
    return pd.DataFrame({"number": range(len(values)), "value": values})
