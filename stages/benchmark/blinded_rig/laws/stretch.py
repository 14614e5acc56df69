"""A spring whose stiffness follows pressure and stretch.

F = K s with the stretch s over the shortest length and K = c3 p^2 + c2 p s + c1 s^2 + c0: Wickramatunge, K. C. &
Leephakpreeda, T. (2009), "Study on mechanical behaviors of pneumatic artificial muscle", International Journal of
Engineering Science 48, 188-198. The form is theirs; the constants are set to the forces of the muscles here.

Flows in: pressure, kPa, and contraction, (4, ...). Flows out: tension, N, (4, ...).
"""

from dataclasses import dataclass

import numpy as np

from stages.benchmark.blinded_rig.laws.sheet import full_force_n, vary
from stages.benchmark.blinded_rig.machine import FULL_PRESSURE_KPA, Array, column


@dataclass(frozen=True)
class Stretch:
    """Constants (4,): shortest length as a contraction; c0 to c3 as shares of full force at 600 kPa; full force, N."""

    shortest: Array
    c0: Array
    c1: Array
    c2: Array
    c3: Array
    full_n: Array

    def tension(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Tension, N, (4, ...)."""
        shortest, c0, c1, c2, c3, full = (column(each, contraction) for each in vars(self).values())
        stretch, pressure = 1.0 - contraction / shortest, pressure_kpa / FULL_PRESSURE_KPA
        stiffness = (c3 * pressure + c2 * stretch) * pressure + c1 * stretch**2 + c0
        return full * stiffness * stretch


def build_stretch(rng: np.random.Generator) -> Stretch:
    """Draw one session's constants; the square of pressure carries about a seventh of the full force."""
    c0, c1, c3 = vary(rng, 0.005, 0.3), vary(rng, 0.03, 0.3), vary(rng, 0.15, 0.1)
    return Stretch(
        shortest=vary(rng, 0.40, 0.02),
        c0=c0,
        c1=c1,
        c2=1.0 - c0 - c1 - c3,
        c3=c3,
        full_n=vary(rng, 1.0, 0.02) * full_force_n(),
    )
