"""Pictures of a page: a drawn figure flows in, a PNG in text with its caption flows out."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pipeline.printing import shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


@dataclass(frozen=True)
class Margins:
    """Room around axes for their labels, in inches."""

    left: float = 0.85
    right: float = 0.15
    bottom: float = 0.55
    top: float = 0.15


def new_figure(width: float = 5.2, height: float = 3.3, margins: Margins | None = None) -> tuple[Figure, Any]:
    """Return a figure of so many inches and its axes, with margins that are given, or found slowly."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=None if margins else "constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    if margins:
        figure.subplots_adjust(
            left=margins.left / width,
            right=1 - margins.right / width,
            bottom=margins.bottom / height,
            top=1 - margins.top / height,
        )
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#dde3ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)
    return figure, axes


def make_picture(figure: Figure, caption: str) -> Picture:
    """Return a figure as a page holds it."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=RESOLUTION, pil_kwargs={"compress_level": 3})
    return Picture(base64.b64encode(stream.getvalue()).decode(), caption)


def shorten_label(text: str, most: int) -> str:
    """Return a label that is not longer than so many characters, and no formula."""
    return shorten(text.replace("$", r"\$"), most)
