"""The machine and the person behind the device, in real time and in a process of its own.

Commanded pressures flow in through shared memory and announced trials through a pipe; at each of the exoskeleton's
samples counts of all sensors flow out.
"""

from __future__ import annotations

from collections import deque
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from stages.plant.chain import Chain
from stages.plant.participant import embody, intend, nobody, rest
from stages.plant.stepping import Steps
from stages.rig import clock
from stages.rig.movement import move_freely
from stages.signals.trajectories import Array
from tests.cpx_e.machine import Machine
from tests.cpx_e.shared import Shared

HELD_S = 2.0
"""History of commands that an idle machine knows; valves settle within it."""
GLIDE_S = 0.8
"""Time in which a joint is brought to the middle after a trial."""
LEAD_SHARE = 0.4
"""Share of what is held before a trial in which encoders are shown on the way to the first posture."""
NEWEST, OLDEST = 0.1, 0.5
"""Share of a sample by which a client's write should come before a tick, so that what it reads before it is new."""
NUDGE, FURTHEST = 0.02, (-0.7, 0.3)
"""Share of a sample by which a tick may move for that, and how far from the trial's clock ticks may go."""


class Idle:
    """Nobody moves; joints stand in the middle, or go there."""

    def __init__(self, machine: Machine, angle_rad: Array, command_kpa: Array):
        exoskeleton = machine.exoskeleton
        self.exoskeleton = exoskeleton
        self.chain = Chain(exoskeleton, machine.plant)
        middle = _middle(machine)
        glide = max(round(GLIDE_S * exoskeleton.sampling_rate_hz), 1)
        left = [angle_rad + (middle - angle_rad) * _ease(k / glide) for k in range(1, glide + 1)]
        self.way = deque(left if np.abs(middle - angle_rad).max() > 1e-9 else [middle])
        held = max(round(HELD_S * exoskeleton.sampling_rate_hz), 2)
        self.command = deque([np.array(command_kpa)], maxlen=held)
        self.angles = deque([np.array(angle_rad)], maxlen=held)
        self._sense()

    def step(self, command_kpa: Array) -> None:
        self.command[-1] = np.array(command_kpa)
        self.command.append(np.array(command_kpa))
        self.angles.append(self.way.popleft() if len(self.way) > 1 else self.way[0])
        self._sense()

    def _sense(self) -> None:
        constants = self.chain.constants
        angle = np.array(self.angles)
        column = np.array(self.exoskeleton.joint_of_muscle)
        velocity = np.gradient(angle, axis=0) / self.chain.step_s if len(angle) > 1 else np.zeros_like(angle)
        self.pressure = self.chain.pressurise(np.array(self.command))
        self.contraction = constants.contraction_at_angle_0 + constants.contraction_per_rad * angle[:, column]
        self.rate = constants.contraction_per_rad * velocity[:, column]
        self.force, self.tension = self.chain.pull(self.pressure, self.contraction, self.rate)
        self.angle = angle[-1]


class Moving:
    """A trial: the person does what was announced, and the machine acts on them.

    As in `SimulatedRig`, it begins at rest in the first posture, with muscles settled there. Encoders do not jump to
    it: over the first part of what is held before the trial they are shown on the way there.
    """

    def __init__(self, machine: Machine, trial: dict[str, Any], angle_rad: Array, command_kpa: Array):
        exoskeleton = machine.exoskeleton
        lead, samples = int(trial["lead_samples"]), int(trial["samples"])
        generator = np.random.default_rng(trial.get("seed", 0))
        start = _middle(machine)
        if trial["kind"] == "passive":
            intention, person = rest(exoskeleton, lead + samples), nobody(exoskeleton)
        else:
            name = trial["participant"]
            who = machine.experimenter if name == "experimenter" else machine.participants[name]
            shown = trial.get("reference_rad")
            if shown is None:
                shown = move_freely(machine.movement, exoskeleton, samples, generator)
            shown = np.asarray(shown, dtype=float)
            held = np.concatenate([np.repeat(shown[:1], lead, axis=0), shown])
            intention = intend(who, exoskeleton, held, generator)
            person = embody(who, exoskeleton)
            start = intention.angle_rad[0]
        self.steps = Steps(exoskeleton, machine.plant, intention, person, start)
        self.steps.begin(command_kpa)
        self.apart, self.glide = angle_rad - start, round(LEAD_SHARE * lead)

    def step(self, command_kpa: Array) -> None:
        if not self.steps.over:
            self.steps.step(command_kpa)

    @property
    def over(self) -> bool:
        return self.steps.over

    def __getattr__(self, name: str) -> Array:
        found = getattr(self.steps, name)[: self.steps.at + 1]
        if name != "angle":
            return found
        return found[-1] + self.apart * (1.0 - _ease(self.steps.at / self.glide)) if self.glide else found[-1]


