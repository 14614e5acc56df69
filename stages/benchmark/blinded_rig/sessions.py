"""The rig as a workflow asks for it: whole sessions, by name or drawn by seed.

Flows in: a seed, and what is asked for of the hidden effect. Flows out: datasets with the truth apart; pairs without
noise, with an effect and without, which show what a form of another library leaves of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from stages.benchmark.blinded_rig.catalogues import EFFECTS_OF, OUTSIDERS_OF, SINGLE, catalogue_named
from stages.benchmark.blinded_rig.dataset import Dataset, extend, refuse_nonsense, simulate
from stages.benchmark.blinded_rig.effects import ALL_EFFECTS, EFFECTS
from stages.benchmark.blinded_rig.machine import JOINTS, MUSCLES, Array
from stages.benchmark.blinded_rig.scenarios import (
    CATALOGUES,
    MAIN,
    NEARLY_ABSORBED,
    Magnitude,
    Scenario,
    load_cell_for,
    named_scenario,
    scenario,
)
from stages.benchmark.blinded_rig.surroundings import CatalogueName

DRAWN = tuple(key for key in MAIN if key not in NEARLY_ABSORBED)
DRAWN_SIZES: tuple[Magnitude, ...] = ("medium", "strong")
STREAM = 9


@dataclass(frozen=True)
class HiddenSessions:
    """A rig whose sessions hide an effect; what is not told is drawn by the seed.

    ``catalogue_name`` says whose sessions these are: this rig's own, or one of the foreign machines'.
    """

    seed: int
    effect: str | None
    magnitude: Magnitude | None
    muscles: list[str] | None
    trials: int
    catalogue_name: CatalogueName = "own"
    real: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.catalogue_name not in CATALOGUES:
            raise ValueError(f"unknown catalogue {self.catalogue_name!r}; there are: {', '.join(CATALOGUES)}")
        refuse_nonsense(self.hidden)

    @property
    def hidden(self) -> Scenario:
        """What this rig hides: the effect asked for or one drawn, on all muscles or, one time in three, on one."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(STREAM,)))
        effect, magnitude, one = (
            rng.choice(DRAWN if self.catalogue_name == "own" else SINGLE),
            DRAWN_SIZES[rng.integers(2)],
            rng.random() < 1.0 / 3.0,
        )
        single = (MUSCLES[rng.integers(len(MUSCLES))],)
        asked = str(effect) if self.effect is None else self.effect
        keys = () if asked == "none" else tuple(asked.split("+"))
        muscles = tuple(self.muscles) if self.muscles is not None else single if one else MUSCLES
        known = [key for key in keys if key in ALL_EFFECTS]
        site = load_cell_for(known, self.seed)
        size = self.magnitude or magnitude
        return Scenario(keys, size, self.seed, muscles, self.trials, site, catalogue=self.catalogue_name)

    def catalogue(self) -> list[str]:
        """Names of the sessions that a scorecard is made of."""
        return [each.name for each in catalogue_named(self.catalogue_name)]

    def record(self, name: str | None = None, further: int = 0) -> Dataset:
        """Return the session of this name, or the one that this rig hides, with further trials at its end."""
        asked = self.hidden if name is None else named_scenario(name, self.catalogue_name)
        return simulate(replace(asked, trials=self.trials + further))

    def prescribe(
        self, command_kpa: Mapping[str, Array], joint_rad: Mapping[str, Array], step_s: float, taken: int
    ) -> tuple[pd.DataFrame, list[float]]:
        """Return the rows of a further trial of the hidden session, and its start, s, in a list.

        Each muscle's command, (n,), and each joint's angle, (n,), are given every `step_s`; `taken` further trials
        were recorded before.
        """
        command = np.stack([command_kpa[name] for name in MUSCLES])[:, None]
        angle = np.stack([joint_rad[name] for name in JOINTS])[:, None]
        return extend(self.hidden, command, angle, step_s, taken)

    def effects(self) -> list[dict[str, object]]:
        """List what there is to hide: key, the library's name, channel, whether it has one form, or no name."""
        told = ("key", "name", "channel", "only_form", "outsider")
        keys: tuple[str, ...] = tuple(EFFECTS)
        if self.catalogue_name != "own":
            keys = (*EFFECTS_OF[self.catalogue_name], *OUTSIDERS_OF[self.catalogue_name])
        return [{name: getattr(ALL_EFFECTS[key], name) for name in told} for key in keys]

    def record_quietly(self, key: str) -> tuple[Dataset, Dataset]:
        """Return the same session without noise, with a strong effect and without any."""
        with_it = replace(
            scenario((key,), "strong", self.seed, catalogue=self.catalogue_name), trials=self.trials, noisy=False
        )
        return simulate(with_it), simulate(replace(with_it, effects=()))
