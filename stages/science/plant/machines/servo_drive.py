"""An electro-mechanical drive: a mass that a measured force moves, M q'' = force, with nothing that holds or damps it.

Friction is no textbook constant here: it is what such a model misses.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from stages.science.plant.effect import Effect, Signals, Values
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.linear_guess import regress
from stages.science.plant.motion_plant import Guess, MotionConstants, MotionPlant, Pull
from stages.science.plant.record_plant import Watched
from stages.science.signals.trajectories import Array

MOVING, FEWEST_MOVING = 0.1, 100
"""Velocity over the largest, above which a drive moves; and samples of which its mass is guessed, at least."""
SMOOTHED = 0.1
"""Width of the window by which a measured motion is smoothed, paces."""


class DriveConstants(MotionConstants):
    """Constants of the textbook drive."""

    mass: NominalConstant = Field(description="force over acceleration")
    force_offset: NominalConstant = Field(description="what the amplifier adds to the force, or gravity")


class ServoDrive(MotionPlant):
    """Everything that simulating a drive takes."""

    drifts: ClassVar[bool] = True
    FILTER: ClassVar[float] = 0.03

    QUANTITIES: ClassVar = {"force": ("torque", "current"), "output": ("angle", "length")}

    kind: Literal["servo_drive"]
    force: str
    constants: DriveConstants

    def find_lacking(self, effect: Effect) -> str:
        """Return what lacks for an effect: an offset of the sensor is that of the place in which a record begins."""
        return "a place that is known before a record begins" if effect.name == "sensor_offset" else ""

    def pull(self, signals: Signals, constants: Values) -> Pull:
        """Return force over mass."""
        push = (signals[self.force] + constants["force_offset"]) / constants["mass"]
        return Pull(push, 0.0, 0.0, 0.0)

    def guess(self, derivatives: Mapping[str, Sequence[Array]], skipped: int) -> Guess:
        """Return the mass that filtered records show beside friction and springs, and no offset."""
        rows = [
            np.stack([f[:, 0], one[:, 0], -q[:, 1], -np.sign(q[:, 1]), -q[:, 0], -(q[:, 0] ** 3)], axis=1)
            for f, one, q in zip(derivatives[self.force], derivatives[""], derivatives[self.output], strict=True)
        ]
        per_mass = regress(*_leave_out_rest(rows, derivatives[self.output], skipped), 0)[0]
        largest = max(float(np.abs(f[:, 0]).max()) for f in derivatives[self.force])
        quickest = max(float(np.abs(q[skipped:, 2]).max(initial=0.0)) for q in derivatives[self.output])
        mass = 1.0 / per_mass if per_mass > 0.0 else largest / max(quickest, 1e-12)
        return {"mass": (mass, 0.05 * mass, 20.0 * mass, mass), "force_offset": (0.0, -largest, largest, 0.2 * largest)}

    def watch(self, signals: Signals, step_s: float, constants: Values) -> list[Watched]:
        """Return the measured motion, smoothed, its velocity and the force: without friction a simulated one drifts."""
        from scipy.ndimage import gaussian_filter1d

        width = max(SMOOTHED * self.know("time_scale_s") / step_s, 1.0)
        return self.list_watched(gaussian_filter1d(signals[self.output], width, axis=0), signals, step_s)

    def respond(self, features: Array, step_s: float) -> Array:
        """Return features as they are, and where they would push the mass, (T, K, 2 F), beside any steady motion."""
        pushed = np.cumsum(np.cumsum(features.reshape(len(features), -1), axis=0), axis=0)
        steady = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(features)), 2))[0]
        answer = (pushed - steady @ (steady.T @ pushed)).reshape(features.shape)
        return np.concatenate([features, answer / np.maximum(answer.std(axis=(0, 1)), 1e-300)], axis=2)


def _leave_out_rest(rows: Sequence[Array], outputs: Sequence[Array], skipped: int) -> tuple[list[Array], list[Array]]:
    """Return columns and accelerations of samples in which the drive moves: at rest, friction takes up any force."""
    fastest = max(float(np.abs(q[skipped:, 1]).max(initial=0.0)) for q in outputs)
    moves = [(np.abs(q[:, 1]) > MOVING * fastest) & (np.arange(len(q)) >= skipped) for q in outputs]
    if sum(each.sum() for each in moves) < FEWEST_MOVING:
        moves = [np.arange(len(q)) >= min(skipped, len(q) // 2) for q in outputs]
    kept = list(zip(rows, outputs, moves, strict=True))
    return [each[k] for each, _, k in kept], [q[k, 2] for _, q, k in kept]


PLANT = ServoDrive
