"""The machine's rows: which joints there are and which muscles move them.

Rows of the configuration flow in; nothing else in the code knows how many joints or muscles there are.
"""

import math
from collections import Counter
from typing import Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.signals.filtering import window_samples

MOST_STRETCHED, MOST_CONTRACTED = -0.1, 0.4
"""Contractions beyond those of any braided muscle: data sheets end at a stretch of .03 and a contraction near .3."""


class Joint(Declared):
    """One joint of machine and limb together."""

    name: str = Field(min_length=1, description="name of the joint")
    lower_rad: float = Field(ge=-math.pi, le=math.pi, description="lower end stop, rad; no limb turns further")
    upper_rad: float = Field(ge=-math.pi, le=math.pi, description="upper end stop, rad; no limb turns further")
    inertia_kg_m2: PositiveFloat = Field(description="inertia of limb and link about the joint, kg m^2")
    gravity_torque_nm: float = Field(ge=0.0, description="gravity torque of the horizontal limb, N m")
    gravity_zero_rad: float = Field(description="angle at which the limb hangs, rad")
    viscous_nm_s_per_rad: float = Field(ge=0.0, description="passive damping of limb and bearing, N m s/rad")
    stop_nm_per_rad: PositiveFloat = Field(description="stiffness of the end stops, N m/rad")
    stop_nm_s_per_rad: float = Field(ge=0.0, description="damping of the end stops, N m s/rad")
    strength_nm: PositiveFloat = Field(description="largest voluntary torque of a person here, N m")

    @model_validator(mode="after")
    def _order_limits(self) -> Self:
        low, high = self.lower_rad, self.upper_rad
        if low >= high:
            raise ValueError(f"joint {self.name}: expected lower_rad < upper_rad, got {low} and {high}")
        return self


class Muscle(Declared):
    """One pneumatic muscle with its place on a joint."""

    name: str = Field(min_length=1, description="name of the muscle")
    joint: str = Field(description="joint that it moves")
    role: Literal["agonist", "antagonist"] = Field(description="agonists raise the angle")
    type: str = Field(description="type, by which constants and limits are looked up")
    rest_length_m: PositiveFloat = Field(description="length without pressure and load, m")
    nominal_diameter_m: PositiveFloat = Field(description="inner diameter without pressure, m")
    moment_arm_m: PositiveFloat = Field(description="radius of the cable's pulley at the joint, m")
    contraction_at_angle_0: float = Field(
        gt=MOST_STRETCHED, lt=MOST_CONTRACTED, description="contraction at angle 0, ratio of rest length"
    )
    sign: Literal[-1, 1] = Field(description="1 when it shortens as the angle grows")
    max_pressure_kpa: float = Field(
        gt=0.0, le=1000.0, description="largest permitted pressure, kPa gauge; tables of measurements end at 1000"
    )

    @property
    def contraction_per_rad(self) -> float:
        """Change of contraction with joint angle, 1/rad."""
        return self.sign * self.moment_arm_m / self.rest_length_m

    @property
    def torque_arm_m(self) -> float:
        """Joint torque per tension, signed, m."""
        return self.sign * self.moment_arm_m

    def contractions_over(self, joint: Joint) -> tuple[float, float]:
        """Return the contraction at a joint's lower and upper end stop, ratio of rest length."""
        per_rad, at_zero = self.contraction_per_rad, self.contraction_at_angle_0
        return at_zero + per_rad * joint.lower_rad, at_zero + per_rad * joint.upper_rad


class VelocityFilter(Declared):
    """The filter behind every recorded velocity."""

    window_s: float = Field(gt=0.0, le=3600.0, description="length of the window, s; no longer than a trial")
    order: int = Field(ge=1, description="degree of the fitted polynomial; below the number of samples in the window")


class Exoskeleton(Declared):
    """Joints, muscles, and how they are sampled.

    A trial holds a window of the velocity filter, and the window determines the polynomial. Over its joint's range,
    each muscle stays within the contractions that braided muscles reach.
    """

    sampling_rate_hz: float = Field(
        ge=1.0, le=10000.0, description="samples per second, Hz; people move at 1 to 10 Hz, load cells end below 10 kHz"
    )
    trial_s: float = Field(gt=0.0, le=3600.0, description="length of a trial, s; tables of measurements end at an hour")
    load_cell_site: Literal["muscle_tip", "joint_end"]
    velocity_filter: VelocityFilter
    joints: list[Joint] = Field(min_length=1)
    muscles: list[Muscle] = Field(min_length=1)

    @model_validator(mode="after")
    def _match_rows(self) -> Self:
        for kind, names in (("joint", self.joint_names), ("muscle", self.muscle_names)):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise ValueError(f"{kind} '{twice[0]}' is listed twice; give each {kind} its own name")
        joints = {joint.name: joint for joint in self.joints}
        for muscle in self.muscles:
            if muscle.joint not in joints:
                raise ValueError(f"muscle {muscle.name}: no joint '{muscle.joint}'; {nearest(muscle.joint, joints)}")
            joint = joints[muscle.joint]
            lower, upper = muscle.contractions_over(joint)
            if min(lower, upper) <= MOST_STRETCHED or max(lower, upper) >= MOST_CONTRACTED:
                raise ValueError(
                    f"muscle {muscle.name}: expected contractions between {MOST_STRETCHED} and {MOST_CONTRACTED} over "
                    f"the range of joint {joint.name}, got {lower:.3g} to {upper:.3g}; lower moment_arm_m, or change "
                    "sign, rest_length_m, contraction_at_angle_0 or the joint's lower_rad and upper_rad"
                )
        return self

    @model_validator(mode="after")
    def _check_sampling(self) -> Self:
        window_s, order = self.velocity_filter.window_s, self.velocity_filter.order
        length = window_samples(self.sampling_rate_hz, window_s)
        if order >= length:
            raise ValueError(
                f"velocity_filter.order: expected less than the {length} samples of the window (window_s {window_s} at "
                f"sampling_rate_hz {self.sampling_rate_hz}), got {order}; lower it or raise velocity_filter.window_s"
            )
        if length > self.samples:
            raise ValueError(
                f"velocity_filter.window_s: expected a window that a trial of {self.samples} samples (trial_s "
                f"{self.trial_s} at sampling_rate_hz {self.sampling_rate_hz}) can hold, "
                f"got {window_s}; lower it or raise trial_s"
            )
        return self

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints, in order."""
        return [joint.name for joint in self.joints]

    @property
    def muscle_names(self) -> list[str]:
        """Names of the muscles, in order."""
        return [muscle.name for muscle in self.muscles]

    @property
    def muscles_by_joint(self) -> dict[str, list[str]]:
        """Names of the muscles of each joint."""
        return {joint: [each.name for each in self.muscles if each.joint == joint] for joint in self.joint_names}

    @property
    def joint_of_muscle(self) -> list[int]:
        """Index of each muscle's joint."""
        return [self.joint_names.index(muscle.joint) for muscle in self.muscles]

    @property
    def samples(self) -> int:
        """Samples of one trial."""
        return round(self.trial_s * self.sampling_rate_hz)