class Physics:
    """What the sensors show, one sample after another.

    Parameters
    ----------
    machine : Machine
        All of it.
    """

    def __init__(self, machine: Machine):
        self.machine = machine
        self.generator = np.random.default_rng(machine.seed)
        models = [machine.plant.model_of(muscle) for muscle in machine.exoskeleton.muscles]
        self.pressure_noise = np.array([each.pressure_noise_kpa for each in models])
        self.force_noise = np.array([each.force_noise_n for each in models])
        self.channels = [channel for _, channel in machine.sensors().values()]
        signals = [effect.signal for effect in Chain(machine.exoskeleton, machine.plant).effects]
        self.sensed = [signal for signal in signals if signal in ("sensed_pressure_kpa", "sensed_force_n")]
        self.run_rad = np.zeros(len(machine.exoskeleton.joints))
        self.now: Idle | Moving = Idle(machine, _middle(machine), np.zeros(len(models)))
        self._forget()

    def announce(self, trial: dict[str, Any], command_kpa: Array) -> None:
        """Begin a trial."""
        if trial["do"] == "end":
            if isinstance(self.now, Moving):
                self.now = Idle(self.machine, self.now.angle, command_kpa)
        else:
            self.now = Moving(self.machine, trial, self.now.angle, command_kpa)
        self._forget()

    def step(self, command_kpa: Array) -> None:
        """Go on by one sample."""
        if isinstance(self.now, Moving) and self.now.over:
            self.now = Idle(self.machine, self.now.angle, command_kpa)
            self._forget()
        self.now.step(command_kpa)

    def show(self, run_rad_per_s: Array) -> list[int]:
        """Return the counts of all sensors; an encoder that runs away does so at a speed."""
        chain = self.now.chain if isinstance(self.now, Idle) else self.now.steps.chain
        pressure, force = self.now.pressure, self.now.force
        if self.machine.exoskeleton.load_cell_site == "joint_end":
            force = self.now.tension
        shape = self.pressure_noise.shape
        self.noise.append(
            (
                self.pressure_noise * self.generator.standard_normal(shape),
                self.force_noise * self.generator.standard_normal(shape),
            )
        )
        noisy_pressure, noisy_force = self._add_noise(pressure, 0), self._add_noise(force, 1)
        if "sensed_pressure_kpa" in self.sensed:
            noisy_pressure = chain.sense_pressure(noisy_pressure)
        if "sensed_force_n" in self.sensed:
            shown = chain.sense_force(noisy_force, pressure, self.now.contraction, self.now.rate)
        else:
            shown = noisy_force + chain.constants.force_offset_n
        encoder = self.machine.plant.encoder
        self.run_rad = np.where(run_rad_per_s == 0.0, 0.0, self.run_rad + run_rad_per_s * chain.step_s)
        angle = self.now.angle + encoder.noise_rad * self.generator.standard_normal(self.run_rad.shape) + self.run_rad
        values = [*noisy_pressure[-1], *np.maximum(shown[-1], 0.0), *angle]
        return [channel.to_count(float(value)) for channel, value in zip(self.channels, values, strict=True)]

    def _forget(self) -> None:
        self.noise: deque[tuple[Array, Array]] = deque(maxlen=100_000)

    def _add_noise(self, values: Array, kind: int) -> Array:
        noisy = values.copy()
        known = [each[kind] for each in self.noise][-len(noisy) :] if self.sensed else [self.noise[-1][kind]]
        noisy[len(noisy) - len(known) :] += np.array(known)
        return noisy


class Plant:
    """Keeps the machine going at the exoskeleton's rate.

    A tick takes the commands that were held when it was due. Ticks keep away from the instants at which a client
    writes, so that a loop at the exoskeleton's rate has one tick between any two of its writes.

    Parameters
    ----------
    machine : Machine
        All of it.
    shared : Shared
        Where commands are found and counts are shown.
    """

    def __init__(self, machine: Machine, shared: Shared):
        self.physics, self.shared = Physics(machine), shared
        self.step_s = 1.0 / machine.exoskeleton.sampling_rate_hz
        self.due_s, self.apart = clock.now_s(), 0.0

    def announce(self, trial: dict[str, Any]) -> None:
        """Begin a trial, or end one."""
        self.physics.announce(trial, self.shared.ordered_at(trial["heard_s"]))
        self.shared.publish(self.physics.show(self.shared.run_rad_per_s))
        self.due_s, self.apart = trial["heard_s"] + self.step_s, 0.0

    def tick(self) -> float:
        """Take the ticks that are due, if any is; return the time until the next one, s."""
        begun = clock.now_s()
        if begun < self.due_s:
            return self.due_s - begun
        late = min(int((begun - self.due_s) / self.step_s), 10_000)
        for missed in range(late + 1):
            self.physics.step(self.shared.ordered_at(self.due_s + missed * self.step_s))
        self.shared.publish(self.physics.show(self.shared.run_rad_per_s))
        cost = clock.now_s() - begun
        self.shared.costs_s[:] = cost, max(cost, self.shared.costs_s[1]), self.shared.costs_s[2] + cost
        self.due_s += (late + 1 + self._nudge()) * self.step_s
        return max(self.due_s - clock.now_s(), 0.0)

    def _nudge(self) -> float:
        """Return by how much of a sample the next tick moves away from a client's writes."""
        age = (self.due_s - self.shared.written_s[0]) / self.step_s
        nudge = 0.0
        if abs(age) < 1.0 and not NEWEST <= age % 1.0 <= OLDEST:
            nudge = NUDGE if age % 1.0 < NEWEST else -NUDGE
        nudge = min(max(nudge, FURTHEST[0] - self.apart), FURTHEST[1] - self.apart)
        self.apart += nudge
        return nudge


def run(machine: Machine, shared: Shared, announced: Connection) -> None:
    """Keep the machine going for ever, in a process of its own."""
    plant = Plant(machine, shared)
    while True:
        if announced.poll(plant.tick()):
            plant.announce(announced.recv())
            announced.send("ready")


def _middle(machine: Machine) -> Array:
    return np.array([0.5 * (joint.lower_rad + joint.upper_rad) for joint in machine.exoskeleton.joints])


def _ease(share: float) -> float:
    share = min(share, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
