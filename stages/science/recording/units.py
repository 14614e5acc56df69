"""Units of recorded columns, and their conversion to this project's units.

A column's name and a unit flow in; factor and offset flow out. The ending of a column's name states its own unit.
"""

import math
import re

import pandas as pd

KINDS: dict[str, dict[str, float]] = {
    "force": {"N": 1.0, "mN": 1e-3, "daN": 10.0, "kN": 1e3, "lbf": 4.4482216152605, "gf": 9.80665e-3, "kgf": 9.80665},
    "pressure": {
        "kPa": 1.0,
        "Pa": 1e-3,
        "hPa": 0.1,
        "MPa": 1e3,
        "mbar": 0.1,
        "bar": 100.0,
        "psi": 6.894757293168361,
        "mmHg": 101.325 / 760.0,
    },
    "time": {"s": 1.0, "ns": 1e-9, "us": 1e-6, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "angular velocity": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "mm/min": 1e-3 / 60.0, "cm/s": 1e-2, "km/h": 1.0 / 3.6},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3},
    "torque": {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "kN m": 1e3},
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6},
    "power": {"W": 1.0, "mW": 1e-3, "kW": 1e3},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "mass": {"kg": 1.0, "g": 1e-3},
    "flow": {
        "m3/s": 1.0,
        "m3/h": 1.0 / 3600.0,
        "l/s": 1e-3,
        "l/min": 1e-3 / 60.0,
        "l/h": 1e-3 / 3600.0,
        "ml/min": 1e-6 / 60.0,
    },
    "temperature": {"K": 1.0, "degC": 1.0, "degF": 5.0 / 9.0},
    "ratio": {"ratio": 1.0, "percent": 0.01},
    "rate of a ratio": {"1/s": 1.0, "percent/s": 0.01},
}
"""By kind of quantity: each unit as a multiple of the first. Pressures are gauge pressures in every unit."""

UNIT_KINDS = {unit: kind for kind, units in KINDS.items() for unit in units}
"""Kind of quantity by unit."""

MINUS = "-"
"""Before a unit: of the other sign."""
ZEROS = {"degC": 273.15, "degF": 459.67 * 5.0 / 9.0}
"""Zero point of a unit, in the first unit of its kind; 0 for units that are not listed."""

_SPELLINGS = {
    "percent": "%",
    "ratio": "-",
    "s": "sec secs second seconds",
    "ms": "msec",
    "us": "usec",
    "min": "minutes",
    "h": "hours",
    "d": "days",
    "in": "inch inches",
    "lbf": "lb lbs pounds",
    "deg": "degree degrees °",
    "deg/s": "°/s",
    "degC": "°C degc DegC celsius",
    "degF": "°F",
    "rpm": "rev/min 1/min U/min tr/min",
    "bar": "barg",
    "psi": "psig",
    "V": "volt volts",
    "A": "amp amps ampere",
    "N": "newton newtons",
}
OTHER_SPELLINGS = {spelled: unit for unit, told in _SPELLINGS.items() for spelled in told.split()}


def end_of(unit: str) -> str:
    """Return the ending of a column's name that states a unit."""
    return re.sub(r"^_", "", unit.lower().replace(" ", "").replace("1/", "/").replace("/", "_per_"))


ENDS = {end_of(unit): (kind, unit) for unit, kind in UNIT_KINDS.items() if unit != "in"}
"""Kind and unit by a name's ending. Inches are left out, as too many names end in the word in."""

WITHOUT_END = ("ratio", "ratio")
"""Kind and unit of a column whose name ends in no unit."""


def _state(name: str) -> tuple[str, str]:
    ends = [end for end in ENDS if name == end or name.endswith(f"_{end}")]
    return ENDS[max(ends, key=len)] if ends else WITHOUT_END


def own_unit(name: str) -> str:
    """Return the unit that a column's name states."""
    return _state(name)[1]


def known_units(name: str) -> dict[str, float]:
    """Return the units in which a column may be recorded, its own first, each with its factor to that one."""
    kind, own = _state(name)
    units = KINDS[kind]
    return {own: 1.0} | {unit: factor / units[own] for unit, factor in units.items() if unit != own}


def convert(values: pd.Series, name: str, unit: str) -> pd.Series:
    """Return a column's values in its own unit, from a unit of `choose_unit`."""
    if unit.startswith(MINUS):
        return -convert(values, name, unit.removeprefix(MINUS))
    own = own_unit(name)
    if unit == own:
        return values
    shift = (ZEROS.get(unit, 0.0) - ZEROS.get(own, 0.0)) / KINDS[_state(name)[0]][own]
    scaled = values * known_units(name)[unit]
    return scaled + shift if shift else scaled


def read_unit(text: str) -> str | None:
    """Return the unit that a text spells, in any usual spelling; None where it is no unit."""
    spelled = re.sub(r"\s+", " ", text.strip().replace("µ", "u").replace("μ", "u").replace("·", " ").replace("*", " "))
    spelled = spelled.replace("^", "").replace("²", "2").replace("³", "3")
    bare = spelled.replace(" ", "")
    others = [OTHER_SPELLINGS[each] for each in (spelled, bare, bare.lower()) if each in OTHER_SPELLINGS]
    spelled = [*others, spelled][0]
    products = {unit.replace(" ", ""): unit for unit in UNIT_KINDS if " " in unit}
    spelled = products.get(spelled.replace(" ", ""), spelled)
    if spelled in UNIT_KINDS:
        return spelled
    alike = {unit.lower(): unit for unit in UNIT_KINDS}
    return alike.get(spelled.lower()) if len(spelled) > 1 or spelled.lower() in "snvaw" else None


def choose_unit(name: str, unit: str | None) -> str:
    """Return the unit in which a column is recorded, its own where none is given; a `ValueError` tells another.

    A minus before the unit says that the column was recorded with the other sign.
    """
    if unit is not None and unit.startswith(MINUS):
        return MINUS + choose_unit(name, unit.removeprefix(MINUS))
    known = known_units(name)
    meant = own_unit(name) if unit is None else unit if unit in known else read_unit(unit)
    if meant in known:
        return str(meant)
    told = f"units.{name}: no unit '{unit}'"
    spelled = re.sub(r"_([^_]+)$", r"_per_\1", name)  # flow_m3_per_s of flow_m3_s
    ends_in_it = "_per_" in end_of(own_unit(spelled)) and "_per_" not in name
    if meant is not None and ends_in_it and meant in known_units(spelled):
        raise ValueError(f"{told} for a name that ends in {own_unit(name)}; name the signal {spelled}, with per for /")
    if meant is not None and _state(name) == WITHOUT_END:
        stated = next(iter(KINDS[UNIT_KINDS[meant]]))
        raise ValueError(f"{told} for a name that ends in no unit; name the signal {name}_{end_of(stated)}")
    raise ValueError(f"{told}; choose from: {', '.join(known)}")
