"""What passes along the chain, at the fine step, and what an effect is.

Flows in: nothing. Flows out: ``Signals``, the arrays that effects read and change, and ``Effect``. Signals are
(4, trials, fine samples); joint angles (2, trials, fine samples).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stages.benchmark.blinded_rig.machine import JOINT_OF_MUSCLE, Array, Machine

Site = Literal[
    "command",
    "valve",
    "pressure",
    "acting_pressure",
    "geometry",
    "muscle",
    "cable",
    "force_wire",
    "pressure_wire",
    "count",
    "pressure_count",
    "angle_wire",
]
LoadCellSite = Literal["muscle_tip", "joint_end"]


@dataclass
class Signals:
    """True signals of a session; each step of the chain fills in its own."""

    machine: Machine
    step_s: float
    time_s: Array
    start_s: Array
    joint_rad: Array
    command_kpa: Array
    pressure_kpa: Array = field(default_factory=lambda: np.empty(0))
    acting_kpa: Array = field(default_factory=lambda: np.empty(0))
    contraction: Array = field(default_factory=lambda: np.empty(0))
    velocity_per_s: Array = field(default_factory=lambda: np.empty(0))
    tension_n: Array = field(default_factory=lambda: np.empty(0))
    sensed_n: Array = field(default_factory=lambda: np.empty(0))
    sensed_kpa: Array = field(default_factory=lambda: np.empty(0))

    @property
    def travel_rad(self) -> Array:
        """Angle of each muscle's own joint, (4, trials, fine samples)."""
        return self.joint_rad[JOINT_OF_MUSCLE]

    @property
    def other_rad(self) -> Array:
        """Angle of the joint that a muscle does not drive."""
        return self.joint_rad[1 - JOINT_OF_MUSCLE]

    @property
    def full_n(self) -> Array:
        """Full force, N, (4, 1, 1)."""
        return self.machine.full_force_n[:, None, None]

    @property
    def hand(self) -> Array:
        """The way in which an effect goes that could go either way, (4, 1, 1)."""
        return self.machine.hand[:, None, None]

    @property
    def session_s(self) -> Array:
        """Time since the session began, s, (trials, fine samples)."""
        return self.start_s[:, None] + self.time_s


@dataclass(frozen=True)
class Effect:
    """A hidden effect: ``act(signals, size)`` returns its site's signal, ``size`` (4, 1, 1) in ``unit``.

    ``key`` is how a scenario asks for it, ``name`` what the literature calls it (outsiders bear a name of their own);
    ``channel`` is where it shows first; ``largest`` the largest size that a rig could have; ``only_form`` says that
    no other mathematical form of it exists, so that a library's may be the same. ``outsider_for`` says which foreign
    catalogue an outsider belongs to. A ``joint_wide`` effect has one size for both muscles of a joint; at the site
    ``angle_wire``, ``act`` returns the joint angles, (2, trials, fine samples), rad.
    """

    key: str
    name: str
    site: Site
    channel: Literal["pressure_kpa", "force_n"]
    unit: str
    largest: float
    act: Callable[[Signals, Array], Array]
    only_form: bool = False
    outsider: bool = False
    outsider_for: Literal["building", "scoring"] = "building"
    joint_wide: bool = False
