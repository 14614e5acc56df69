"""The words and colours that figures of gaps share."""

from typing import Any

from stages.science.recording.signal_names import name_signal

MEASURED, BEFORE, AFTER, LEARNED, QUIET = "#2b2b2b", "#d55e00", "#0072b2", "#009e73", "#9aa5b1"
"""Colours told apart with any colour vision (Okabe and Ito 2008)."""
STYLES = {"rising": (BEFORE, "-"), "falling": (AFTER, "--"), "both": (MEASURED, "-")}
"""Of the directions of a signal."""
DIRECTIONS = {
    "contraction_velocity_per_s": {"rising": "while shortening", "falling": "while lengthening"},
    "command_rate": {"rising": "after a rise", "falling": "after a fall"},
}
"""What they mean, by the rate that tells them; of any other rate they mean what they say."""


def name_directions(rate: str) -> dict[str, str]:
    """Return what the directions that a rate tells mean."""
    return DIRECTIONS.get(rate, {"rising": "rising", "falling": "falling"})


def name_panel(axis: Any, title: str, x: str) -> None:
    """Give a panel a title and a label of its abscissa."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x, fontsize=9)
    axis.tick_params(labelsize=8)


def shorten(channel: str) -> str:
    """Return a channel's name without its unit, in words."""
    return name_signal(channel)[0]


def spell(name: str) -> str:
    """Return an effect's name in words."""
    return name.replace("_", " ")
