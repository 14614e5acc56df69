"""How large a hidden effect must be: set by the gap that it leaves after a fit of the nominal constants.

Flows in: a session, an effect, a target ratio. Flows out: sizes per muscle, with the ratio reached and the share that
the nominal constants absorb. The nominal fit is small and linear: pressure = gain lag(command, tau) + offset; force = a
linear regression on [p, p e, p e^2, 1, e, e^2, v] of measured pressure p, contraction e and velocity v. The floor is
the residual of that same fit on the same session, the same noise, without the effect. Where the law is foreign, the fit
stays the textbook's: what it cannot follow is part of the floor, and an effect has to stand out from that.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from stages.benchmark.blinded_rig.chain import RATE_HZ, Readings
from stages.benchmark.blinded_rig.machine import JOINT_OF_MUSCLE, MUSCLES, Array
from stages.benchmark.blinded_rig.session import Session, observe
from stages.benchmark.blinded_rig.signals import Effect

LOG_TAU = (float(np.log(0.01)), float(np.log(0.2)))
RATIOS = {"weak": 1.3, "medium": 2.5, "strong": 6.0}
SHARE_OF_LARGEST = {"weak": 0.25, "medium": 0.5, "strong": 1.0}
UNSEEN = 1.05
CLOSE_ENOUGH = 0.01
HALVINGS = 16
CHANNELS = ("pressure_kpa", "force_n")


@dataclass(frozen=True)
class Size:
    """An effect's size per muscle (4,), the gap over the floor it leaves there, and the share absorbed."""

    size: Array
    ratio: Array
    absorbed: Array
    reached: bool


@dataclass(frozen=True)
class NominalFit:
    """The nominal fit of one session; residuals' RMS per muscle, (4,)."""

    session: Session

    def residual_rms(self, readings: Readings, channel: str) -> Array:
        """RMS of what the fit leaves in one channel, in its unit."""
        if channel == "pressure_kpa":
            return np.array([self.pressure_rms(m, readings) for m in range(len(MUSCLES))])
        return np.array([self.force_rms(m, readings) for m in range(len(MUSCLES))])

    def pressure_rms(self, muscle: int, readings: Readings) -> float:
        """Best over the time constant; gain and offset in closed form."""
        pressure = readings.pressure_kpa[muscle].ravel()

        def left(log_tau: float) -> float:
            return float(np.sqrt(np.mean(self.beyond_lag(muscle, np.exp(log_tau), pressure) ** 2)))

        best = minimize_scalar(left, bounds=LOG_TAU, method="bounded", options={"xatol": 2e-3})
        return float(best.fun)

    def beyond_lag(self, muscle: int, tau_s: float, pressure: Array) -> Array:
        """Pressure less its regression on the lagged command."""
        lagged = lag(self.session.stimulus.command_kpa[muscle], tau_s, self.session.rate_hz).ravel()
        lagged = lagged - lagged.mean()
        centred = pressure - pressure.mean()
        return centred - lagged * (lagged @ centred) / max(lagged @ lagged, 1e-12)

    def force_rms(self, muscle: int, readings: Readings) -> float:
        """Linear regression."""
        same = readings.joint_rad is None and np.array_equal(
            readings.pressure_kpa[muscle], self.without.pressure_kpa[muscle]
        )
        basis = self.bases_without[muscle] if same else self.force_basis(muscle, readings)
        force = readings.force_n[muscle].ravel()
        return float(np.sqrt(np.mean((force - basis @ (basis.T @ force)) ** 2)))

    def force_basis(self, muscle: int, readings: Readings) -> Array:
        """Orthonormal basis of the force's regressors, (trials x samples, 7)."""
        session = self.session.as_read(readings)
        p, e = readings.pressure_kpa[muscle].ravel(), session.contraction[muscle].ravel()
        v = session.contraction_velocity_per_s[muscle].ravel()
        return np.linalg.qr(np.column_stack([p, p * e, p * e**2, np.ones_like(p), e, e**2, v]))[0]

    @cached_property
    def without(self) -> Readings:
        """The session's readings with nothing hidden."""
        return observe(self.session, ())

    @cached_property
    def bases_without(self) -> list[Array]:
        """The force's basis of each muscle with nothing hidden."""
        return [self.force_basis(muscle, self.without) for muscle in range(len(MUSCLES))]

    @cached_property
    def floor(self) -> dict[str, Array]:
        """RMS of the residual without any effect, per channel, (4,)."""
        return {channel: self.residual_rms(self.without, channel) for channel in CHANNELS}

    def ratio(self, readings: Readings, channel: str) -> Array:
        """Residual over floor, (4,)."""
        return self.residual_rms(readings, channel) / self.floor[channel]

    def absorbed(self, readings: Readings, channel: str) -> Array:
        """Share of the effect's own energy that lies in the span of the nominal constants, (4,)."""
        change = getattr(readings, channel) - getattr(self.without, channel)
        return np.array([self.share_spanned(m, rows.ravel(), channel) for m, rows in enumerate(change)])

    def share_spanned(self, muscle: int, change: Array, channel: str) -> float:
        """Energy of the projection over all energy; zero for no change."""
        basis = self.bases_without[muscle] if channel == "force_n" else self.pressure_basis(muscle)
        energy = change @ change
        return float(np.sum((basis.T @ change) ** 2) / energy) if energy else 0.0

    def pressure_basis(self, muscle: int) -> Array:
        """Orthonormal basis of gain, offset and time constant at 40 ms, (trials x samples, 3)."""
        command = self.session.stimulus.command_kpa[muscle]
        lagged, slower = (lag(command, tau, self.session.rate_hz).ravel() for tau in (0.04, 0.0404))
        return np.linalg.qr(np.column_stack([lagged, np.ones_like(lagged), slower - lagged]))[0]


