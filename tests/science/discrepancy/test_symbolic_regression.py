"""A formula finds planted terms and their weights, and none in noise; a planted gap is described from end to end."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.description import average_dependence, describe, tabulate
from stages.science.discrepancy.description_settings import DescriptionSettings
from stages.science.discrepancy.report_text import describe_remainder
from stages.science.discrepancy.resampling import resample
from stages.science.discrepancy.symbolic_regression import sketch_residual
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import make_plain
from tests.science.discrepancy.searches import DESCRIPTION, DISCREPANCY
from tests.science.discrepancy.toys import make_toy

NOISE = 0.1
REGRESSIONS = [
    "stepwise",
    pytest.param("pysindy", marks=pytest.mark.skipif(find_spec("pysindy") is None, reason="extra sketch")),
]


def fit_line(seed, shape=None, trials=10):
    """The toy's line fitted to a line plus a shape of x and its rate; and the inputs."""
    output = make_toy(seed, trials=trials, noise=NOISE)
    if shape is not None:
        x, rate = output.x, np.gradient(output.x, output.step_s, axis=0)
        output = replace(output, measured=output.measured + shape(x, rate))
    model = Model(output)
    return fit(model, make_plain(NOISE), model.start), output.drivers()


@pytest.mark.parametrize("regression", REGRESSIONS)
@pytest.mark.parametrize(
    ("shape", "terms"),
    [
        (lambda x, v: 0.03 * v * np.abs(v), {"[x rate]*|x rate|": 0.03}),
        (lambda x, v: 0.5 * x**3, {"x^3": 0.5}),
        (lambda x, v: 0.1 * x * v, {"x*[x rate]": 0.1}),
    ],
)
def test_planted_terms_come_back_with_their_weights(shape, terms, regression):
    fitted, inputs = fit_line(2, shape)
    found = sketch_residual(fitted, inputs, DESCRIPTION.model_copy(update={"regression": regression}))
    assert dict(found.terms) == pytest.approx(terms, rel=0.1)
    assert found.after.sum() < 0.5 * found.before.sum()
    if regression == "stepwise":
        assert found.after.sum() == pytest.approx(NOISE**2 * fitted.residual.size, rel=0.1)


def test_a_direction_is_told():
    fitted, inputs = fit_line(3, lambda x, v: 0.4 * np.sign(v))
    found = sketch_residual(fitted, inputs, DESCRIPTION)
    text, weight = found.terms[0]
    assert text.startswith("tanh([x rate]/")
    assert weight == pytest.approx(0.4, rel=0.2)


@pytest.mark.parametrize("regression", REGRESSIONS)
@pytest.mark.parametrize("seed", range(6))
def test_noise_has_no_formula(seed, regression):
    fitted, inputs = fit_line(seed)
    found = sketch_residual(fitted, inputs, DESCRIPTION.model_copy(update={"regression": regression}))
    weights = resample(10, 400, np.random.default_rng(0))
    taken = 1.0 - (weights @ found.after) / (weights @ found.before)
    assert not found.terms or np.quantile(taken, 0.025) <= 0.0


def test_what_the_constants_imitate_is_no_term():
    fitted, inputs = fit_line(1, lambda x, v: 0.7 * x)
    assert not sketch_residual(fitted, inputs, DESCRIPTION).terms


def describe_line(shape):
    fitted, _ = fit_line(4, shape)
    return describe(
        fitted, NOISE, DESCRIPTION, resample(10, 400, np.random.default_rng(0)), 0.95, np.random.default_rng(1)
    )


def test_a_planted_drag_is_described_drawn_and_told():
    found = describe_line(lambda x, v: 0.05 * v * np.abs(v))
    row = tabulate(found)
    assert row["inputs"] == "x_rate"
    assert row["low"] < row["share"] < row["high"]
    assert row["share"] == pytest.approx(row["above_floor"], abs=0.1)
    assert row["hint"].endswith("*[x rate]*|x rate|")
    averages = average_dependence([found])
    assert np.abs(averages["said"] - averages["mean"]).max() < 0.1
    said = " ".join(describe_remainder(pd.DataFrame([row]), "unexplained", DISCREPANCY.report))
    for words in (
        "What stays unexplained in y of toy depends on x rate",
        "A hint, no finding: on toy it is about 0.05",
    ):
        assert words in said


def test_of_noise_nothing_is_told_but_that():
    row = tabulate(describe_line(None))
    assert (row["inputs"], row["hint"]) == ("", "")
    assert row["above_floor"] < 0.1
    table = pd.DataFrame([row])
    said = describe_remainder(table, "named", DISCREPANCY.report)
    assert len(said) == 1
    assert "depends on no measured signal" in said[0]
    assert not describe_remainder(table, "no_discrepancy", DISCREPANCY.report)
    assert not describe_remainder(table[:0], "named", DISCREPANCY.report)
    assert "hardly above the noise floor" in describe_remainder(table[:0], "unexplained", DISCREPANCY.report)[0]


def test_pysindy_is_asked_for_only_where_it_is():
    if find_spec("pysindy") is None:
        with pytest.raises(ValueError, match="pysindy is not installed"):
            DescriptionSettings(**{**DESCRIPTION.model_dump(), "regression": "pysindy"})
