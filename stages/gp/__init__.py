"""Active Gaussian-process regression with uncertain hyperparameters: the science of choosing what to measure.

A `Hyperprior` and standardised data flow into `fit`, which returns a `MarginalGP` at the MAP of its hyperparameters
(`condition` rebuilds one from a recorded theta). The model predicts, knows how uncertain hyperparameters spread its
predictions, and scores points by the `UTILITIES`; `trajectory_utility` scores a whole bank, `subsample` picks the
samples of a recording. `Interaction` ties them into Algorithm 1: ask for a trajectory, tell what was recorded.

`draw_models` with `point_information` and `path_information` estimate by Monte Carlo what the utilities approximate.
For many data, `fit_sparse` returns a `SparseGP` of a few pseudo-inputs, which predicts alike; a `SparseMarginalGP`
scores alike too, and a `SparseInteraction` runs Algorithm 1 on all samples of every trial.

Inside, data flow `kernel` -> `factor` -> `posterior` -> `estimation` -> `laplace` -> `marginal` -> `utilities`;
`marginal` predicts through `prediction`, whose matrix products are those of `distance` and `triangle`.
"""

from stages.gp.factor import FactorisationError
from stages.gp.hyperprior import Hyperprior
from stages.gp.interaction import Design, Interaction
from stages.gp.knowledge import Choice, Knowledge
from stages.gp.laplace import Laplace
from stages.gp.marginal import MarginalGP, condition, fit
from stages.gp.marginal_model import MarginalModel
from stages.gp.mutual_information import Information, draw_models, path_information, point_information
from stages.gp.posterior import LogPosterior
from stages.gp.scoring import trajectory_utility
from stages.gp.sparse import SparsePosterior, SparseSlopes
from stages.gp.sparse_fit import fit_sparse
from stages.gp.sparse_interaction import SparseDesign, SparseInteraction
from stages.gp.sparse_marginal import SparseMarginalGP, condition_sparse
from stages.gp.sparse_model import SparseGP, predict_weighted
from stages.gp.subsample import subsample
from stages.gp.utilities import UTILITIES

__all__ = [
    "UTILITIES",
    "Choice",
    "Design",
    "FactorisationError",
    "Hyperprior",
    "Information",
    "Interaction",
    "Knowledge",
    "Laplace",
    "LogPosterior",
    "MarginalGP",
    "MarginalModel",
    "SparseDesign",
    "SparseGP",
    "SparseInteraction",
    "SparseMarginalGP",
    "SparsePosterior",
    "SparseSlopes",
    "condition",
    "condition_sparse",
    "draw_models",
    "fit",
    "fit_sparse",
    "path_information",
    "point_information",
    "predict_weighted",
    "subsample",
    "trajectory_utility",
]
