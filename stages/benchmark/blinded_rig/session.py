"""One session of measurements: a machine, what is imposed on it, and the noise that lies on it.

Flows in: a seed, the number of trials, where the load cell sits. Flows out: ``Session``; ``observe`` runs it with
whatever effects are given. Machine, kinematics, commands and noise have a stream of random numbers each, so that an
effect changes nothing but itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from stages.benchmark.blinded_rig.chain import (
    RATE_HZ,
    STEP_S,
    Carried,
    Readings,
    Stimulus,
    fine_time,
    read,
    run_chain,
)
from stages.benchmark.blinded_rig.disturbances import disturb, ripple
from stages.benchmark.blinded_rig.excitation import command_pressures
from stages.benchmark.blinded_rig.laws import build_law
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
from stages.benchmark.blinded_rig.signals import LoadCellSite, Signals
from stages.benchmark.blinded_rig.surroundings import SEED_OFFSET, CatalogueName, Surroundings, draw_surroundings

TRIAL_S = 4.0
REST_S = (12.0, 36.0)
FURTHER = 8
"""Stream of random numbers of further trials."""


@dataclass(frozen=True)
class Session:
    """Machine, stimulus and noise; the encoder's columns as measured: angles (2, ...), contractions (4, ...)."""

    machine: Machine
    stimulus: Stimulus
    noise: Noise
    load_cell_site: LoadCellSite
    joint_rad: Array
    joint_rad_per_s: Array
    surroundings: Surroundings | None = None

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.stimulus.rate_hz

    def as_read(self, readings: Readings) -> "Session":
        """Return the session with the encoder's columns of these readings, where an effect changed them."""
        if readings.joint_rad is None or readings.joint_rad_per_s is None:
            return self
        return replace(self, joint_rad=readings.joint_rad, joint_rad_per_s=readings.joint_rad_per_s)

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
    seed: int,
    trials: int,
    load_cell_site: LoadCellSite,
    *,
    varied: bool = True,
    noisy: bool = True,
    catalogue: CatalogueName = "own",
) -> Session:
    """Build a seed's session; ``varied=False``: the data sheet's machine; ``noisy=False``: ideal sensors and supply.

    A foreign catalogue's sessions have surroundings of their own, and none of their seeds is another catalogue's.
    """
    for_machine, for_person, for_commands, for_noise, for_clock, for_surroundings, for_law, for_disturbances = (
        np.random.default_rng(np.random.SeedSequence(seed + SEED_OFFSET[catalogue], spawn_key=(stream,)))
        for stream in range(8)
    )
    around = None if catalogue == "own" else draw_surroundings(catalogue, for_surroundings)
    rate_hz = RATE_HZ if around is None else around.rate_hz
    samples, oversampled = round(TRIAL_S * rate_hz), round(1.0 / (STEP_S * rate_hz))
    gaps = TRIAL_S + for_clock.uniform(*REST_S, trials - 1)
    start_s = np.round(np.concatenate([[0.0], np.cumsum(gaps)]), 1)
    time_s = fine_time(samples, oversampled)
    joint_rad = move_joints(for_person, trials, time_s)
    command = command_pressures(for_commands, trials, np.arange(samples) / rate_hz)
    noise = draw_noise(for_noise, start_s, samples, 1.0 / rate_hz)
    machine, stimulus = build_machine(for_machine, varied), Stimulus(command, joint_rad, start_s, rate_hz)
    if around is not None:
        machine = replace(machine, law=build_law(around.law, for_law))
        noise = disturb(noise, around, for_disturbances, start_s, 1.0 / rate_hz)
        waves = ripple(for_disturbances, around, start_s, time_s)
        stimulus = replace(stimulus, ripple_kpa=waves if noisy else None)
    noise = noise if noisy else noise.silenced()
    angle, speed = read_encoder(sampled(joint_rad, time_s, oversampled), 1.0 / rate_hz, noise)
    return Session(machine, stimulus, noise, load_cell_site, angle, speed, around)


def prescribe(
    session: Session, seed: int, command_kpa: Array, joint_rad: Array, step_s: float, pause_s: float
) -> Session:
    """Return the machine's further trials, some time after its last, with noise of their own.

    Commands (4, J, n), kPa, and angles (2, J, n), rad, are given every `step_s`; the person holds still before.
    """
    count, samples = command_kpa.shape[1], round(command_kpa.shape[2] * step_s * session.rate_hz)
    start_s = session.stimulus.start_s[-1] + pause_s * np.arange(1, count + 1)
    given_s = step_s * np.arange(command_kpa.shape[2])
    time_s = fine_time(samples, session.stimulus.oversampled)
    inside_s = np.clip(time_s, 0.0, given_s[-1])
    motion = CubicSpline(given_s, joint_rad, axis=-1)(inside_s)
    at = np.minimum(
        np.searchsorted(given_s, np.arange(samples) / session.rate_hz + 1e-9, "right") - 1, given_s.size - 1
    )
    for_noise, for_disturbances = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream, round(start_s[0] * 10.0))))
        for stream in (FURTHER, FURTHER + 1)
    )
    noise = draw_noise(for_noise, start_s, samples, 1.0 / session.rate_hz)
    stimulus = replace(session.stimulus, command_kpa=command_kpa[..., at], joint_rad=motion, start_s=start_s)
    if session.surroundings is not None:
        noise = disturb(noise, session.surroundings, for_disturbances, start_s, 1.0 / session.rate_hz)
        waves = ripple(for_disturbances, session.surroundings, start_s, time_s)
        stimulus = replace(stimulus, ripple_kpa=waves)
    angle, speed = read_encoder(sampled(motion, time_s, session.stimulus.oversampled), 1.0 / session.rate_hz, noise)
    return replace(session, stimulus=stimulus, noise=noise, joint_rad=angle, joint_rad_per_s=speed)


def sampled(joint_rad: Array, time_s: Array, oversampled: int) -> Array:
    """Angles (2, trials, fine samples) at the sampling instants."""
    return joint_rad[..., np.searchsorted(time_s, -1e-9) :: oversampled]


def observe(session: Session, carried: Carried) -> Readings:
    """Return what the sensors show of the session with these effects."""
    ideal = run_chain(session.machine, session.stimulus, carried, session.load_cell_site)
    readings = read(ideal, session.noise, session.machine, carried, session.stimulus.oversampled)
    on_encoder = [(effect, size) for effect, size in carried if effect.site == "angle_wire" and size.any()]
    return read_angles(session, readings, on_encoder) if on_encoder else readings


def read_angles(session: Session, readings: Readings, carried: Carried) -> Readings:
    """Return the readings with what the encoder shows where these effects lie on its channel."""
    stimulus = session.stimulus
    time_s = fine_time(stimulus.command_kpa.shape[-1], stimulus.oversampled)
    nothing, joint_rad = np.empty(0), stimulus.joint_rad
    for effect, size in carried:
        signals = Signals(session.machine, STEP_S, time_s, stimulus.start_s, joint_rad, nothing)
        joint_rad = effect.act(signals, size[:, None, None])
    shown = sampled(joint_rad, time_s, stimulus.oversampled)
    angle, speed = read_encoder(shown, 1.0 / session.rate_hz, session.noise)
    return replace(readings, joint_rad=angle, joint_rad_per_s=speed)
