"""``python -m stages.benchmark.blinded_rig FOLDER effect=hysteresis magnitude=medium seed=3``; ``--list`` shows what.

Keys: effect (two joined by +, or none), magnitude (weak, medium, strong), seed, muscles (joined by +, or all), trials,
load_cell_site (muscle_tip, joint_end), noise (on, off), catalogue (own, foreign_building, foreign_scoring): whose
machines, laws and disturbances.
"""

import sys
from pathlib import Path
from typing import get_args

from stages.benchmark.blinded_rig.catalogues import catalogue_named
from stages.benchmark.blinded_rig.dataset import simulate, write
from stages.benchmark.blinded_rig.effects import ALL_EFFECTS
from stages.benchmark.blinded_rig.machine import MUSCLES
from stages.benchmark.blinded_rig.scenarios import (
    CATALOGUES,
    MAGNITUDES,
    TRIALS,
    Scenario,
    default_catalogue,
    load_cell_for,
)
from stages.benchmark.blinded_rig.signals import LoadCellSite

LOAD_CELL_SITES: tuple[LoadCellSite, ...] = get_args(LoadCellSite)
DEFAULTS = {
    "effect": "none",
    "magnitude": "medium",
    "seed": "0",
    "muscles": "all",
    "trials": str(TRIALS),
    "load_cell_site": "auto",
    "noise": "on",
    "catalogue": "own",
}
CHOICES: dict[str, tuple[str, ...]] = {
    "magnitude": MAGNITUDES,
    "load_cell_site": ("auto", *LOAD_CELL_SITES),
    "noise": ("on", "off"),
    "catalogue": CATALOGUES,
}


def parse(words: list[str]) -> Scenario:
    """Read a scenario from ``key=value`` words.

    Raises
    ------
    ValueError
        A word that is not understood, with what would be.
    """
    asked = dict(DEFAULTS)
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key not in DEFAULTS:
            raise ValueError(f"{word!r} is not understood; give key=value with a key of: {', '.join(DEFAULTS)}")
        if value not in CHOICES.get(key, (value,)):
            raise ValueError(f"{key}={value}: one of {', '.join(CHOICES[key])}")
        if key in ("seed", "trials") and not value.isdecimal():
            raise ValueError(f"{key}={value}: a whole number of at least 0")
        asked[key] = value
    effects = () if asked["effect"] == "none" else tuple(asked["effect"].split("+"))
    unknown = [key for key in effects if key not in ALL_EFFECTS]
    if unknown:
        raise ValueError(f"unknown effect {unknown[0]!r}; there are: none, {', '.join(ALL_EFFECTS)}")
    muscles = MUSCLES if asked["muscles"] == "all" else tuple(asked["muscles"].replace(",", "+").split("+"))
    seed, site = int(asked["seed"]), asked["load_cell_site"]
    return Scenario(
        effects,
        next(each for each in MAGNITUDES if each == asked["magnitude"]),
        seed,
        muscles,
        int(asked["trials"]),
        next((each for each in LOAD_CELL_SITES if each == site), load_cell_for(effects, seed)),
        asked["noise"] == "on",
        next(each for each in CATALOGUES if each == asked["catalogue"]),
    )


def list_effects() -> str:
    """Every effect on a line, then the default catalogue's size."""
    lines = [
        f"{effect.key:24s}{effect.channel:14s}{effect.site:16s}up to {effect.largest:g} {effect.unit}"
        f"{f', outsider for {effect.outsider_for}' if effect.outsider else ''}"
        f"{', one form only' if effect.only_form else ''}"
        for effect in ALL_EFFECTS.values()
    ]
    sizes = (
        f"the default catalogue holds {len(default_catalogue())} scenarios, "
        f"{' and '.join(CATALOGUES[1:])} {len(catalogue_named(CATALOGUES[1]))} each"
    )
    return "\n".join([*lines, f"none{'':20s}{sizes}"])


def main(words: list[str]) -> int:
    """Run the command; return 2 for words that are not understood."""
    if words == ["--list"]:
        print(list_effects())
        return 0
    if not words or words[0].startswith("-") or "=" in words[0]:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        dataset = simulate(parse(words[1:]))
        write(dataset, Path(words[0]))
    except (ValueError, FileExistsError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{words[0]}: {dataset.meta['trials']} trials; the truth is sealed in {words[0].rstrip('/')}.truth.json")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
