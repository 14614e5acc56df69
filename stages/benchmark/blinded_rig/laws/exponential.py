"""An exponential in contraction, as fitted to Festo's fluidic muscles.

F = (a1 p + a2) exp(a3 e) + a4 e p + a5 p + a6, with pressure p and contraction e: Sarosi, J. (2012), "New approximation
algorithm for the force of Fluidic Muscles", IEEE SACI, 229-233; Sarosi, J., Biro, I., Nemeth, J. & Cveticanin, L.
(2015), "Dynamic modeling of a pneumatic muscle actuator with two-direction motion", Mechanism and Machine Theory 85.
The form is theirs; the constants are set to the forces of the muscles here.

Flows in: pressure, kPa, and contraction, (4, ...). Flows out: tension, N, (4, ...).
"""

from dataclasses import dataclass

import numpy as np

from stages.benchmark.blinded_rig.laws.sheet import full_force_n, vary
from stages.benchmark.blinded_rig.machine import FULL_PRESSURE_KPA, Array, column


@dataclass(frozen=True)
class Exponential:
    """Constants (4,): a1, a4, a5 in N/kPa, a2, a6 in N, a3 per unit of contraction."""

    a1: Array
    a2: Array
    a3: Array
    a4: Array
    a5: Array
    a6: Array

    def tension(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Tension, N, (4, ...)."""
        a1, a2, a3, a4, a5, a6 = (column(each, contraction) for each in vars(self).values())
        decay = np.exp(a3 * contraction)
        return (a1 * pressure_kpa + a2) * decay + (a4 * contraction + a5) * pressure_kpa + a6


def build_exponential(rng: np.random.Generator) -> Exponential:
    """Draw one session's constants; the exponential carries about a third of the full force."""
    full, steep = vary(rng, 0.95, 0.015) * full_force_n(), vary(rng, 0.38, 0.06)
    per_kpa = full / FULL_PRESSURE_KPA
    sleeve = vary(rng, 0.17, 0.12) * full
    return Exponential(
        a1=steep * per_kpa,
        a2=sleeve,
        a3=-1.0 / vary(rng, 0.052, 0.06),
        a4=-vary(rng, 1.0, 0.05) * per_kpa,
        a5=(1.0 - steep) * per_kpa,
        a6=-0.15 * sleeve,
    )
