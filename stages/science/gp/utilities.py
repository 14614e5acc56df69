"""What one more measurement at a point would tell: the point utilities, by name.

Predictive terms flow in, nats (or a variance) flow out. V is the variance of f at theta_MAP, Vm the marginal GP's,
sn^2 the noise; q is what uncertain hyperparameters add, q = dm' S dm + dV' S dV / (3 V), so that Vm = 4/3 V + q. A
measurement is normal around m with the log variance l = log(V + sn^2), and theta moves both.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from stages.science.gp.kernel import Array


@dataclass(frozen=True)
class PredictiveTerms:
    """Predictive terms of B points, in standard units of the output (squared), and nats.

    Parameters
    ----------
    variance : (B,) float array
        V.
    hyperparameter_variance : (B,) float array
        q.
    noise_variance : float
        sn^2.
    mean_variance : (B,) float array
        dm' S dm: how theta ~ N(theta_MAP, S) moves m, to first order.
    variance_slope, noise_slope : (P, B) and (P,) float arrays
        R' dV, 0 where V is no more than rounding, and R' d(sn^2), with R R' = S.
    """

    variance: Array
    hyperparameter_variance: Array
    noise_variance: float
    mean_variance: Array
    variance_slope: Array
    noise_slope: Array

    @property
    def log_variance_variance(self) -> Array:
        """How theta moves l, to first order: dl' S dl, (B,)."""
        slope = (self.variance_slope + self.noise_slope[:, None]) / (self.variance + self.noise_variance)
        return np.asarray(np.einsum("pb,pb->b", slope, slope))

    @property
    def marginal_variance(self) -> Array:
        """Vm, of f (Garnett, Osborne and Hennig 2014)."""
        return 4.0 / 3.0 * self.variance + self.hyperparameter_variance


def y_y(terms: PredictiveTerms) -> Array:
    """Information of a measurement: 1/2 log((Vm + sn^2) / (V + sn^2))."""
    return 0.5 * np.log((terms.marginal_variance + terms.noise_variance) / (terms.variance + terms.noise_variance))


def f_f(terms: PredictiveTerms) -> Array:
    """Information of the noise-free value: 1/2 log(Vm / V)."""
    return 0.5 * np.log(terms.marginal_variance / terms.variance)


def f_y(terms: PredictiveTerms) -> Array:
    """Noise-free marginal over noisy plain variance: 1/2 log(Vm / (V + sn^2)); not an information, kept to compare."""
    return 0.5 * np.log(terms.marginal_variance / (terms.variance + terms.noise_variance))


def y_y_theta(terms: PredictiveTerms) -> Array:
    """Information of a measurement about the hyperparameters alone: 1/2 log(1 + q / (V + sn^2))."""
    return 0.5 * np.log1p(terms.hyperparameter_variance / (terms.variance + terms.noise_variance))


def hyperparameter_information(terms: PredictiveTerms) -> Array:
    """Information about all hyperparameters, the noise's too: 1/2 log(1 + dm' S dm / s^2 + 1/2 dl' S dl), s^2 = exp(l).

    It is H[y] - E H[y | theta] where y is taken for normal with the variance that it has over theta, to first order in
    S s^2 (1 + 1/2 dl' S dl) + dm' S dm, and log s^2 is l on average. To that order it is exact: 1/2 tr S F with the
    Fisher information F = dm dm' / s^2 + 1/2 dl dl' of a normal measurement. Beyond, it is too high, as y is not
    normal: by (dl' S dl)^2 / 8 + 3/4 (dm' S dl)^2 / s^2 to second order.
    """
    by_mean = terms.mean_variance / (terms.variance + terms.noise_variance)
    return 0.5 * np.log1p(by_mean + 0.5 * terms.log_variance_variance)


def variance(terms: PredictiveTerms) -> Array:
    """Control: the plain variance V."""
    return terms.variance


UTILITIES: Mapping[str, Callable[[PredictiveTerms], Array]] = {
    each.__name__: each for each in (y_y, f_f, f_y, y_y_theta, hyperparameter_information, variance)
}
"""Point utilities by name; ``log_det`` scores whole trajectories, see `trajectory_utility`."""
