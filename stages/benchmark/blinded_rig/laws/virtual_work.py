"""Virtual work of a braided shell with conical ends, and of its rubber bladder.

The braid's cylinder meets the fittings in two cones of fixed slant (Tondu, B. & Lopez, P. (2000), "Modeling and control
of McKibben artificial muscle robot actuators", IEEE Control Systems 20(2), 15-38, with their loss of contraction at low
pressure, exp(-p)); the bladder is a Mooney-Rivlin solid (Klute, G. K. & Hannaford, B. (2000), "Accounting for elastic
energy storage in McKibben artificial muscle actuators", Journal of Dynamic Systems, Measurement, and Control 122,
386-388; Kothera, C. S. et al. (2009), "Experimental characterization and static modeling of McKibben actuators",
Journal of Mechanical Design 131, 091010); its fibres give a little under load (Davis, S. et al. (2003), "Enhanced
modelling and performance in braided pneumatic muscle actuators", International Journal of Robotics Research 22).

Flows in: pressure, kPa, and contraction, (4, ...). Flows out: tension, N, (4, ...).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from stages.benchmark.blinded_rig.laws.sheet import full_force_n, vary
from stages.benchmark.blinded_rig.machine import BRAID_ANGLE_DEG, FULL_PRESSURE_KPA, Array, column, sheet_column

ANGLES_RAD = np.deg2rad(np.linspace(12.0, 50.0, 400))
SLANT_OVER_DIAMETER = 1.2
NECK = 0.85
KNOTS = np.linspace(-0.08, 0.40, 121)


@dataclass(frozen=True)
class VirtualWork:
    """Splines of each muscle over contraction: pull per unit of pressure, and the bladder's, in shares of full force.

    ``full_n`` N, ``lost`` the share of contraction lost at low pressure, ``lost_kpa`` where, ``give`` the fibres' share
    of the pull that goes with the square of pressure; (4,) each.
    """

    pull: tuple[CubicSpline, ...]
    bladder: tuple[CubicSpline, ...]
    full_n: Array
    lost: Array
    lost_kpa: Array
    give: Array

    def tension(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Tension, N, (4, ...)."""
        pressure = pressure_kpa / FULL_PRESSURE_KPA
        factor = 1.0 + column(self.lost, pressure) * np.exp(-pressure_kpa / column(self.lost_kpa, pressure))
        pull = np.stack([spline(rows) for spline, rows in zip(self.pull, factor * contraction, strict=True)])
        bladder = np.stack([spline(rows) for spline, rows in zip(self.bladder, contraction, strict=True)])
        given = 1.0 + column(self.give, pressure) * (pressure - 1.0)
        return column(self.full_n, pressure) * (pressure * given * pull + bladder)


def shell(braid_rad: float, slender: float) -> tuple[Array, Array]:
    """Contraction and pull per pressure, over that at rest: -dV/dL along the braid's angle, (angles,).

    ``slender`` is the diameter at rest over the length. The cylinder's fibres have unit length, so that its length is
    cos(angle) and its radius sin(angle) over the turns; a cone of fixed slant joins it to a fitting somewhat narrower
    than the braid at rest.
    """
    turns = np.tan(braid_rad) / (np.pi * slender)
    radius, cylinder = np.sin(ANGLES_RAD) / (2.0 * np.pi * turns), np.cos(ANGLES_RAD)
    at_rest = np.sin(braid_rad) / (2.0 * np.pi * turns)
    neck, slant = NECK * at_rest, SLANT_OVER_DIAMETER * 2.0 * at_rest
    height = np.sqrt(np.maximum(slant**2 - (radius - neck) ** 2, 1e-6))
    volume = np.pi * (radius**2 * cylinder + 2.0 / 3.0 * height * (radius**2 + radius * neck + neck**2))
    length = cylinder + 2.0 * height
    rest = CubicSpline(ANGLES_RAD, length)(braid_rad)
    pull = -np.gradient(volume, ANGLES_RAD) / np.gradient(length, ANGLES_RAD)
    pull /= CubicSpline(ANGLES_RAD, pull)(braid_rad)
    return 1.0 - length / rest, pull


def mooney_rivlin(contraction: Array, braid_rad: float, second: float) -> Array:
    """Tension of the bladder, dW/dL over twice C10 times its section, (samples,); ``second`` is C01 over C10.

    W = C10 (I1 - 3) + C01 (I2 - 3), incompressible, stretched along the muscle and, by the braid, around it.
    """
    along = 1.0 - contraction

    def energy(stretch: Array) -> Array:
        around2 = (1.0 - (stretch * np.cos(braid_rad)) ** 2) / np.sin(braid_rad) ** 2
        along2 = stretch**2
        first = along2 + around2 + 1.0 / (along2 * around2)
        return first - 3.0 + second * (1.0 / along2 + 1.0 / around2 + along2 * around2 - 3.0)

    return (energy(along + 1e-5) - energy(along - 1e-5)) / 4e-5


def build_virtual_work(rng: np.random.Generator) -> VirtualWork:
    """Draw one session's constants."""
    braids = np.deg2rad(vary(rng, BRAID_ANGLE_DEG - 1.0, 0.012))
    rubber, second = vary(rng, 0.004, 0.2), vary(rng, 0.25, 0.2)
    pull, bladder = [], []
    slender = sheet_column("nominal_diameter_m") / sheet_column("rest_length_m")
    for muscle, braid in enumerate(braids):
        contraction, relative = shell(braid, slender[muscle])
        along = np.argsort(contraction)
        pull.append(CubicSpline(KNOTS, np.interp(KNOTS, contraction[along], relative[along])))
        inside = np.minimum(KNOTS, 0.38)
        bladder.append(CubicSpline(KNOTS, rubber[muscle] * mooney_rivlin(inside, braid, second[muscle])))
    return VirtualWork(
        tuple(pull),
        tuple(bladder),
        full_n=vary(rng, 1.0, 0.02) * full_force_n(),
        lost=vary(rng, 0.35, 0.1),
        lost_kpa=vary(rng, 120.0, 0.1),
        give=vary(rng, 0.14, 0.1),
    )
