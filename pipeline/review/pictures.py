"""Pictures of a page: a drawn figure flows in, a PNG in text with its caption flows out."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

from pipeline.page import Picture, encode
from pipeline.printing import shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 130
CONFIDENCE = 0.95


def new_figure(width: float = 5.2, height: float = 3.3) -> tuple[Figure, Any]:
    """Return a figure of so many inches and its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#dde3ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)
    return figure, axes


def make_picture(figure: Figure, caption: str) -> Picture:
    """Return a figure as a page holds it."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=RESOLUTION, pil_kwargs={"compress_level": 3})
    return Picture(encode(stream.getvalue()), caption)


def shorten_label(text: str, most: int) -> str:
    """Return a label that is not longer than so many characters, and no formula."""
    return shorten(text.replace("$", r"\$"), most)


def half_width(spread: float, count: int) -> float:
    """Return half of the 95 % interval (t) of a mean, from the SD and number of its values; nan for fewer than two."""
    from scipy.special import stdtrit

    if count < 2:
        return float("nan")
    return float(stdtrit(count - 1, (1 + CONFIDENCE) / 2) * spread / math.sqrt(count))
