"""Pictures of a page: a drawn figure flows in, a PNG in text with its caption flows out."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST_LABEL = 22
RESOLUTION = 130


@dataclass(frozen=True)
class Picture:
    """A figure on a page.

    Parameters
    ----------
    data : str
        The PNG, in base64.
    caption : str
        What it shows, and what its marks are.
    """

    data: str
    caption: str


def new_figure(longest_label: int = 0, wider: float = 1.0, taller: float = 0.0) -> tuple[Figure, Any]:
    """Return a figure and its axes: higher where labels are long, so many times as wide, so many inches higher."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    more = 0.05 * min(longest_label, LONGEST_LABEL) if longest_label > 6 else 0.0
    figure = Figure(figsize=(5.2 * wider, 3.3 + more + taller), layout="constrained")
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
    figure.savefig(stream, format="png", dpi=RESOLUTION)
    return Picture(base64.b64encode(stream.getvalue()).decode(), caption)


def shorten(text: str, most: int) -> str:
    """Return a label that is not longer than so many characters, and no formula."""
    text = text.replace("$", r"\$")
    return text if len(text) <= most else f"{text[: most - 3]}..."
