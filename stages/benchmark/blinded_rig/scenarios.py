"""The catalogue: which datasets a scorecard is made of.

Flows in: lists of effects, magnitudes and seeds. Flows out: ``Scenario``, all that a dataset depends on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args
from zlib import crc32

from stages.benchmark.blinded_rig.effects import ALL_EFFECTS, EFFECTS
from stages.benchmark.blinded_rig.machine import MUSCLES
from stages.benchmark.blinded_rig.signals import LoadCellSite
from stages.benchmark.blinded_rig.surroundings import CatalogueName

Magnitude = Literal["weak", "medium", "strong"]

CATALOGUES: tuple[CatalogueName, ...] = get_args(CatalogueName)
MAGNITUDES: tuple[Magnitude, ...] = ("weak", "medium", "strong")
TRIALS = 16
MAIN = (
    "hysteresis", "coulomb_friction", "stribeck_friction", "capstan_friction", "transport_delay", "valve_lag",
    "valve_rate_limit", "valve_asymmetry", "threshold_pressure", "creep", "series_elasticity", "sensor_drift",
    "cubic_stiffness", "channel_misalignment",
)  # fmt: skip
NEARLY_ABSORBED = ("series_elasticity", "threshold_pressure")
PAIRS = (
    ("hysteresis", "transport_delay"), ("coulomb_friction", "valve_asymmetry"), ("creep", "valve_rate_limit"),
    ("sensor_drift", "transport_delay"), ("capstan_friction", "valve_lag"),
    ("cubic_stiffness", "sensor_drift_pressure"),
    ("hysteresis", "sensor_drift"), ("pressure_dead_band", "valve_asymmetry"), ("stribeck_friction", "transport_delay"),
    ("channel_misalignment", "valve_asymmetry"), ("end_stiffening", "coulomb_friction"), ("creep", "sensor_drift"),
)  # fmt: skip
SEEDS_OF = {"none": 1000, "main": 2000, "outsider": 3000, "pair": 4000, "one_muscle": 5000}


@dataclass(frozen=True)
class Scenario:
    """A dataset in words: keys of the hidden effects (none, one or two), size, carriers, seed, trials, load cell."""

    effects: tuple[str, ...]
    magnitude: Magnitude
    seed: int
    muscles: tuple[str, ...] = MUSCLES
    trials: int = TRIALS
    load_cell_site: LoadCellSite = "joint_end"
    noisy: bool = True
    catalogue: CatalogueName = "own"

    @property
    def name(self) -> str:
        """For folders: catalogue if not this rig's own, effect, magnitude, carriers if not all, seed."""
        hidden = f"{'+'.join(self.effects)}-{self.magnitude}" if self.effects else "none"
        where = "" if self.muscles == MUSCLES else "-" + "+".join(self.muscles)
        prefix = "" if self.catalogue == "own" else f"{self.catalogue}:"
        return f"{prefix}{hidden}{where}-{self.seed}"


def load_cell_for(effects: Sequence[str], seed: int) -> LoadCellSite:
    """At the joint's end where a cable effect must show; otherwise one seed in two sits at the muscle's tip."""
    cable = any(ALL_EFFECTS[key].site == "cable" for key in effects)
    return "joint_end" if cable or seed % 2 == 0 else "muscle_tip"


def scenario(
    effects: Sequence[str],
    magnitude: Magnitude,
    seed: int,
    muscles: Sequence[str] = MUSCLES,
    catalogue: CatalogueName = "own",
) -> Scenario:
    """Return a scenario of the catalogue's usual length, the load cell where the effect can show."""
    site = load_cell_for(effects, seed)
    return Scenario(tuple(effects), magnitude, seed, tuple(muscles), load_cell_site=site, catalogue=catalogue)


def named_scenario(name: str, catalogue: CatalogueName = "own") -> Scenario:
    """Read a scenario's name, as ``hysteresis+transport_delay-medium-pam1-4000`` or ``none-1000``.

    A catalogue ahead of it, as in ``foreign_scoring:none-200000``, overrules the one given.

    Raises
    ------
    ValueError
        A name that does not read so.
    """
    prefix, colon, rest = name.rpartition(":")
    known = next((each for each in CATALOGUES if each == prefix), catalogue)
    hidden, *between, seed = rest.split("-")
    effects = () if hidden == "none" else tuple(hidden.split("+"))
    size = between.pop(0) if effects and between else "medium"
    magnitude = next((each for each in MAGNITUDES if each == size), None)
    unknown = [key for key in effects if key not in ALL_EFFECTS]
    if (colon and known != prefix) or unknown or magnitude is None or len(between) > 1 or not seed.isdecimal():
        raise ValueError(f"{name!r} names no session; expected EFFECT-MAGNITUDE-SEED, or none-SEED")
    return scenario(effects, magnitude, int(seed), between[0].split("+") if between else MUSCLES, known)


def catalogue(effects: Sequence[str], magnitudes: Sequence[Magnitude], seeds: Sequence[int]) -> list[Scenario]:
    """Every effect in every magnitude; an effect's seeds are its own, so that no machine is met with another."""
    return [
        scenario((key,), magnitude, seed + 10_000 * (1 + crc32(key.encode()) % 100_000))
        for key, magnitude, seed in product(effects, magnitudes, seeds)
    ]


def default_catalogue() -> list[Scenario]:
    """Return the scorecard's 354: 100 none, 14 effects x 3 x 5, 20 outsiders, 12 pairs, 12 on one muscle."""
    outsiders = [key for key, effect in EFFECTS.items() if effect.outsider]
    none = [scenario((), "medium", SEEDS_OF["none"] + k) for k in range(100)]
    main = catalogue(MAIN, MAGNITUDES, range(SEEDS_OF["main"], SEEDS_OF["main"] + 5))
    foreign = [
        scenario(
            (outsiders[k % len(outsiders)],), ("medium", "strong")[k // len(outsiders) % 2], SEEDS_OF["outsider"] + k
        )
        for k in range(20)
    ]
    pairs = [scenario(pair, MAGNITUDES[1 + k % 2], SEEDS_OF["pair"] + k) for k, pair in enumerate(PAIRS)]
    single = [
        scenario((key,), MAGNITUDES[1 + k // 4 % 2], SEEDS_OF["one_muscle"] + k, (MUSCLES[k % len(MUSCLES)],))
        for k, key in enumerate(key for key in MAIN if key not in NEARLY_ABSORBED)
    ]
    return none + main + foreign + pairs + single
