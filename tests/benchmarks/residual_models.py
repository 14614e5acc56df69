"""Plain models of what a simulation leaves of a channel: sparse regression, a Gaussian process and boosted trees.

Features of samples, (N, P) and (N, Q), flow in with the residual, (N,), and the number of each sample's trial; a
function that predicts the residual of other samples flows out. Hyperparameters are chosen by trials that are left out.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from stages.science.output_channels.features import TURNING
from stages.science.output_channels.muscle_channels import ForceChannel, MuscleChannel
from stages.science.plant.learned_map import DRIVES
from stages.science.signals.trajectories import Array

LAGS_S = (0.02, 0.05, 0.1, 0.2)
"""Delays at which the simulator's inputs are known besides, s."""
NEIGHBOURS_LAG_S = 0.1
"""Delay at which the other muscles' drives are known besides, s."""
FOLDS = 4
"""Groups of neighbouring trials that are left out in turn."""
POINTS, TUNED = 1000, 250
"""Samples, drawn at random, that a Gaussian process is fitted to, and that its hyperparameters are found from."""
CLIMB = 30
"""Iterations of the search for a Gaussian process's hyperparameters."""
DEGREES, THRESHOLDS, RIDGES = (1, 2, 3), (0.02, 0.05, 0.1, 0.2), (0.05, 20.0)
"""Degrees of the polynomials, thresholds and ridges of sparse regression; features and residual have unit variance."""
LEAVES, LEAST_SAMPLES = (6, 24), 40
"""Leaves of a tree, and least number of samples in each of them."""

Indices = NDArray[np.intp]
Rule = Callable[["Features"], Array]


@dataclass(frozen=True)
class Features:
    """Features of N samples.

    `present`, (N, P), are the simulator's inputs, what it simulates, and the direction of motion; `beside`, (N, Q), the
    inputs' past, what drives other muscles, and time.
    """

    present: Array
    beside: Array

    @property
    def all(self) -> Array:
        """Both, (N, P + Q)."""
        return np.hstack([self.present, self.beside])

    def take(self, rows: Indices) -> "Features":
        """Return the features of some samples."""
        return Features(self.present[rows], self.beside[rows])


def build_features(output: MuscleChannel, simulated: Array) -> Features:
    """Return the features of all samples of a channel, (T * K, ...), whose nominal simulation is (T, K)."""
    inputs, direction = list_inputs(output, simulated)
    delays = [max(round(each / output.step_s), 1) for each in LAGS_S]
    past = [delay(signal, samples) for signal in inputs for samples in delays]
    within = np.broadcast_to((np.arange(len(simulated)) * output.step_s)[:, None], simulated.shape)
    neighbours = list_neighbours(output)
    before = [delay(signal, max(round(NEIGHBOURS_LAG_S / output.step_s), 1)) for signal in neighbours]
    beside = [*past, *neighbours, *before, within, within + output.start_s]
    return Features(stack([*inputs, simulated, direction]), stack(beside))


def list_inputs(output: MuscleChannel, simulated: Array) -> tuple[list[Array], Array]:
    """Return the simulator's inputs, and on which side of a reversal it is: of the joint, or of the valve's flow."""
    records = output.records
    if isinstance(output, ForceChannel):
        velocity = records.velocity_per_s
        inputs = [records.smooth_pressure_kpa, records.contraction, velocity]
        return inputs, np.tanh(velocity / (TURNING * velocity.std()))
    flow = records.command_kpa - simulated
    return [records.command_kpa], np.tanh(flow / (TURNING * flow.std()))


def list_neighbours(output: MuscleChannel) -> list[Array]:
    """Return what drives the other muscles, and for a force its own muscle's command."""
    others = [values for name, values in output.records.others.items() if name.endswith(f" {DRIVES[output.channel]}")]
    return [*others, output.records.command_kpa] if isinstance(output, ForceChannel) else others


def delay(signal: Array, samples: int) -> Array:
    """Return each column so many samples later, its first value held."""
    return np.concatenate([np.repeat(signal[:1], samples, axis=0), signal[:-samples]])


def stack(signals: Sequence[Array]) -> Array:
    """Return signals (T, K) as columns (T * K, F)."""
    return np.stack([each.ravel() for each in signals], axis=1)


def leave_out(trials: Indices) -> Iterator[tuple[Indices, Indices]]:
    """Yield the samples to fit and those left out, a group of neighbouring trials at a time."""
    for group in np.array_split(np.unique(trials), FOLDS):
        left_out = np.isin(trials, group)
        yield np.flatnonzero(~left_out), np.flatnonzero(left_out)


def zero(features: Features) -> Array:
    """Return no correction."""
    return np.zeros(len(features.present))


def keep_if_better(rule: Rule, left: float, residual: Array) -> Rule:
    """Return a rule if it leaves less of trials left out, a sum of squares, than there is; else no correction."""
    return rule if left < float(residual @ residual) else zero


def fit_sindy(features: Features, residual: Array, trials: Indices) -> Rule:
    """Return a sparse sum of terms: polynomials of `present`, and `beside` as it is (pysindy).

    Degree, threshold and ridge are those that leave least of trials left out.
    """
    scale = float(residual.std())
    best: tuple[float, Rule] = (np.inf, zero)
    for degree in DEGREES:
        library = Library(features, degree)
        terms = library.evaluate(features)
        folds = [(compress(terms[kept], residual[kept] / scale), aside) for kept, aside in leave_out(trials)]
        for threshold, ridge in product(THRESHOLDS, RIDGES):
            weights = [regress(*reduced, threshold, ridge) for reduced, _ in folds]
            errors = [residual[aside] - scale * terms[aside] @ w for w, (_, aside) in zip(weights, folds, strict=True)]
            left = sum(float(error @ error) for error in errors)
            if left < best[0]:
                own = scale * regress(*compress(terms, residual / scale), threshold, ridge)
                best = left, partial(combine, library, own)
    return keep_if_better(best[1], best[0], residual)


