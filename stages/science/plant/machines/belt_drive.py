"""A pulley on a springy belt that a motor drives: an oscillator behind a first-order lag.

Told by the oscillator's gain, natural frequency and damping ratio, and the motor's time constant (Wigren, Schoukens,
Coupled electric drives data set and reference models, Uppsala University report 2017-024, 2017).
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from stages.science.plant.effect import Signals, Values
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.filters import lag
from stages.science.plant.linear_guess import regress
from stages.science.plant.machines.second_order import Oscillator, OscillatorConstants
from stages.science.plant.motion_plant import Guess, Pull
from stages.science.signals.trajectories import Array


class BeltConstants(OscillatorConstants):
    """Constants of T y''' + ... = input: those of the oscillator, and T."""

    drive_lag_s: NominalConstant = Field(description="time constant with which the drive follows its input")


class BeltDrive(Oscillator):
    """Everything that simulating a motor, a springy belt and a pulley takes."""

    ELEMENT: ClassVar[str] = "pulley"
    ORDER: ClassVar[int] = 3
    FREE: ClassVar[bool] = False

    kind: Literal["belt_drive"]
    constants: BeltConstants

    def pull(self, signals: Signals, constants: Values) -> Pull:
        """Return what the drive brings, late, the belt, and what damps it."""
        return super().pull(signals, constants)._replace(lag_s=constants["drive_lag_s"])

    def guess(self, derivatives: Mapping[str, Sequence[Array]], skipped: int) -> Guess:
        """Return the constants of the linear model of third order that agrees best with filtered records."""
        inputs, outputs = derivatives[self.input], derivatives[self.output]
        rows = [
            np.stack([u[:, 0], -y[:, 2], -y[:, 1], -y[:, 0], one[:, 0]], axis=1)
            for u, y, one in zip(inputs, outputs, derivatives[""], strict=True)
        ]
        push, *below, _ = regress(rows, [y[:, 3] for y in outputs], skipped)
        roots = np.roots([1.0, *below])
        pole = -float(min(roots[np.isreal(roots)].real, key=abs))
        pace_s = self.know("time_scale_s")
        slowest_s = float(np.clip(1.0 / pole, 0.05 * pace_s, 20.0 * pace_s)) if pole > 0.0 else pace_s
        told = self._bound(derivatives, slowest_s * push, below[0] - 1.0 / slowest_s, slowest_s * below[2])
        return {**told, "drive_lag_s": (slowest_s, 0.02 * pace_s, 50.0 * pace_s, max(slowest_s, pace_s))}

    def respond(self, features: Array, step_s: float) -> Array:
        """Return features both as they are and as the linear machine answers to them, (T, K, 2 F)."""
        flat = features.reshape(len(features), -1)
        late = lag(flat, self.starts["drive_lag_s"], step_s).reshape(features.shape)
        answers = super().respond(late, step_s)[..., features.shape[-1] :]
        return np.concatenate([features, answers], axis=2)


PLANT = BeltDrive
