"""The rig as a workflow asks for it: whole sessions, by name or drawn by seed.

Flows in: a seed, and what is asked for of the hidden effect. Flows out: datasets with the truth apart; pairs without
noise, with an effect and without, which show what a form of another library leaves of it.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from stages.benchmark.blinded_rig.dataset import Dataset, refuse_nonsense, simulate
from stages.benchmark.blinded_rig.effects import EFFECTS
from stages.benchmark.blinded_rig.machine import MUSCLES
from stages.benchmark.blinded_rig.scenarios import (
    MAIN,
    NEARLY_ABSORBED,
    Magnitude,
    Scenario,
    default_catalogue,
    load_cell_for,
    named_scenario,
    scenario,
)

DRAWN = tuple(key for key in MAIN if key not in NEARLY_ABSORBED)
DRAWN_SIZES: tuple[Magnitude, ...] = ("medium", "strong")
STREAM = 9


@dataclass(frozen=True)
class HiddenSessions:
    """A rig whose sessions hide an effect; what is not told is drawn by the seed."""

    seed: int
    effect: str | None
    magnitude: Magnitude | None
    muscles: list[str] | None
    trials: int
    real: ClassVar[bool] = False

    def __post_init__(self) -> None:
        refuse_nonsense(self.hidden)

    @property
    def hidden(self) -> Scenario:
        """What this rig hides: the effect asked for or one drawn, on all muscles or, one time in three, on one."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(STREAM,)))
        effect, magnitude, one = rng.choice(DRAWN), DRAWN_SIZES[rng.integers(2)], rng.random() < 1.0 / 3.0
        single = (MUSCLES[rng.integers(len(MUSCLES))],)
        asked = str(effect) if self.effect is None else self.effect
        keys = () if asked == "none" else tuple(asked.split("+"))
        muscles = tuple(self.muscles) if self.muscles is not None else single if one else MUSCLES
        known = [key for key in keys if key in EFFECTS]
        site = load_cell_for(known, self.seed)
        return Scenario(keys, self.magnitude or magnitude, self.seed, muscles, self.trials, site)

    def catalogue(self) -> list[str]:
        """Names of the sessions that a scorecard is made of."""
        return [each.name for each in default_catalogue()]

    def record(self, name: str | None = None) -> Dataset:
        """Return the session of this name, or the one that this rig hides."""
        return simulate(self.hidden if name is None else replace(named_scenario(name), trials=self.trials))

    def effects(self) -> list[dict[str, object]]:
        """List what there is to hide: key, the library's name, channel, whether it has one form, or no name."""
        told = ("key", "name", "channel", "only_form", "outsider")
        return [{name: getattr(effect, name) for name in told} for effect in EFFECTS.values()]

    def record_quietly(self, key: str) -> tuple[Dataset, Dataset]:
        """Return the same session without noise, with a strong effect and without any."""
        with_it = replace(scenario((key,), "strong", self.seed), trials=self.trials, noisy=False)
        return simulate(with_it), simulate(replace(with_it, effects=()))