def lag(command_kpa: Array, tau_s: float, rate_hz: float = RATE_HZ) -> Array:
    """Held command (trials, samples) through a first-order lag, read before each command acts."""
    keep = np.exp(-1.0 / (rate_hz * tau_s))
    late = np.concatenate([command_kpa[:, :1], command_kpa[:, :-1]], axis=1)
    return lfilter([1.0 - keep], [1.0, -keep], late, axis=-1, zi=keep * command_kpa[:, :1])[0]


def size_effect(fit: NominalFit, effect: Effect, carries: Array, magnitude: str) -> Size:
    """Sizes that bring the carrying muscles' gap to the magnitude's ratio, by bisection, each muscle on its own.

    Where even the largest size stays below the target, it is taken; where it stays within ``UNSEEN`` of the floor (the
    constants absorb it), the magnitude's share of it.
    """
    target = RATIOS[magnitude]

    if effect.joint_wide:
        carries = np.array([carries[other == JOINT_OF_MUSCLE].max() for other in JOINT_OF_MUSCLE])

    def ratio_at(size: Array) -> Array:
        ratio = fit.ratio(observe(fit.session, ((effect, size),)), effect.channel)
        if effect.joint_wide:
            return np.array([np.exp(np.log(ratio[each == JOINT_OF_MUSCLE]).mean()) for each in JOINT_OF_MUSCLE])
        return ratio

    low, high = effect.largest * 1e-5 * carries, effect.largest * carries
    farthest = ratio_at(high)
    reachable = farthest >= target
    nearest = np.where(farthest > UNSEEN, high, SHARE_OF_LARGEST[magnitude] * high)
    size = np.where(reachable, np.sqrt(low * high), nearest)
    for _ in range(HALVINGS):
        ratio = ratio_at(size)
        off = reachable & (carries > 0.0) & (np.abs(ratio / target - 1.0) > CLOSE_ENOUGH)
        if not off.any():
            break
        low, high = np.where(off & (ratio < target), size, low), np.where(off & (ratio > target), size, high)
        size = np.where(off, np.sqrt(low * high), size)
    readings = observe(fit.session, ((effect, size),))
    reached = bool(np.all(reachable | (carries == 0.0)))
    return Size(size, fit.ratio(readings, effect.channel), fit.absorbed(readings, effect.channel), reached)
