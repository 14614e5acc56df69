"""What a session of a foreign rig is set in: its law, its sampling rate and its disturbances, drawn by the seed.

Flows in: a catalogue's name and a generator. Flows out: ``Surroundings``. Each disturbance has a level of its own, from
absent to large; ``LEVELS`` says what a level means.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

CatalogueName = Literal["own", "foreign_building", "foreign_scoring"]

LEVEL_NAMES = ("none", "small", "medium", "large")
LEVELS: dict[str, tuple[float, float, float, float]] = {
    "gain_jitter": (0.0, 0.01, 0.02, 0.03),
    "offset_jitter": (0.0, 0.0005, 0.001, 0.002),
    "pink_force": (0.0, 0.0005, 0.001, 0.002),
    "pink_pressure": (0.0, 0.3, 0.7, 1.5),
    "supply_ripple": (0.0, 0.5, 1.5, 3.0),
    "mains_hum": (0.0, 0.0004, 0.0008, 0.0016),
}
CHANCES = (0.25, 0.3, 0.3, 0.15)
RATES_HZ = (100.0, 250.0, 500.0)
RATE_CHANCES = (0.25, 0.4, 0.35)
RIPPLE_HZ = (3.0, 40.0)
LAW_CHANCES: dict[str, dict[str, float]] = {
    "foreign_building": {"exponential": 0.45, "table": 0.35, "virtual_work": 0.15, "braid": 0.05},
    "foreign_scoring": {"stretch": 0.40, "virtual_work": 0.35, "table": 0.15, "exponential": 0.10},
}
SEED_OFFSET: dict[str, int] = {"own": 0, "foreign_building": 2**40, "foreign_scoring": 2**41}


@dataclass(frozen=True)
class Surroundings:
    """One session's law, rate and disturbances.

    ``gain_jitter`` and ``offset_jitter`` are standard deviations from trial to trial of the force, ``pink_force`` and
    ``mains_hum`` RMS, all shares of full force (the gain of 1); ``pink_pressure`` and ``supply_ripple`` RMS in kPa.
    """

    law: str
    rate_hz: float
    levels: dict[str, str]
    gain_jitter: float
    offset_jitter: float
    pink_force: float
    pink_pressure: float
    supply_ripple: float
    mains_hum: float
    ripple_hz: float


def draw_surroundings(catalogue: CatalogueName, rng: np.random.Generator) -> Surroundings:
    """Draw a session's surroundings; every draw is made whatever the others gave."""
    chances = LAW_CHANCES[catalogue]
    law = str(rng.choice(list(chances), p=list(chances.values())))
    rate_hz = float(rng.choice(RATES_HZ, p=RATE_CHANCES))
    levels = {name: int(rng.choice(len(LEVEL_NAMES), p=CHANCES)) for name in LEVELS}
    sizes = {name: LEVELS[name][level] for name, level in levels.items()}
    ripple_hz = float(np.exp(rng.uniform(*np.log(RIPPLE_HZ))))
    named = {name: LEVEL_NAMES[level] for name, level in levels.items()}
    return Surroundings(law, rate_hz, named, **sizes, ripple_hz=ripple_hz)
