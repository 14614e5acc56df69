"""Coloured measurement noise: white noise beside two wandering components, and the filter that makes it white.

Residuals of several trials flow in; out flow the noise's constants and whitened signals. The two components are
Ornstein-Uhlenbeck processes that start anew in every trial: a quick one, as filters of sensors leave it, and a slow
one, as temperature and posture do. A residual's log density under them is that of a Kalman filter's innovations.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stages.science.output_channels.output_channel import DetectionSettings
from stages.science.signals.trajectories import Array

QUICK_S, SLOW_S = 0.03, 1.5
"""Prior medians of the time constants of the two components, s; one standard deviation is a factor of three."""
FOLD = math.log(3.0)
NOTHING = 1e-12
"""Standard deviation, in the channel's unit, of a component that is not there."""


class Noise(NamedTuple):
    """Standard deviations in the channel's unit and time constants in seconds."""

    white: float
    quick: float
    quick_s: float
    slow: float
    slow_s: float

    @property
    def is_white(self) -> bool:
        """Whether it is white noise alone."""
        return max(self.quick, self.slow) <= NOTHING


def make_plain(spread: float) -> Noise:
    """Return white noise alone."""
    return Noise(max(spread, 1e-9), NOTHING, 0.03, NOTHING, 1.0)


@njit(cache=True, error_model="numpy", nogil=True)
def _whiten_trials(values: Array, present: NDArray[np.bool_], noise: Array, step_s: float) -> tuple[Array, Array]:
    samples, trials, columns = values.shape
    white = np.zeros_like(values)
    log_scale = np.zeros(trials)
    r = noise[0] ** 2
    v1, v2 = noise[1] ** 2, noise[3] ** 2
    a1, a2 = math.exp(-step_s / noise[2]), math.exp(-step_s / noise[4])
    q1, q2 = v1 * (1.0 - a1 * a1), v2 * (1.0 - a2 * a2)
    state = np.zeros((2, columns))
    for k in range(trials):
        p11, p12, p22 = v1, 0.0, v2
        state[:] = 0.0
        for t in range(samples):
            if t > 0:
                p11, p12, p22 = a1 * a1 * p11 + q1, a1 * a2 * p12, a2 * a2 * p22 + q2
                for j in range(columns):
                    state[0, j] *= a1
                    state[1, j] *= a2
            if not present[t, k]:
                continue
            c1, c2 = p11 + p12, p12 + p22
            s = c1 + c2 + r
            g1, g2 = c1 / s, c2 / s
            scale = 1.0 / math.sqrt(s)
            log_scale[k] += 0.5 * math.log(s)
            for j in range(columns):
                innovation = values[t, k, j] - state[0, j] - state[1, j]
                white[t, k, j] = innovation * scale
                state[0, j] += g1 * innovation
                state[1, j] += g2 * innovation
            p11, p12, p22 = p11 - g1 * c1, p12 - g1 * c2, p22 - g2 * c2
    return white, log_scale


def whiten(values: Array, present: NDArray[np.bool_], noise: Noise, step_s: float) -> Array:
    """Return signals as the noise's innovations, each over its standard deviation; linear in them, without a unit.

    Values are those of Q signals in K trials of T samples, (T, K, Q); where not present, (T, K), nothing is taken in
    and zero comes out.
    """
    return np.asarray(_whiten_trials(np.ascontiguousarray(values), present, np.array(noise), step_s)[0])


def log_density(residual: Array, present: NDArray[np.bool_], noise: Noise, step_s: float) -> Array:
    """Return the log density of each trial's residual, (K,) ndarray, up to the constant of the normal density."""
    white, log_scale = _whiten_trials(np.ascontiguousarray(residual[:, :, None]), present, np.array(noise), step_s)
    return np.asarray(-0.5 * (white**2).sum(axis=(0, 2)) - log_scale)


def estimate_noise(residual: Array, present: NDArray[np.bool_], step_s: float, limits: DetectionSettings) -> Noise:
    """Return the noise that a residual most likely is, under weak priors on its constants.

    White noise has a lower bound: without it a residual would be judged by its steps alone, and a simulation whose
    steps come one sample early or late would be worse than one without steps.

    The residual is what a flexible model leaves, (T, K), ignored where not present; a `ValueError` says that fewer than
    ten samples are present.
    """
    from scipy.optimize import minimize

    if present.sum() < 10:
        raise ValueError(f"noise: expected at least 10 samples, got {int(present.sum())}")
    values = np.where(present, residual, 0.0)
    spread = max(float(np.sqrt(np.mean(values[present] ** 2))), 1e-12)
    centre = np.array([math.log(0.5), math.log(0.4), math.log(QUICK_S), math.log(0.4), math.log(SLOW_S)])
    width = np.array([1.5, 1.5, FOLD, 1.5, FOLD])

    def build(z: Array) -> Noise:
        white, quick, quick_s, slow, slow_s = np.exp(z)
        return Noise(spread * white, spread * quick, quick_s, spread * slow, slow_s)

    def cost(z: Array) -> float:
        return float(0.5 * (((z - centre) / width) ** 2).sum() - log_density(values, present, build(z), step_s).sum())

    bounds = [(c - 4.0 * w, c + 4.0 * w) for c, w in zip(centre, width, strict=True)]
    bends = values[2:] - 2.0 * values[1:-1] + values[:-2]
    bends = bends[present[2:] & present[1:-1] & present[:-2]]
    rough = float(np.sqrt((bends**2).mean() / 6.0)) if bends.size else 0.0  # white noise of such second differences
    least = math.log(max(limits.least_white * rough / spread, limits.least_white_share))
    bounds[0] = (max(bounds[0][0], min(least, 0.0)), bounds[0][1])
    centre[0] = max(centre[0], bounds[0][0])
    found = minimize(cost, centre, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40, "ftol": 1e-6})
    return build(found.x)
