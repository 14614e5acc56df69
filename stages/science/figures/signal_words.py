"""What signals are called on axes, and the colours that figures of gaps share."""

from typing import Any

WORDS = {
    "force_n": "force (N)",
    "contraction": "contraction (1)",
    "pressure_kpa": "pressure (kPa)",
    "pressure_command_kpa": "command (kPa)",
    "command_rate": "rate of command (kPa/s)",
    "pressure_rate": "rate of pressure (kPa/s)",
    "contraction_velocity_per_s": "contraction velocity (1/s)",
    "motion": "motion (unit of the output)",
    "velocity": "velocity (unit of the output, per s)",
    "time_s": "time in the trial (s)",
    "start_s": "time in the session (s)",
}
SHORT = {"force_n": "force", "pressure_kpa": "pressure"}

MEASURED, BEFORE, AFTER, LEARNED, QUIET = "#2b2b2b", "#d55e00", "#0072b2", "#009e73", "#9aa5b1"
"""Colours told apart with any colour vision (Okabe and Ito 2008)."""
STYLES = {"rising": (BEFORE, "-"), "falling": (AFTER, "--"), "both": (MEASURED, "-")}
"""Of the directions of a signal."""
DIRECTIONS = {
    "force_n": {"rising": "while shortening", "falling": "while lengthening"},
    "pressure_kpa": {"rising": "after a rise", "falling": "after a fall"},
}
"""What they mean in a channel of a muscle."""


def name_directions(channel: str, variable: str) -> dict[str, str]:
    """Return what the directions in which a variable is gone through mean in a channel."""
    plain = {"rising": "rising", "falling": "falling"}
    return DIRECTIONS.get(channel, plain) if variable in WORDS else plain


def name_panel(axis: Any, title: str, x: str) -> None:
    """Give a panel a title and a label of its abscissa."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x, fontsize=9)
    axis.tick_params(labelsize=8)


def label(signal: str, channel: str = "", unit: str = "") -> str:
    """Return a signal's axis label; one made from the simulated channel is named after it."""
    if signal in ("simulated", "simulated_rate"):
        what = f"simulated {shorten(channel)}"
        return f"{what} ({unit})" if signal == "simulated" else f"rate of {what} ({unit}/s)"
    return WORDS.get(signal, signal.replace("_", " "))


def shorten(channel: str) -> str:
    """Return a channel's name without its unit, in words."""
    return SHORT.get(channel, channel.replace("_", " "))


def spell(name: str) -> str:
    """Return an effect's name in words."""
    return name.replace("_", " ")
