"""Checks of the GP core against reference numbers, each with its tolerance."""

import numpy as np

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import condition, fit
from stages.science.gp.posterior import LogPosterior

LOW_NOISE = 1e-3
LOW_NOISE_TOLERANCE = 1e-4
TOLERANCES = {
    "log posterior": 1e-9,
    "gradient": 1e-7,
    "hessian": 1e-6,
    "variances": 1e-6,
    "marginal variances": 1e-6,
    "marginal variances given sigma": 1e-6,
    "argmax": 0.0,
    "map search": 1e-6,
    "loop picks": 0.0,
    "loop rmse": 1.0,
}
UTILITIES = {"f_over_f": "f_f", "f_over_y_as_run": "f_y", "y_over_y": "y_y"}
PICKED_BY = {"f_over_f": "f_f", "f_over_y": "f_y", "f_over_y_as_run": "f_y", "y_over_y": "y_y"}


class Findings(dict):
    """The largest error of each quantity, as a share of its tolerance, and where it was met."""

    def note(self, quantity, error, where, tolerance=None):
        allowed = TOLERANCES[quantity] if tolerance is None else tolerance
        share = error / allowed if allowed and np.isfinite(error) else np.inf if error != 0 else 0.0
        self[quantity] = max(self.get(quantity, (0.0, "")), (share, where))


def relative(ours, reference):
    """Return the largest absolute difference over max(1, largest absolute reference)."""
    reference = np.asarray(reference, dtype=float)
    return float(np.max(np.abs(ours - reference)) / max(1.0, float(np.max(np.abs(reference)))))


def element_wise(ours, reference):
    """Return the largest relative difference of an element."""
    return float(np.max(np.abs(ours / np.asarray(reference, dtype=float) - 1.0)))


def check_cases(document, findings):
    """Compare every case."""
    for case in document["cases"]:
        prior = Hyperprior(np.array(case["prior_mean"]), np.array(case["prior_variance"]))
        x, candidates = (as_columns(case[name], case["d"]) for name in ("X", "candidates"))
        data = x, np.array(case["y"], dtype=float).ravel(), prior, case["mean_function"]
        for name in ("fixed", "fixed_far", "map", "map_polished"):
            if name in case:
                check_block(name, case[name], data, candidates, findings, f"case {case['id']} {name}")
        best = min(case[name]["neg_log_posterior"] for name in ("map", "map_polished") if name in case)
        ours = fit(*data, generator=np.random.default_rng(case["id"]), starts=20)
        findings.note("map search", max(0.0, -ours.log_posterior - best), f"case {case['id']}")


def as_columns(values, dimensions):
    return np.asarray(values, dtype=float).reshape(-1, dimensions)


def check_block(name, block, data, candidates, findings, where):
    """Compare one block of a case, all at its theta."""
    theta = np.asarray(block["theta"], dtype=float)
    x, y, prior, mean = data
    loose = LOW_NOISE_TOLERANCE if np.exp(theta[x.shape[1] + 1]) < LOW_NOISE else None
    posterior = LogPosterior(*data)
    for suffix, derivatives in (("posterior", posterior.derivatives), ("likelihood", posterior.likelihood_derivatives)):
        value, gradient, hessian = derivatives(theta)
        findings.note("log posterior", relative(-value, block[f"neg_log_{suffix}"]), f"{where} {suffix}")
        findings.note("gradient", relative(-gradient, block[f"grad_neg_log_{suffix}"]), f"{where} {suffix}", loose)
        findings.note("hessian", relative(-hessian, block[f"hess_neg_log_{suffix}"]), f"{where} {suffix}", loose)
    model = condition(x, y, theta, prior, mean=mean)
    noise = model.noise_variance
    variance = model.predict(candidates)[1]
    findings.note("variances", element_wise(variance, block["f_var"]), f"{where} f", loose)
    findings.note("variances", element_wise(variance + noise, block["y_var"]), f"{where} y", loose)
    told = [("marginal variances", model, block)] if block["hess_pd"] else []
    if given := block.get("given_sigma"):
        held = condition(x, y, theta, prior, mean=mean, covariance=np.asarray(given["Sigma"], dtype=float))
        told.append(("marginal variances given sigma", held, given))
    for quantity, conditioned, expected in told:
        marginal = conditioned.predict_marginal(candidates)[1]
        findings.note(quantity, element_wise(marginal, expected["mgp_f_var"]), f"{where} f", loose)
        findings.note(quantity, element_wise(marginal + noise, expected["mgp_y_var"]), f"{where} y", loose)
    if name in ("fixed", "map_polished") and block["hess_pd"]:
        for reference, ours in UTILITIES.items():
            index = block[f"argmax_{reference}_index0"]
            found_index = int(np.argmax(model.utility(candidates, ours)))
            findings.note("argmax", float(found_index != index), f"{where} {ours}: {found_index} against {index}")


