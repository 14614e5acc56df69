"""A driven oscillator: m y'' + d y' + k y = input, told by its gain, natural frequency and damping ratio."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from stages.science.plant.effect import Signals, Values
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.linear_guess import regress
from stages.science.plant.motion_plant import Guess, MotionConstants, MotionPlant, Pull
from stages.science.signals.trajectories import Array


class OscillatorConstants(MotionConstants):
    """Constants of m y'' + d y' + k y = input."""

    static_gain: NominalConstant = Field(description="output at rest over input")
    natural_frequency_hz: NominalConstant = Field(description="natural frequency without damping")
    damping_ratio: NominalConstant = Field(description="damping over the critical")
    input_offset: NominalConstant = Field(description="what is added to the measured input")
    output_offset: NominalConstant = Field(description="what the sensor adds to the motion")

    @model_validator(mode="after")
    def _check_possible(self) -> Self:
        frequency, damping = self.natural_frequency_hz.low, self.damping_ratio.low
        if frequency is not None and frequency <= 0.0:
            raise ValueError(f"natural_frequency_hz: expected low above 0 Hz, got {frequency}")
        if damping is not None and damping < 0.0:
            raise ValueError(f"damping_ratio: expected low of at least 0, got {damping}")
        return self


class Oscillator(MotionPlant):
    """Everything that simulating a driven oscillator takes."""

    ELEMENT: ClassVar[str] = "oscillator"
    FREE: ClassVar[bool] = True

    input: str
    constants: OscillatorConstants

    def pull(self, signals: Signals, constants: Values) -> Pull:
        """Return what the drive brings, the spring, and the damper."""
        omega = 2.0 * np.pi * constants["natural_frequency_hz"]
        push = omega**2 * constants["static_gain"] * (signals[self.input] + constants["input_offset"])
        return Pull(push, omega**2, 2.0 * constants["damping_ratio"] * omega, constants["output_offset"])

    def guess(self, derivatives: Mapping[str, Sequence[Array]], skipped: int) -> Guess:
        """Return the constants of the linear model that agrees best with filtered records beside friction."""
        inputs, outputs = derivatives[self.input], derivatives[self.output]
        rows = [
            np.stack([u[:, 0], -y[:, 1], -y[:, 0], one[:, 0], -np.sign(y[:, 1])], axis=1)
            for u, y, one in zip(inputs, outputs, derivatives[""], strict=True)
        ]
        push, damping, hold, _, _ = regress(rows, [y[:, 2] for y in outputs], skipped)
        return self._bound(derivatives, push, damping, hold)

    def _bound(self, derivatives: Mapping[str, Sequence[Array]], push: float, damping: float, hold: float) -> Guess:
        inputs, outputs = derivatives[self.input], derivatives[self.output]
        omega = float(np.sqrt(hold)) if hold > 0.0 else 1.0 / self.know("time_scale_s")
        hertz, ratio = omega / (2.0 * np.pi), float(np.clip(0.5 * damping / omega, 0.005, 1.5))
        largest, swing = max(float(np.abs(u[:, 0]).max()) for u in inputs) or 1.0, self.know("output_scale")
        gain = push / omega**2 if abs(push) > 0.0 else swing / max(largest, 1e-12)
        usual = max(abs(gain), swing / largest)
        far = max(swing, abs(float(np.mean(np.concatenate([y[:, 0] for y in outputs])))))
        return {
            "static_gain": (gain, -20.0 * usual, 20.0 * usual, usual),
            "natural_frequency_hz": (hertz, 0.1 * hertz, 10.0 * hertz, 0.5 * hertz),
            "damping_ratio": (ratio, 0.0005, 3.0, max(ratio, 0.1)),
            "input_offset": (0.0, -largest, largest, 0.2 * largest),
            "output_offset": (0.0, -2.0 * far, 2.0 * far, 0.5 * far),
        }

    def respond(self, features: Array, step_s: float) -> Array:
        """Return features both as they are and as the linear oscillator answers to them, (T, K, 2 F)."""
        from scipy.signal import lfilter

        constants = self.starts
        angle = 2.0 * np.pi * constants["natural_frequency_hz"] * step_s
        ratio = min(constants["damping_ratio"], 0.99)
        decay = np.exp(-ratio * angle)
        recursion = [1.0, -2.0 * decay * np.cos(angle * np.sqrt(1.0 - ratio**2)), decay**2]
        answer = lfilter([0.0, 1.0], recursion, features, axis=0)
        return np.concatenate([features, answer / np.maximum(answer.std(axis=(0, 1)), 1e-300)], axis=2)


class SecondOrder(Oscillator):
    """The driven oscillator by itself."""

    kind: Literal["second_order"]


PLANT = SecondOrder
