"""Check the GP core against reference numbers: ``python tests/reference_parity.py --cases FILE [--loop FILE]``.

Prints one line per quantity with its largest error over all cases, and exits with 1 when one is over its tolerance.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import MarginalGP, condition, fit
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


class Data(NamedTuple):
    """What a model stands on."""

    x: np.ndarray
    y: np.ndarray
    prior: Hyperprior
    mean: str


class Findings(dict[str, list[tuple[float, float, str]]]):
    """Of each quantity the comparisons: the error as a share of its tolerance, the error, and where it was met."""

    def note(self, quantity: str, error: float, where: str, tolerance: float | None = None) -> None:
        """Take one more comparison."""
        allowed = TOLERANCES[quantity] if tolerance is None else tolerance
        share = error / allowed if allowed else (np.inf if error > 0 else 0.0)
        self.setdefault(quantity, []).append((share if np.isfinite(error) else np.inf, error, where))

    def report(self) -> bool:
        """Print a line per quantity, with its largest error; return whether all are within tolerance."""
        worst = {quantity: max(noted, key=lambda each: each[0]) for quantity, noted in self.items()}
        for quantity, (share, error, where) in worst.items():
            verdict = "ok" if share <= 1 else "OVER"
            told = f"{error:9.2e}  {share:9.2e} of tolerance  {len(self[quantity]):5d} checks"
            print(f"{quantity:<32} {told}  {verdict:<4}  {where}")
        return all(share <= 1 for share, _, _ in worst.values())


def relative(ours: Any, reference: Any) -> float:
    """Largest absolute difference over max(1, largest absolute reference)."""
    ours, reference = np.asarray(ours, dtype=float), np.asarray(reference, dtype=float)
    return float(np.max(np.abs(ours - reference)) / max(1.0, float(np.max(np.abs(reference)))))


def element_wise(ours: Any, reference: Any) -> float:
    """Largest relative difference of an element."""
    ours, reference = np.asarray(ours, dtype=float), np.asarray(reference, dtype=float)
    return float(np.max(np.abs(ours - reference) / np.abs(reference)))


def check_cases(document: dict[str, Any], findings: Findings) -> None:
    """Compare every block of every case."""
    if not document["cases"]:
        raise ValueError("expected at least one case, got none")
    for case in document["cases"]:
        prior = Hyperprior(np.asarray(case["prior_mean"], dtype=float), np.asarray(case["prior_variance"], dtype=float))
        y = np.asarray(case["y"], dtype=float).ravel()
        data = Data(as_columns(case["X"], case["d"]), y, prior, case["mean_function"])
        candidates = as_columns(case["candidates"], case["d"])
        for name in ("fixed", "fixed_far", "map", "map_polished"):
            if name in case:
                check_block(name, case[name], data, candidates, findings, f"case {case['id']} {name}")
        best = min(case[name]["neg_log_posterior"] for name in ("map", "map_polished") if name in case)
        ours = fit(*data, generator=np.random.default_rng(case["id"]), starts=20)
        findings.note("map search", max(0.0, -ours.log_posterior - best), f"case {case['id']}")


def as_columns(values: Any, dimensions: int) -> np.ndarray:
    """Return (N, D) inputs."""
    return np.asarray(values, dtype=float).reshape(-1, dimensions)


def check_block(name: str, block: dict[str, Any], data: Data, candidates: Any, findings: Findings, where: str) -> None:
    """Compare one block, all at its theta."""
    theta = np.asarray(block["theta"], dtype=float)
    loose = LOW_NOISE_TOLERANCE if np.exp(theta[data.x.shape[1] + 1]) < LOW_NOISE else None
    posterior, (x, y, prior, mean) = LogPosterior(*data), data
    told = {"posterior": posterior.derivatives(theta), "likelihood": posterior.likelihood_derivatives(theta)}
    for suffix, (value, gradient, hessian) in told.items():
        findings.note("log posterior", relative(-value, block[f"neg_log_{suffix}"]), f"{where} {suffix}")
        findings.note("gradient", relative(-gradient, block[f"grad_neg_log_{suffix}"]), f"{where} {suffix}", loose)
        findings.note("hessian", relative(-hessian, block[f"hess_neg_log_{suffix}"]), f"{where} {suffix}", loose)
    model = condition(x, y, theta, prior, mean=mean)
    noise = model.noise_variance
    variance = model.predict(candidates)[1]
    findings.note("variances", element_wise(variance, block["f_var"]), f"{where} f", loose)
    findings.note("variances", element_wise(variance + noise, block["y_var"]), f"{where} y", loose)
    given = block.get("given_sigma")
    models = [("marginal variances", model, block)] if block["hess_pd"] else []
    if given:
        sigma = np.asarray(given["Sigma"], dtype=float)
        held = condition(x, y, theta, prior, mean=mean, covariance=sigma)
        models.append(("marginal variances given sigma", held, given))
    for quantity, conditioned, expected in models:
        marginal = conditioned.predict_marginal(candidates)[1]
        findings.note(quantity, element_wise(marginal, expected["mgp_f_var"]), f"{where} f", loose)
        findings.note(quantity, element_wise(marginal + noise, expected["mgp_y_var"]), f"{where} y", loose)
    if name in ("fixed", "map_polished") and block["hess_pd"]:
        for reference, ours in UTILITIES.items():
            index = block[f"argmax_{reference}_index0"]
            found_index = int(np.argmax(model.utility(candidates, ours)))
            findings.note("argmax", float(found_index != index), f"{where} {ours}: {found_index} against {index}")


def check_loop(loop: dict[str, Any], findings: Findings) -> None:
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
    ours, theirs = [], []
    for run in (run for run in active if PICKED_BY[run["mode"]] == "y_y"):
        learned = run_own_loop(run, Data(pool, pool_y, prior, mean))
        ours.append(float(np.sqrt(np.mean((learned.predict(test)[0] - test_f) ** 2))))
        theirs.append(run["rmse_per_iter"][-1])
    difference = np.array(ours) - np.array(theirs)
    allowed = max(2 * float(difference.std(ddof=1)) / np.sqrt(difference.size), 0.002)
    where = f"y_y after {len(active[0]['chosen_index0'])} picks: {np.mean(ours):.4f} against {np.mean(theirs):.4f}"
    findings.note("loop rmse", max(0.0, float(difference.mean())), where, allowed)


def run_own_loop(run: dict[str, Any], pool: Data) -> MarginalGP:
    """Run y_y on our own MAPs from a run's initial points; return the final model."""
    x, y, prior, mean = pool
    known, generator = list(run["initial_index0"]), np.random.default_rng(run["seed"])
    model = fit(x[known], y[known], prior, mean=mean, generator=generator)
    for _ in run["chosen_index0"]:
        known.append(best_unknown(model.utility(x, "y_y"), known))
        model = fit(x[known], y[known], prior, mean=mean, generator=generator, warm_starts=(model.theta,))
    return model


def best_unknown(scores: np.ndarray, known: list[int]) -> int:
    """Return the best index that is not known yet."""
    scores = scores.copy()
    scores[known] = -np.inf
    return int(np.argmax(scores))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=Path, metavar="FILE", help="cases of fixed and fitted hyperparameters")
    parser.add_argument("--loop", type=Path, metavar="FILE", help="whole active loops")
    options = parser.parse_args(arguments)
    if options.cases is None and options.loop is None:
        parser.error("give --cases FILE, --loop FILE or both")
    findings = Findings()
    for file, check in ((options.cases, check_cases), (options.loop, check_loop)):
        if file is None:
            continue
        try:
            check(json.loads(file.read_text()), findings)
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            print(f"cannot check {file}: {type(error).__name__}: {error}", file=sys.stderr)
            return 2
    return 0 if findings.report() else 1


if __name__ == "__main__":
    sys.exit(main())
