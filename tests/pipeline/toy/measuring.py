"""Measures: writes `readings`, from a device: one real, which says what stands in a file, or one simulated."""

from functools import partial
from pathlib import Path
from typing import ClassVar

import pandas as pd

from pipeline.config import Section, Target
from pipeline.stage import stage
from pipeline.table import Table, column

READINGS = Table(
    "readings",
    "A reading",
    {"number": column(int, "of the reading", low=0), "reading": column(float, "what the device said", unit="m")},
    ("number",),
)


class Simulated(Section):
    real: ClassVar[bool] = False

    def read(self) -> float:
        return 1.0


class Real(Section):
    real: ClassVar[bool] = True

    file: str

    def read(self) -> float:
        with Path(self.file).with_suffix(".log").open("a") as asked:
            asked.write("asked\n")
        return float(Path(self.file).read_text())


class Measuring(Section):
    count: int
    offset: float


class Config(Section):
    device: Target
    measuring: Measuring


@stage(READINGS, extent=("measuring.count",))
def measuring(cfg: Config, ctx) -> dict[str, pd.DataFrame]:
    """Read the device as often as asked, a part each."""
    for number in range(cfg.measuring.count):
        ctx.record.part((number,), partial(read, number, cfg.measuring.offset, ctx.device))
    return ctx.record.collect()


def read(number: int, offset: float, device: Simulated | Real) -> dict[str, pd.DataFrame]:
    """Read the device once."""
    return {READINGS.name: pd.DataFrame({"number": [number], "reading": [device.read() + offset]})}
