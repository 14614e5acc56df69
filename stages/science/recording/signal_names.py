"""What measured signals are called in sentences, formulas and figures: their names in words, their units apart."""

from stages.science.recording.units import ENDS, own_unit
from stages.science.signals.histories import DISTANCE

CALLED = {
    "contraction_velocity_per_s": ("velocity", "1/s"),
    "contraction_acceleration_per_s2": ("acceleration", "1/s^2"),
    "pressure_command_kpa": ("command", "kPa"),
    "pressure_rate": ("rate of pressure", "kPa/s"),
    "command_rate": ("rate of command", "kPa/s"),
    "time_s": ("time in the trial", "s"),
    "start_s": ("time in the session", "s"),
}


def name_signal(name: str) -> tuple[str, str]:
    """Return a driver's name in words, those before the last blank as they are, and its unit; empty if none is told."""
    before, blank, column = name.rpartition(" ")
    if column in CALLED:
        words, unit = CALLED[column]
    else:
        end = max((each for each in ENDS if column.endswith(f"_{each}")), key=len, default="")
        words = column.removesuffix(f"_{end}").replace("_", " ") if end else column.replace("_", " ")
        unit = own_unit(column) if end else ""
    if name.startswith("rate of "):
        unit = ""  # in scales per pace
    if before.startswith(DISTANCE):
        unit = unit.removesuffix("/s").removesuffix("1")
    if before.endswith(" -"):
        before = f"{name_signal(before.removesuffix(' -'))[0]} -"
    return f"{before}{blank}{words}", unit


def label(name: str, unit: str = "") -> str:
    """Return what an axis of a signal says: its name in words, and its unit, where it is given or the name tells it."""
    words, own = name_signal(name)
    told = unit or own
    return f"{words} ({told})" if told else words


def per_second(unit: str) -> str:
    """Return the unit of the rate of a signal in a unit."""
    return f"{unit}^2" if unit.endswith("/s") else f"{unit or '1'}/s"