def check_loop(loop, findings):
    """Compare the reference's active loop: its picks given its MAPs, and the error of ours on our own."""
    dimensions = len(loop["pool_X"][0])
    pool, test = as_columns(loop["pool_X"], dimensions), as_columns(loop["test_X"], dimensions)
    pool_y, test_f = np.asarray(loop["pool_y"], dtype=float), np.asarray(loop["test_f"], dtype=float)
    prior = Hyperprior(np.asarray(loop["prior_mean"]), np.asarray(loop["prior_variance"]))
    mean = "constant" if prior.mean.size > dimensions + 2 else "zero"
    active = [run for run in loop["runs"] if run["mode"] in PICKED_BY]
    for run in active:
        for step, expected in enumerate(run["chosen_index0"]):
            known = [*run["initial_index0"], *run["chosen_index0"][:step]]
            theta = np.asarray(run["map_theta_per_iter"][step], dtype=float)
            model = condition(pool[known], pool_y[known], theta, prior, mean=mean)
            found = best_unknown(model.utility(pool, PICKED_BY[run["mode"]]), known)
            where = f"{run['mode']} seed {run['seed']} pick {step}: {found} against {expected}"
            findings.note("loop picks", float(found != expected), where)
    chosen = [run for run in active if PICKED_BY[run["mode"]] == "y_y"]
    learned = [run_own_loop(run, pool, pool_y, prior, mean) for run in chosen]
    ours = np.array([np.sqrt(np.mean((model.predict(test)[0] - test_f) ** 2)) for model in learned])
    theirs = np.array([run["rmse_per_iter"][-1] for run in chosen])
    difference = ours - theirs
    allowed = max(2 * float(difference.std(ddof=1)) / np.sqrt(difference.size), 0.002)
    where = f"y_y after {len(active[0]['chosen_index0'])} picks: {np.mean(ours):.4f} against {np.mean(theirs):.4f}"
    findings.note("loop rmse", max(0.0, float(difference.mean())), where, allowed)


def run_own_loop(run, x, y, prior, mean):
    """Run y_y on our own MAPs from a run's initial points; return the final model."""
    known, generator = list(run["initial_index0"]), np.random.default_rng(run["seed"])
    model = fit(x[known], y[known], prior, mean=mean, generator=generator)
    for _ in run["chosen_index0"]:
        known.append(best_unknown(model.utility(x, "y_y"), known))
        model = fit(x[known], y[known], prior, mean=mean, generator=generator, warm_starts=(model.theta,))
    return model


def best_unknown(scores, known):
    return int(np.argmax(np.where(np.isin(np.arange(len(scores)), known), -np.inf, scores)))


def check(cases=None, loop=None):
    """Compare documents of cases and of whole active loops; return what was found."""
    findings = Findings()
    if cases is not None:
        check_cases(cases, findings)
    if loop is not None:
        check_loop(loop, findings)
    return findings
