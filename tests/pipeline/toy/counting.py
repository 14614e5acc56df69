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


SPOILT = {
    None: lambda frame: frame,
    "missing_column": lambda frame: frame.drop(columns="draw"),
    "missing_value": lambda frame: frame.assign(draw=frame["draw"].where(frame["number"] != 2)),
    "wrong_unit": lambda frame: frame.assign(draw=1000 * frame["draw"]),
}


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
    return SPOILT[cfg.counting.spoil](frame)
