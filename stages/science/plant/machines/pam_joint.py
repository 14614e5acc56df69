"""An antagonistic pneumatic joint: two muscles pull at it, and what they hold it with grows with their pressures.

A muscle's force is a pressure times a line in its contraction (the first-order McKibben law: Chou, Hannaford, IEEE
Trans. Robot. Autom. 12, 1996), so that the difference of pressures turns the joint and their sum makes it stiff:
y'' = gain (p1 - p2) + bias - (stiffness + stiffening (p1 + p2)) y - damping y'. All are over the joint's inertia, which
pressures and motion alone do not tell.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from stages.science.plant.effect import Signals, Values
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.linear_guess import regress
from stages.science.plant.motion_plant import Guess, MotionConstants, MotionPlant, Pull
from stages.science.signals.trajectories import Array

VARIED = 0.01
"""Deviation of the sum of pressures, over its mean, from which it tells how much it stiffens."""


class JointConstants(MotionConstants):
    """Constants of the textbook joint, over its inertia."""

    gain: NominalConstant = Field(description="acceleration over the difference of pressures")
    bias: NominalConstant = Field(description="acceleration at equal pressures in the middle: gravity, unlike muscles")
    stiffness: NominalConstant = Field(description="of the joint without pressure")
    stiffening: NominalConstant = Field(description="what the sum of pressures adds to it")
    damping: NominalConstant = Field(description="deceleration over velocity")


class PamJoint(MotionPlant):
    """Everything that simulating an antagonistic joint takes."""

    QUANTITIES: ClassVar = {"pressures": ("pressure",), "output": ("angle",)}

    kind: Literal["pam_joint"]
    pressures: list[str] = Field(min_length=2, max_length=2, description="raises the output, lowers it")
    constants: JointConstants

    def pull(self, signals: Signals, constants: Values) -> Pull:
        """Return what the muscles bring and hold."""
        raising, lowering = (signals[name] for name in self.pressures)
        push = constants["gain"] * (raising - lowering) + constants["bias"]
        hold = constants["stiffness"] + constants["stiffening"] * (raising + lowering)
        return Pull(push, hold, constants["damping"], 0.0)

    def guess(self, derivatives: Mapping[str, Sequence[Array]], skipped: int) -> Guess:
        """Return the constants that agree best with filtered records beside friction.

        Stiffening is told where the sum of pressures changes.
        """
        raising, lowering = ([each[:, 0] for each in derivatives[name]] for name in self.pressures)
        outputs = derivatives[self.output]
        sums = np.concatenate([a + b for a, b in zip(raising, lowering, strict=True)])
        total = float(sums.mean())
        both = zip(raising, lowering, outputs, derivatives[""], strict=True)
        rows = [
            np.stack([a - b, one[:, 0], -y[:, 0], -y[:, 1], -(a + b - total) * y[:, 0], -np.sign(y[:, 1])], axis=1)
            for a, b, y, one in both
        ]
        gain, bias, hold, damping, stiffening, _ = map(float, regress(rows, [y[:, 2] for y in outputs], skipped))
        per_pace = 1.0 / self.time_scale_s if self.time_scale_s else 1.0
        hold = hold if hold > 0.0 else per_pace**2
        damping = damping if damping > 0.0 else per_pace
        most = hold / max(total, 1e-12)
        stiffening = min(max(stiffening, 0.0), most) if sums.std() > VARIED * abs(total) else 0.5 * most
        swing = self.output_scale or 1.0
        push = max(abs(bias), hold * swing)
        return {
            "gain": (gain, -50.0 * abs(gain), 50.0 * abs(gain), abs(gain)),
            "bias": (bias, -50.0 * push, 50.0 * push, push),
            "stiffness": (hold - stiffening * total, 0.0, 50.0 * hold, hold),
            "stiffening": (stiffening, 0.0, 50.0 * most, most),
            "damping": (damping, 0.0, 50.0 * max(damping, per_pace), max(damping, per_pace)),
        }


PLANT = PamJoint