class Library:
    """Terms of a sparse regression, each over its deviation in the samples that it is made of."""

    def __init__(self, features: Features, degree: int) -> None:
        from pysindy import PolynomialLibrary

        self.middle, self.spread = find_scale(features.all)
        self.powers = PolynomialLibrary(degree=degree)
        self.powers.fit([self._standardise(features).present])
        terms = self._list_terms(features)
        self.deviation = np.where(terms.std(axis=0) > 0.0, terms.std(axis=0), 1.0)

    def evaluate(self, features: Features) -> Array:
        """Return the terms, (N, F)."""
        return self._list_terms(features) / self.deviation

    def _list_terms(self, features: Features) -> Array:
        standard = self._standardise(features)
        return np.hstack([np.asarray(self.powers.transform(standard.present)), standard.beside])

    def _standardise(self, features: Features) -> Features:
        values = (features.all - self.middle) / self.spread
        return Features(*np.split(values, [features.present.shape[1]], axis=1))


def find_scale(values: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation of each column; 1 where it is constant."""
    spread = values.std(axis=0)
    return values.mean(axis=0), np.where(spread > 0.0, spread, 1.0)


def compress(terms: Array, residual: Array) -> tuple[Array, Array]:
    """Return as many rows as there are terms, with the same least-squares solutions as all rows."""
    basis, triangle = np.linalg.qr(terms)
    return triangle, basis.T @ residual


def regress(terms: Array, residual: Array, threshold: float, ridge: float) -> Array:
    """Return the weights of sequentially thresholded least squares."""
    from pysindy import STLSQ

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where a threshold cuts all
        fitted = STLSQ(threshold=threshold, alpha=ridge).fit(terms, residual)
    return np.asarray(fitted.coef_[0])


def combine(library: Library, weights: Array, features: Features) -> Array:
    """Return the weighted sum of a library's terms."""
    return library.evaluate(features) @ weights


def fit_gaussian_process(features: Features, residual: Array, trials: Indices) -> Rule:
    """Return a Gaussian process of all features, a length scale each and white noise (scikit-learn).

    Hyperparameters maximise the marginal likelihood of some samples; more of them are then fitted.
    """
    middle, spread = find_scale(features.all)
    values, scale = (features.all - middle) / spread, float(residual.std())
    target, generator = residual / scale, np.random.default_rng(0)
    everywhere = np.arange(len(values))
    tuned = draw(everywhere, TUNED, generator)
    kernel = tune_kernel(values[tuned], target[tuned])

    def learn(rows: Indices) -> Any:
        drawn = draw(rows, POINTS, generator)
        return start_process(kernel, None).fit(values[drawn], target[drawn])

    errors = [target[aside] - learn(kept).predict(values[aside]) for kept, aside in leave_out(trials)]
    left = scale**2 * sum(float(error @ error) for error in errors)
    found = learn(everywhere)
    return keep_if_better(lambda each: scale * found.predict((each.all - middle) / spread), left, residual)


def draw(rows: Indices, count: int, generator: np.random.Generator) -> Indices:
    """Return at most so many of the rows, in their order."""
    return np.sort(generator.choice(rows, min(count, len(rows)), replace=False))


def tune_kernel(values: Array, target: Array) -> Any:
    """Return the kernel of the largest marginal likelihood, from lengths that suit so many inputs."""
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    inputs = values.shape[1]
    lengths = RBF(np.full(inputs, np.sqrt(inputs)), (0.1, 1e3))
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * lengths + WhiteKernel(0.3, (1e-5, 2.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where an input does not matter, and its length is at the bound
        return start_process(kernel, climb).fit(values, target).kernel_


def start_process(kernel: Any, optimizer: Any) -> Any:
    """Return a process of this kernel, whose fit keeps the kernel where there is no optimizer."""
    from sklearn.gaussian_process import GaussianProcessRegressor

    return GaussianProcessRegressor(kernel, optimizer=optimizer)


def climb(objective: Callable[..., Any], start: Array, bounds: Array) -> tuple[Array, float]:
    """Return where an objective, told with its gradient, is least, and its value there."""
    found = minimize(objective, start, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": CLIMB})
    return found.x, float(found.fun)


def fit_boosted_trees(features: Features, residual: Array, trials: Indices) -> Rule:
    """Return boosted trees of all features (scikit-learn), of the size that leaves least of trials left out."""
    values = features.all
    best: tuple[float, int] = (np.inf, LEAVES[0])
    for leaves in LEAVES:
        left = 0.0
        for kept, aside in leave_out(trials):
            error = residual[aside] - start_trees(leaves).fit(values[kept], residual[kept]).predict(values[aside])
            left += float(error @ error)
        best = min(best, (left, leaves))
    found = start_trees(best[1]).fit(values, residual)
    return keep_if_better(lambda each: np.asarray(found.predict(each.all)), best[0], residual)


def start_trees(leaves: int) -> Any:
    """Return boosted trees of this size that are not fitted."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    return HistGradientBoostingRegressor(
        max_leaf_nodes=leaves, min_samples_leaf=LEAST_SAMPLES, l2_regularization=1.0, early_stopping=False
    )


PEERS: dict[str, Callable[[Features, Array, Indices], Rule]] = {
    "sindy": fit_sindy,
    "gaussian_process": fit_gaussian_process,
    "boosted_trees": fit_boosted_trees,
}
