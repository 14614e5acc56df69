"""Weighs files: writes `weights`, a row for each file at a path that the configuration names."""

import pandas as pd

from pipeline.config import Section
from pipeline.inputs import InputPath
from pipeline.stage import stage
from pipeline.table import Table, column

WEIGHTS = Table("weights", "A file", {"file": column(str, "its name"), "bytes": column(int, "its size", unit="B")})


class Weighing(Section):
    what: InputPath
    others: list[InputPath]


class Config(Section):
    weighing: Weighing


def preview(cfg: Config) -> list[str]:
    return [f"weighs {len(cfg.weighing.what.files)} files"]


@stage(WEIGHTS, preview=preview)
def weighing(cfg: Config, ctx) -> pd.DataFrame:
    """Weigh every file."""
    files = [file for path in (cfg.weighing.what, *cfg.weighing.others) for file in path.files]
    return pd.DataFrame({"file": [each.name for each in files], "bytes": [each.stat().st_size for each in files]})
