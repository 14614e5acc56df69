"""Inputs of every unpleasant kind: each gives a right answer or one line that names what is wrong, in bounded time."""

import time
from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.science.gp.estimation import find_map
from stages.science.gp.factor import FactorisationError
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.marginal import condition
from stages.science.gp.posterior import LARGEST_LOG, LogPosterior
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.utilities import UTILITIES
from tests.science.gp.data import Textbook, assert_sound

COMMON = settings(derandomize=True, deadline=None, max_examples=100)
LONGEST_S = 20.0
"""Of one example: a search that does not end is a fault, a slow machine is not."""

SCALES = st.sampled_from([0, 0, 0, 0, -150, -60, -45, -20, -8, 3, 8, 20, 45, 50, 60, 150])
LOGS = st.one_of(
    st.floats(-2, 2), st.sampled_from([-1e3, -51.0, -50.0, -35.0, -18.0, -9.0, 9.0, 18.0, 35.0, 50.0, 51.0, 1e3])
)
VARIANCES = st.one_of(st.floats(0.1, 2), st.sampled_from([1e-100, 1e-12, 1e-4, 1e4, 1e12, 1e100]))


class Problem(NamedTuple):
    """What a model is made of, and where it is asked."""

    x: np.ndarray
    y: np.ndarray
    theta: np.ndarray
    prior: Hyperprior
    mean: str
    points: np.ndarray

    def condition(self):
        return condition(*self[:5])


KINDS = ("plain", "twice", "nearly twice", "whole numbers", "outlier", "one column constant", "all alike")


