"""What measured signals are called in sentences and formulas: their names in words, and their units apart."""

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
    if before == "rate of":
        unit = ""  # in scales per pace
    if before.startswith(DISTANCE):
        unit = unit.removesuffix("/s").removesuffix("1")
    return f"{before}{blank}{words}", unit
