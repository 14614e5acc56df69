"""Active Gaussian-process regression with uncertain hyperparameters: the science of choosing what to measure.

A `Hyperprior` and standardised data flow into `fit`, which returns a `MarginalGP` at the MAP of its hyperparameters
(`condition` rebuilds one from a recorded theta). The model predicts, knows how uncertain hyperparameters spread its
predictions, and scores points by the `UTILITIES`; `trajectory_utility` scores a whole bank, `subsample` picks the
samples of a recording. `Interaction` ties them into Algorithm 1: ask for a trajectory, tell what was recorded.

`draw_models` with `point_information` and `path_information` estimate by Monte Carlo what the utilities approximate.
For many data, `fit_sparse` returns a `SparseGP` of a few pseudo-inputs, which predicts alike; a `SparseMarginalGP`
scores alike too, and a `SparseInteraction` runs Algorithm 1 on all samples of every trial.

Inside, data flow `kernel` -> `factor` -> `posterior` -> `estimation` -> `laplace` -> `marginal` -> `utilities`;
`marginal` predicts through `prediction`, whose matrix products are those of `distance`.
"""