@st.composite
def problems(draw, most=10):
    """Draw data, hyperprior, theta and points."""
    source = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    d, n = draw(st.integers(1, 4)), draw(st.sampled_from([1, 2, 3, most // 2, most]))
    x = source.uniform(-1.5, 1.5, (n, d))
    kind = draw(st.sampled_from(KINDS))
    if kind in ("twice", "nearly twice"):
        apart = draw(st.sampled_from([1e-16, 1e-12, 1e-9, 1e-6])) if kind == "nearly twice" else 0.0
        x[n // 2 :] = x[: n - n // 2] * (1 + apart)
    elif kind == "whole numbers":
        x = source.integers(-3, 4, (n, d))
    elif kind == "outlier":
        x[0] *= draw(st.sampled_from([1e3, 1e8, 1e30]))
    elif kind == "one column constant":
        x[:, 0] = 0.3
    elif kind == "all alike":
        x[:] = x[0]
    y = draw_outputs(draw, source, x)
    points = draw_points(draw, source, x)
    if kind != "whole numbers":
        scales = 10.0 ** np.array([draw(SCALES) for _ in range(d)])
        x, points = x * scales, np.clip(points * scales, -1e300, 1e300)
    mean = draw(st.sampled_from(["zero", "constant"]))
    size = d + 2 + (mean == "constant")
    calm = draw(st.booleans())
    logs = st.floats(-1, 1) if calm else LOGS
    prior = Hyperprior(
        np.array([draw(logs) for _ in range(size)]),
        np.array([draw(st.floats(0.1, 2) if calm else VARIANCES) for _ in range(size)]),
    )
    theta = np.array([draw(logs) for _ in range(size)])
    if calm:
        prior.mean[d + 1] = theta[d + 1] = draw(st.sampled_from([-2.0, -2.0, -9.0, -20.0]))
    return Problem(x, y, theta, prior, mean, points)


def draw_outputs(draw, source, x):
    n = len(x)
    kind = draw(st.sampled_from(["smooth", "noise", "zero", "constant", "outlier", "whole numbers"]))
    y = {
        "smooth": np.sin(np.clip(x, -9, 9).sum(axis=1)),
        "noise": source.standard_normal(n),
        "zero": np.zeros(n),
        "constant": np.full(n, 0.7),
        "outlier": np.where(np.arange(n) == 0, 1e8, source.standard_normal(n)),
        "whole numbers": source.integers(-3, 4, n),
    }[kind]
    return y if kind == "whole numbers" else y * 10.0 ** draw(SCALES)


def draw_points(draw, source, x):
    """Draw none, one or more points: data, next to data, between them, far away."""
    d = x.shape[1]
    made = {
        "data": x[:3],
        "next to data": x[:3] + 1e-9 * source.standard_normal((len(x[:3]), d)),
        "between": source.uniform(-2, 2, (4, d)),
        "far": source.uniform(-2, 2, (2, d)) * 10.0 ** draw(st.sampled_from([1, 3, 8, 30, 100])),
        "one": source.uniform(-2, 2, (1, d)),
        "none": np.zeros((0, d)),
    }
    kinds = draw(st.sampled_from([("none",), ("one",), ("data",), ("data", "next to data", "between", "far")]))
    return np.vstack([made[kind] for kind in kinds])


def answer(ask, *given):
    """Return an answer, or None for an error that says in one line what is wrong; anything else passes through."""
    began, found, told = time.perf_counter(), None, ""
    try:
        found = ask(*given)
    except (ValueError, FactorisationError) as error:
        if type(error) not in (ValueError, FactorisationError):
            raise
        told = str(error)
    assert time.perf_counter() - began < LONGEST_S
    assert told.isprintable()
    assert len(told) < 400
    return found


def predict_directly(problem, jitter):
    """Return mean and variance by the textbook, and what rounding does to either.

    None where the covariance's condition leaves too few digits.
    """
    x, d = np.asarray(problem.x, dtype=float), problem.x.shape[1]
    with np.errstate(all="ignore"):
        textbook = Textbook(x, problem.y, problem.theta)
        textbook.covariance += jitter * np.eye(len(x))
        c, scaled = textbook.covariance, x / np.exp(problem.theta[:d])
        condition_number = np.linalg.cond(c) if np.isfinite(c).all() else np.inf
        radius = np.abs(np.ptp(scaled, axis=0)).max() + np.abs(scaled).max()
        # relative errors: of the solution by the condition, of the kernel by the rounding of its exponent's parts
        lost = 10 * len(x) * np.finfo(float).eps * condition_number * (1 + radius**2 + np.abs(2 * problem.theta[d]))
    if not lost < 1e-6:
        return None
    with np.errstate(all="ignore"):
        k = textbook.cross(problem.points).T
    a, b = np.linalg.solve(c, textbook.residual), np.linalg.solve(c, k)
    norms = np.linalg.norm(k, axis=0)
    return (
        k.T @ a + textbook.mean,
        textbook.signal - (k * b).sum(axis=0),
        lost * (norms * np.linalg.norm(a) + np.abs(textbook.mean)) + 1e-300,
        lost * (norms * np.linalg.norm(b, axis=0) + textbook.signal),
    )


@COMMON
@given(problems(), st.integers(0, 2**32 - 1))
def test_a_model_is_refused_or_sound_and_the_textbook_s_whatever_the_order_of_rows(problem, seed):
    model = answer(problem.condition)
    if model is None:
        return
    assert_sound(model, problem.points, answer)
    found, direct = answer(model.predict, problem.points), predict_directly(problem, model.jitter)
    if found is None or direct is None:
        return
    order = np.random.default_rng(seed).permutation(len(problem.x))
    turned = problem._replace(x=problem.x[order], y=problem.y[order]).condition().predict(problem.points)
    for told in (found, turned):
        for ours, expected, rounding in zip(told, direct[:2], direct[2:], strict=True):
            assert (np.abs(ours - expected) <= rounding).all()


@settings(COMMON, max_examples=50)
@given(problems(), st.integers(1, 3), st.integers(0, 4))
def test_trajectories_are_sums_of_their_points_or_refused(problem, trajectories, samples):
    model = answer(problem.condition)
    if model is None:
        return
    bank = np.ones((trajectories, 0, model.inputs.shape[1]))
    if problem.points.size:
        bank = np.resize(problem.points, (trajectories, samples, model.inputs.shape[1]))
    exact = predict_directly(problem, model.jitter) is not None

    for name in (*UTILITIES, "log_det"):
        for reduce in ("sum", "max"):
            scores = answer(trajectory_utility, [model] * 2, [bank] * 2, name, reduce, 0.01, 2)
            if scores is None:
                continue
            assert scores.shape == (trajectories,)
            assert np.isfinite(scores).all()
            if name == "log_det":
                expected = [2 * model.joint_information(each[::2]) for each in bank]
            else:
                expected = [2 * getattr(model.utility(each, name), reduce)() for each in bank]
            unit = model.hyperparameters.signal_variance if name == "variance" else 1.0
            if exact:  # else a chunk's size shows in more than the last digits
                np.testing.assert_allclose(scores, expected, rtol=1e-5, atol=1e-9 * unit)


@settings(COMMON, max_examples=40)
@given(problems(most=8), st.integers(0, 4), st.integers(0, 2))
def test_the_map_is_above_every_start_and_says_its_slope(problem, starts, warm):
    posterior = answer(LogPosterior, problem.x, problem.y, problem.prior, problem.mean)
    if posterior is None:
        return
    warm_starts = [problem.theta + 0.3 * each for each in range(warm)]
    found = answer(find_map, posterior, np.random.default_rng(2), starts, warm_starts)
    if found is None:
        return
    for start in [*warm_starts, problem.prior.mean]:
        at = answer(posterior.derivatives, start)
        assert at is None or found.value >= at[0] - 1e-12 * max(1.0, abs(at[0]))
    value, gradient, _ = posterior.derivatives(found.theta)
    assert value == found.value
    assert np.abs(gradient).max() == found.gradient_norm
    moderate = np.ptp(problem.prior.mean) < 5 and np.abs(problem.y).max() < 10 and (problem.prior.variance >= 0.1).all()
    inside = np.abs(found.theta[: problem.x.shape[1] + 2]).max() < LARGEST_LOG - 1
    if moderate and inside:
        assert found.gradient_norm <= 1e-6 * max(1.0, abs(value))


@settings(COMMON, max_examples=40)
@given(problems(most=5), problems(most=4), st.sampled_from([*UTILITIES, "log_det", "random"]), st.integers(0, 3))
def test_an_interaction_goes_on_or_says_why_not(first, second, utility, points_per_trial):
    design = Design(
        utility, "random" if utility == "log_det" else utility, "sum", points_per_trial, False, 2, first.mean, 2, 0.01
    )
    problem = (first, second)
    d = [np.shape(each.x)[1] for each in problem]
    sources = [np.random.default_rng(3), np.random.default_rng(4)]
    candidates = [source.uniform(-2, 2, (3, 4, size)) for source, size in zip(sources, d, strict=True)]
    data = [first.prior, second.prior], [first.x, second.x], [first.y, second.y]
    interaction = answer(Interaction.begin, design, candidates, *data, [1], sources)
    if interaction is None:
        return
    choice = answer(interaction.ask, sources[0])
    if choice is not None:
        assert choice.trajectory in (0, 2)
        assert choice.scores is None or np.isfinite(choice.scores[[0, 2]]).all()
    recorded = [np.vstack([each.x, each.points]) for each in problem]
    outputs = [np.resize(each.y, len(x)) for each, x in zip(problem, recorded, strict=True)]
    told = answer(interaction.tell, 0, recorded, outputs, sources)
    if told is None:
        return
    after, picks = told
    for old, new, rows, x in zip(interaction.inputs, after.inputs, picks, recorded, strict=True):
        assert len(set(rows.tolist())) == points_per_trial
        np.testing.assert_array_equal(new, np.vstack([old, x[rows]]))
    assert np.isfinite(np.concatenate(after.thetas)).all()
    answer(after.ask, sources[0])
