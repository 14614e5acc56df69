"""One session of measurements: a machine, what is imposed on it, and the noise that lies on it.

Flows in: a seed, the number of trials, where the load cell sits. Flows out: ``Session``; ``observe`` runs it with
whatever effects are given. Machine, kinematics, commands and noise have a stream of random numbers each, so that an
effect changes nothing but itself.
"""

from dataclasses import dataclass

import numpy as np

from stages.benchmark.blinded_rig.chain import (
    OVERSAMPLED,
    RATE_HZ,
    Carried,
    Readings,
    Stimulus,
    fine_time,
    read,
    run_chain,
)
from stages.benchmark.blinded_rig.excitation import command_pressures
from stages.benchmark.blinded_rig.machine import (
    JOINT_OF_MUSCLE,
    Array,
    Machine,
    arm_over_length,
    build_machine,
    sheet_column,
)
from stages.benchmark.blinded_rig.person import move_joints
from stages.benchmark.blinded_rig.sensors import Noise, draw_noise, read_encoder
from stages.benchmark.blinded_rig.signals import LoadCellSite

TRIAL_S = 4.0
REST_S = (12.0, 36.0)


@dataclass(frozen=True)
class Session:
    """Machine, stimulus and noise; the encoder's columns as measured: angles (2, ...), contractions (4, ...)."""

    machine: Machine
    stimulus: Stimulus
    noise: Noise
    load_cell_site: LoadCellSite
    joint_rad: Array
    joint_rad_per_s: Array

    @property
    def contraction(self) -> Array:
        """From the encoder and the drawing, (4, trials, samples)."""
        zero = sheet_column("contraction_at_angle_0")[:, None, None]
        return zero + arm_over_length()[:, None, None] * self.joint_rad[JOINT_OF_MUSCLE]

    @property
    def contraction_velocity_per_s(self) -> Array:
        """From the encoder's speed and the drawing, 1/s."""
        return arm_over_length()[:, None, None] * self.joint_rad_per_s[JOINT_OF_MUSCLE]


def build_session(
    seed: int, trials: int, load_cell_site: LoadCellSite, *, varied: bool = True, noisy: bool = True
) -> Session:
    """Build a seed's session; ``varied=False``: the data sheet's machine; ``noisy=False``: ideal sensors."""
    for_machine, for_person, for_commands, for_noise, for_clock = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,))) for stream in range(5)
    )
    samples = round(TRIAL_S * RATE_HZ)
    gaps = TRIAL_S + for_clock.uniform(*REST_S, trials - 1)
    start_s = np.round(np.concatenate([[0.0], np.cumsum(gaps)]), 1)
    time_s = fine_time(samples)
    joint_rad = move_joints(for_person, trials, time_s)
    command = command_pressures(for_commands, trials, np.arange(samples) / RATE_HZ)
    noise = draw_noise(for_noise, start_s, samples, 1.0 / RATE_HZ)
    noise = noise if noisy else noise.silenced()
    shown = joint_rad[..., np.searchsorted(time_s, -1e-9) :: OVERSAMPLED]
    angle, speed = read_encoder(shown, 1.0 / RATE_HZ, noise)
    return Session(
        build_machine(for_machine, varied), Stimulus(command, joint_rad, start_s), noise, load_cell_site, angle, speed
    )


def observe(session: Session, carried: Carried) -> Readings:
    """Return what the sensors show of the session with these effects."""
    ideal = run_chain(session.machine, session.stimulus, carried, session.load_cell_site)
    return read(ideal, session.noise, session.machine, carried)
