"""The plant one sample after another: the equations of `interact`, solved as commands come.

The command of each sample flows in, the state at the next sample flows out. Valves and effects are evaluated over all
samples since the trial began; the joints' integrator goes on from where it was. `interact` feeds back what effects do
to the tension by passes over the trial; here each sample is passed over, beginning with what the sample before had.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stages.science.plant.chain import Chain
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.interaction import Motion, follow
from stages.science.plant.joint import advance, balance, drive_joints
from stages.science.plant.participant import Intention, Person
from stages.science.plant.plant import Plant
from stages.science.signals.trajectories import Array

PASSES = 2


class Steps:
    """A trial that is simulated as it goes; it ends with the intention, and its arguments are those of `interact`."""

    def __init__(
        self, exoskeleton: Exoskeleton, plant: Plant, intention: Intention, person: Sequence[Person], start_rad: Array
    ):
        self.chain = Chain(exoskeleton, plant)
        self.driven = drive_joints(exoskeleton, plant, self.chain.constants, person, self.chain.step_s)
        self.of_muscle = np.array(exoskeleton.joint_of_muscle)
        self.aims = np.stack(intention, axis=1)  # (T, 3, J)
        samples, joints, muscles = len(self.aims), len(self.driven), len(self.of_muscle)
        self.on = [self.of_muscle == j for j in range(joints)]
        self.inputs = [np.empty((3, 3, int(on.sum()))) for on in self.on]
        self.command = np.zeros((samples, muscles))
        self.drive = np.zeros((samples, 3, muscles))
        self.pressure = self.drive[:, 0]
        self.angle, self.velocity = (np.zeros((samples, joints)) for _ in range(2))
        self.force, self.tension = (np.zeros((samples, muscles)) for _ in range(2))
        self.states = np.stack([start_rad, np.zeros_like(start_rad), np.zeros_like(start_rad)], axis=1)
        self.at = 0

    @property
    def over(self) -> bool:
        """Whether the last sample is there."""
        return self.at + 1 >= len(self.aims)

    def aim(self, angle_rad: Array, velocity_rad_per_s: Array) -> None:
        """Have the person intend a posture (J,) and its rate from the next sample on."""
        self.aims[self.at + 1 :, 0] = angle_rad
        self.aims[self.at + 1 :, 1] = velocity_rad_per_s

    def collect(self) -> Motion:
        """Return the motion, as far as the trial is."""
        part = slice(self.at + 1)
        return replace(self.motion, force_n=self.force[part], tension_n=self.tension[part])

    def begin(self, command_kpa: Array) -> None:
        """Set the first sample: muscles filled to a command, joints at rest, the person in balance."""
        self.command[0] = command_kpa
        self.pressure[0] = self.chain.pressurise(self.command[:1])[0]
        self._settle(0, self.states)
        for j, (on, driven) in enumerate(zip(self.on, self.driven, strict=True)):
            self.states[j, 2] = balance(self.states[j, 0], np.ascontiguousarray(self.drive[:1, :, on]), driven)

    def step(self, command_kpa: Array) -> None:
        """Go on by one sample, over which a command was held."""
        now, after = self.at, self.at + 1
        self.command[now : after + 1] = command_kpa
        self.pressure[after] = self.chain.pressurise(self.command[: after + 1])[after]
        self.drive[after, 1:] = self.drive[now, 1:]
        for _ in range(PASSES if self.chain.bends_force else 1):
            states = np.array([self._move(now, j) for j in range(len(self.driven))])
            self._settle(after, states)
        self.states = states
        self.at = after

    def _move(self, now: int, j: int) -> tuple[float, float, float]:
        both = slice(now, now + 2)
        drive, aims = (
            np.ascontiguousarray(each) for each in (self.drive[both][:, :, self.on[j]], self.aims[both, :, j])
        )
        return advance(tuple(self.states[j]), drive, aims, 0, self.driven[j], self.inputs[j])

    def _settle(self, at: int, states: Array) -> None:
        """Note a sample's motion, its tensions, and what effects do to them."""
        self.angle[at], self.velocity[at] = states[:, 0], states[:, 1]
        pressure, angle, velocity = (each[: at + 1] for each in (self.pressure, self.angle, self.velocity))
        self.motion, rest, drag = follow(self.chain, self.of_muscle, pressure, angle, velocity, since=at)
        found = (self.motion.force_n, self.motion.tension_n, rest, drag)
        self.force[at], self.tension[at], self.drive[at, 1], self.drive[at, 2] = (each[0] for each in found)
