"""A person who moves in the machine: what they intend, and how stiffly and shakily they follow it.

A reference and a generator flow in; the intended movement and the torque that pushes beside it come out.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.signals.noise import band_noise, select_band
from stages.science.signals.trajectories import Array


class Participant(Declared):
    """One person, in numbers that hold for any set of joints."""

    delay_s: float = Field(ge=0.0, description="from what is shown to what is intended, s; shorter than a trial")
    gain: float = Field(gt=0.0, le=10.0, description="intended over shown excursion from mid-range, 1")
    noise_rad: float = Field(ge=0.0, le=1.6, description="standard deviation of the intention's wander, rad")
    noise_hz: PositiveFloat = Field(description="highest frequency of the wander, Hz; below half the sampling rate")
    tremor_rad_per_s2: float = Field(
        ge=0.0, le=1e4, description="standard deviation of tremor, angular acceleration, rad/s^2"
    )
    tremor_low_hz: PositiveFloat = Field(description="lowest frequency of tremor, Hz")
    tremor_high_hz: PositiveFloat = Field(description="highest frequency of tremor, Hz; below half the sampling rate")
    strength: PositiveFloat = Field(description="strength, multiples of the joint's strength_nm, 1")
    stiffness_per_rad: PositiveFloat = Field(description="stiffness over the joint's strength_nm, 1/rad")
    damping_ratio: PositiveFloat = Field(description="damping over critical damping of the joint's inertia, 1")
    compensation_s: PositiveFloat = Field(description="time constant by which a held load is compensated, s")

    @model_validator(mode="after")
    def _order_band(self) -> Self:
        if self.tremor_low_hz > self.tremor_high_hz:
            raise ValueError(
                f"tremor_low_hz: expected at most tremor_high_hz, {self.tremor_high_hz}, got {self.tremor_low_hz}; "
                "lower it or raise tremor_high_hz"
            )
        return self

    def check_against(self, exoskeleton: Exoskeleton, samples: int) -> Self:
        """Return the participant if what they do shows in a trial of so many samples, with what is held before it.

        A `ValueError` tells a frequency at or above half the sampling rate (Shannon's theorem), a band between the
        frequencies that a trial resolves, and a delay as long as a trial.
        """
        rate = exoskeleton.sampling_rate_hz
        bands = {"noise_hz": (0.0, self.noise_hz), "tremor_high_hz": (self.tremor_low_hz, self.tremor_high_hz)}
        for name, (low_hz, high_hz) in bands.items():
            if high_hz >= 0.5 * rate:
                raise ValueError(
                    f"{name}: expected less than half of exoskeleton.sampling_rate_hz, {0.5 * rate}, got {high_hz}; "
                    "lower it or raise that"
                )
            if not select_band(samples, rate, low_hz, high_hz).any():
                raise ValueError(
                    f"{name}: expected a band that holds a multiple of {0.5 * rate / samples:.3g} Hz, which trials "
                    f"of exoskeleton.trial_s={exoskeleton.trial_s} resolve, got {low_hz} to {high_hz} Hz; widen it"
                )
        if self.delay_s >= exoskeleton.trial_s:
            raise ValueError(
                f"delay_s: expected less than exoskeleton.trial_s, {exoskeleton.trial_s}, got {self.delay_s}; lower it"
            )
        return self


class Person(NamedTuple):
    """Constants of a person at one joint, as the integrator takes them; zeros for nobody."""

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    compensation_per_s: float
    strength_nm: float


class Intention(NamedTuple):
    """What a person does over time, (T, J) arrays."""

    angle_rad: Array
    velocity_rad_per_s: Array
    push_nm: Array


def embody(participant: Participant, exoskeleton: Exoskeleton) -> list[Person]:
    """Return a participant's constants at each joint."""
    people = []
    for joint in exoskeleton.joints:
        stiffness = participant.stiffness_per_rad * joint.strength_nm
        damping = 2.0 * participant.damping_ratio * math.sqrt(stiffness * joint.inertia_kg_m2)
        strength = participant.strength * joint.strength_nm
        people.append(Person(stiffness, damping, 1.0 / participant.compensation_s, strength))
    return people


def nobody(exoskeleton: Exoskeleton) -> list[Person]:
    """Return the constants of a limb that does nothing."""
    return [Person(0.0, 0.0, 0.0, 0.0) for _ in exoskeleton.joints]


def intend(
    participant: Participant, exoskeleton: Exoskeleton, reference_rad: Array, generator: np.random.Generator
) -> Intention:
    """Return what a person intends when shown a reference, (T, J) joint angles.

    The reference is delayed (its start is held), scaled about the middle of the joint's range, and wanders.
    """
    rate = exoskeleton.sampling_rate_hz
    samples, joints = reference_rad.shape
    middle, inertia = np.array([(0.5 * (j.lower_rad + j.upper_rad), j.inertia_kg_m2) for j in exoskeleton.joints]).T
    time_s = np.arange(samples) / rate
    delayed = np.stack([np.interp(time_s - participant.delay_s, time_s, column) for column in reference_rad.T], axis=1)
    wander = band_noise(generator, samples, joints, rate, 0.0, participant.noise_hz)
    tremor = band_noise(generator, samples, joints, rate, participant.tremor_low_hz, participant.tremor_high_hz)
    angle = middle + participant.gain * (delayed - middle) + participant.noise_rad * wander
    push = participant.tremor_rad_per_s2 * inertia * tremor
    return Intention(angle, np.gradient(angle, 1.0 / rate, axis=0), push)


def rest(exoskeleton: Exoskeleton, samples: int) -> Intention:
    """Return the intention of nobody: none."""
    zeros = np.zeros((samples, len(exoskeleton.joints)))
    return Intention(zeros, zeros.copy(), zeros.copy())
