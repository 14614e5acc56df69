"""Adds up: reads `doubles` and `halves`, writes `total`, a figure and a document."""

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

TOTAL = Table("total", "The sum of all", {"total": column(float, "of the doubles"), "count": column(int, "how many")})


class Config(Section):
    pass


@stage(TOTAL)
def adding(cfg: Config, doubles, halves, ctx) -> pd.DataFrame:
    """Add up what was doubled."""
    from matplotlib.figure import Figure

    figure = Figure()
    figure.subplots().plot(doubles["number"], doubles["double"])
    ctx.figure("doubles", figure, "Each number's double.")
    ctx.document("note", {"largest": float(doubles["double"].max())})
    return pd.DataFrame({"total": [doubles["double"].sum()], "count": [len(halves)]})
