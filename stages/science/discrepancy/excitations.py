"""Kinds of excitation that a trial may have, as shares of the range of what drives it.

A duration and the time of a usual movement flow in; by kind, shares over time flow out.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np

from stages.science.signals.trajectories import Array

LEVELS = (0.2, 0.8, 0.5, 1.0, 0.0, 0.6, 0.9, 0.1, 0.4, 0.7)
"""Shares that steps hold in turn: rises and falls of several sizes."""

MOST_AT_ONCE = 2
"""Levers that are not held low in one trial."""

Shape = Callable[[Array, float], Array]
"""Shares over times, s, for the time of a usual movement, s."""


def _cycle(times: Array, period_s: float) -> Array:
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * times / period_s)


def _step(rise: float) -> Shape:
    """Levels held for a usual movement, smoothly joined in a share of it."""

    def shape(times: Array, movement_s: float) -> Array:
        place = times / movement_s
        number = np.floor(place).astype(int)
        share = np.clip((place - number) / rise, 0.0, 1.0)
        levels = np.array(LEVELS)
        before, after = levels[(number - 1) % len(levels)], levels[number % len(levels)]
        stepped: Array = before + (after - before) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        return stepped

    return shape


SHAPES: Mapping[str, Shape] = {
    "held low": lambda times, movement_s: np.full(len(times), 0.1),
    "held high": lambda times, movement_s: np.full(len(times), 0.9),
    "swept slowly": lambda times, movement_s: 1.0 - np.abs(2.0 * times / max(times[-1], 1e-300) - 1.0),
    "cycled": lambda times, movement_s: _cycle(times, 2.0 * movement_s),
    "cycled fast": lambda times, movement_s: _cycle(times, 0.75 * movement_s),
    "cycled with growing amplitude": lambda times, movement_s: (
        0.5 + 0.5 * times / max(times[-1], 1e-300) * np.sin(2.0 * np.pi * times / (2.0 * movement_s))
    ),
    "stepped": _step(0.15),
    "moved and held": _step(0.6),
}
"""A sweep goes up and down once in all of the time. Smooth steps are as of minimum jerk: Flash and Hogan, Journal of
Neuroscience 5 (1985)."""


def list_excitations(
    levers: Sequence[str], samples: int, step_s: float, movement_s: float, lead_in_s: float = 0.0
) -> tuple[list[dict[str, str]], dict[str, Array]]:
    """Return combinations of kinds, by lever, and the shares that each lever runs through, (T, J).

    They are all in which something moves and, of more than two levers, all but two are held low. They begin after the
    lead-in, in which they stay as they begin.
    """
    times: Array = np.maximum(step_s * np.arange(samples, dtype=float) - lead_in_s, 0.0)
    drawn = {name: shape(times, movement_s) for name, shape in SHAPES.items()}
    moving, low = [name for name, share in drawn.items() if np.ptp(share) > 0.0], next(iter(SHAPES))
    kinds = [
        dict(zip(levers, each, strict=True))
        for each in product(SHAPES, repeat=len(levers))
        if any(kind in moving for kind in each) and sum(kind != low for kind in each) <= MOST_AT_ONCE
    ]
    return kinds, {lever: np.stack([drawn[each[lever]] for each in kinds], axis=1) for lever in levers}
