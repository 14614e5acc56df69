"""Counts: writes `numbers`."""

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

NUMBERS = Table(
    "numbers",
    "A number",
    {"number": column(int, "the number", low=0), "draw": column(float, "random", low=0, high=1, unit="m")},
    key=("number",),
)


class Counting(Section):
    count: int
    label: str
    spoil: str | None


class Config(Section):
    counting: Counting
    seed: int


@stage(NUMBERS, stream="counting")
def counting(cfg: Config, ctx) -> pd.DataFrame:
    """Count from zero, with a draw for each number."""
    numbers = range(cfg.counting.count)
    frame = pd.DataFrame({"number": numbers, "draw": ctx.generator("draw").random(len(numbers))})
    if cfg.counting.spoil == "missing_value":
        frame.loc[2, "draw"] = float("nan")
    return frame
