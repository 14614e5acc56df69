"""What figures are drawn on and with: a size and a number of panels flow in, a matplotlib figure flows out."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure
else:
    Figure = Any  # matplotlib is slow to import, and many commands draw nothing

COLOURS = ("#c1272d", "#3b6fb6", "#6b7480", "#d08a1d", "#4b8f5a", "#8059a5", "#2b2b2b")
ARMS = {"random": "#6b7480", "y_y": "#3b6fb6", "integrated_variance": "#c1272d", "variance": "#d08a1d"}
"""Colours of ways to choose trajectories, the same in all figures."""
LINES = ("-", "--", "-.", ":")


def spell_arm(name: str) -> str:
    """Return what a way to choose trajectories is called in words."""
    return name.replace("y_y", "y/y").replace("_", " ")


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, grid: str = "", bare: bool = False, **how: Any
) -> tuple[Figure, Any]:
    """Return a figure of so many inches and its panels, a (rows, columns) ndarray of axes.

    They have a grid along "x", "y" or "both", and no frame above and at the right where they are bare.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **how)
    for axis in axes.flat:
        if grid:
            axis.grid(axis=grid, alpha=0.25)
        axis.spines[["top", "right"]].set_visible(not bare)
    return figure, axes
