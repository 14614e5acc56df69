"""The machine and the person behind the device, as time passes.

Commanded pressures and announced trials flow in; at each of the exoskeleton's samples counts of all sensors flow out.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from stages.science.plant.chain import Chain
from stages.science.plant.participant import embody, intend, nobody, rest
from stages.science.plant.stepping import Steps
from stages.science.rig import clock
from stages.science.rig.excitation import move_freely
from stages.science.signals.trajectories import Array
from tests.cpx_e.machine import Faults, Machine

REMEMBERED = 256
"""Commands that are remembered, so that a machine that is late still knows when each was written."""
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
        self.chain = Chain(exoskeleton, machine.plant)
        self.of_muscle = np.array(exoskeleton.joint_of_muscle)
        taus = np.array(
            [machine.plant.find_model(muscle.name, muscle.type).valve_tau_s for muscle in exoskeleton.muscles]
        )
        self.share = 1.0 - np.exp(-self.chain.step_s / taus)
        self.start, self.middle = angle_rad, _middle(machine)
        self.steps, self.glide = 0, round(GLIDE_S * exoskeleton.sampling_rate_hz)
        self.angle, self.pressure = angle_rad, np.array(command_kpa)
        self._pull(angle_rad)

    def step(self, command_kpa: Array) -> None:
        self.pressure = self.pressure + self.share * (command_kpa - self.pressure)
        self.steps += 1
        self._pull(self.start + (self.middle - self.start) * _ease(self.steps / self.glide))

    def _pull(self, angle_rad: Array) -> None:
        constants = self.chain.constants
        rate = constants.contraction_per_rad * ((angle_rad - self.angle) / self.chain.step_s)[self.of_muscle]
        self.angle = angle_rad
        contraction = constants.contraction_at_angle_0 + constants.contraction_per_rad * angle_rad[self.of_muscle]
        force, _ = self.chain.pull(self.pressure[None], contraction[None], rate[None])
        self.force = force[0]


class Moving:
    """A trial: the person does what was announced, and the machine acts on them.

    As in `SimulatedRig`, it begins at rest in the first posture, with muscles settled there. Encoders do not jump to
    it: over the first part of what is held before the trial they are shown on the way there.
    """

    def __init__(self, machine: Machine, trial: dict[str, Any], angle_rad: Array, command_kpa: Array):
        exoskeleton = machine.exoskeleton
        lead, samples = trial["lead_samples"], trial["samples"]
        generator = np.random.default_rng(trial["seed"])
        start = _middle(machine)
        if trial["kind"] == "passive":
            intention, person = rest(exoskeleton, lead + samples), nobody(exoskeleton)
        else:
            name = trial["participant"]
            who = machine.experimenter if name == "experimenter" else machine.participants[name]
            shown = trial["reference_rad"]
            if shown is None:
                shown = move_freely(machine.movement, exoskeleton, samples, generator)
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

    @property
    def pressure(self) -> Array:
        return self.steps.pressure[self.steps.at]

    @property
    def force(self) -> Array:
        return self.steps.force[self.steps.at]

    @property
    def angle(self) -> Array:
        found = self.steps.angle[self.steps.at]
        return found + self.apart * (1.0 - _ease(self.steps.at / self.glide)) if self.glide else found


class Plant:
    """Keeps a machine without effects going at the exoskeleton's rate, and tells the counts of all sensors.

    A tick takes the commands that were held when it was due. Ticks keep away from the instants at which a client
    writes, so that a loop at the exoskeleton's rate has one tick between any two of its writes. Faults of valves and
    joints are put in here.
    """

    def __init__(self, machine: Machine, faults: Faults):
        self.machine, self.faults = machine, faults
        self.generator = np.random.default_rng(machine.seed)
        models = [machine.plant.find_model(muscle.name, muscle.type) for muscle in machine.exoskeleton.muscles]
        self.noise = np.array([(each.pressure_noise_kpa, each.force_noise_n) for each in models]).T
        self.channels = [channel for _, channel in machine.sensors().values()]
        self.step_s = 1.0 / machine.exoskeleton.sampling_rate_hz
        self.due_s, self.apart, self.written_s = clock.now_s(), 0.0, 0.0
        self.commands: deque[tuple[float, list[float]]] = deque(maxlen=REMEMBERED)
        self.run_rad = np.zeros(len(machine.exoskeleton.joints))
        self.now: Idle | Moving = Idle(machine, _middle(machine), np.zeros(len(models)))
        self._show()

    def announce(self, trial: dict[str, Any], heard_s: float) -> None:
        if trial["do"] == "trial":
            self.now = Moving(self.machine, trial, self.now.angle, self._ordered_at(heard_s))
        elif isinstance(self.now, Moving):
            self.now = Idle(self.machine, self.now.angle, self._ordered_at(heard_s))
        self._show()
        self.due_s, self.apart = heard_s + self.step_s, 0.0

    def tick(self) -> float:
        """Take the ticks that are due, if any is; return the time until the next one, s."""
        begun = clock.now_s()
        if begun < self.due_s:
            return self.due_s - begun
        late = min(int((begun - self.due_s) / self.step_s), 10_000)
        for missed in range(late + 1):
            command_kpa = self._ordered_at(self.due_s + missed * self.step_s)
            if isinstance(self.now, Moving) and self.now.over:
                self.now = Idle(self.machine, self.now.angle, command_kpa)
            self.now.step(command_kpa)
        self._show()
        self.due_s += (late + 1 + self._nudge()) * self.step_s
        return max(self.due_s - clock.now_s(), 0.0)

    def _ordered_at(self, at_s: float) -> Array:
        """Return the pressures, kPa, that valves gave at a time: the commanded ones, or those of a faulty valve."""
        before = (kpa for given_s, kpa in reversed(self.commands) if given_s <= at_s)
        given = dict(zip(self.machine.exoskeleton.muscle_names, next(before, self.commands[0][1]), strict=True))
        return np.array([*(given | {each["muscle"]: each["kpa"] for each in self.faults.now("overpressure")}).values()])

    def _show(self) -> None:
        """Have sensors count anew; an encoder that runs away does so at a speed."""
        draw, (pressure_noise_kpa, force_noise_n) = self.generator.standard_normal, self.noise
        pressure = self.now.pressure + draw(len(pressure_noise_kpa)) * pressure_noise_kpa
        force = self.now.force + draw(len(force_noise_n)) * force_noise_n
        given = {each["joint"]: each["rad_per_s"] for each in self.faults.now("overspeed")}
        runs = np.array([given.get(name, 0.0) for name in self.machine.exoskeleton.joint_names])
        self.run_rad = np.where(runs == 0.0, 0.0, self.run_rad + runs * self.step_s)
        angle = self.now.angle + self.machine.plant.encoder.noise_rad * draw(len(runs)) + self.run_rad
        values = [*pressure, *np.maximum(force, 0.0), *angle]
        self.counts = [channel.to_count(float(value)) for channel, value in zip(self.channels, values, strict=True)]

    def _nudge(self) -> float:
        """Return by how much of a sample the next tick moves away from a client's writes."""
        age = (self.due_s - self.written_s) / self.step_s
        moved = self.apart
        if abs(age) < 1.0 and not NEWEST <= age % 1.0 <= OLDEST:
            moved += NUDGE if age % 1.0 < NEWEST else -NUDGE
        before, self.apart = self.apart, min(max(moved, FURTHEST[0]), FURTHEST[1])
        return self.apart - before


def _middle(machine: Machine) -> Array:
    return np.array([0.5 * (joint.lower_rad + joint.upper_rad) for joint in machine.exoskeleton.joints])


def _ease(share: float) -> float:
    share = min(share, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
