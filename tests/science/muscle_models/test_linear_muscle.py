"""The linear muscle law against planted coefficients, higher precision, statsmodels and the plant."""

import mpmath
import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stages.science.muscle_models.linear_muscle import LinearMuscleModel
from stages.science.plant.muscle import MuscleConstants, braid_coefficients, compute_tension

COMMON = settings(derandomize=True, deadline=None, max_examples=100)
PLANTED = np.array([2.0, -4.5, 1.2, -900.0, 150.0, -20.0])


def terms(pressure, contraction):
    """Return the six columns of the law as it is written."""
    powers = np.stack([contraction**2, contraction, np.ones_like(pressure)], axis=-1)
    return np.concatenate([np.expand_dims(pressure, -1) * powers, powers], axis=-1)


def draw(generator, n=300, noise=0.0):
    pressure, contraction = generator.uniform(20, 600, n), generator.uniform(-0.05, 0.25, n)
    force = terms(pressure, contraction) @ PLANTED + noise * generator.standard_normal(n)
    return pressure, contraction, force


def test_recovers_the_muscle_of_the_plant(generator):
    a, b = braid_coefficients(25.0)
    area, factor, linear, quadratic = 0.1, 1.2, 30.0, 200.0
    constants = (area, a, b, factor, linear, quadratic, 0.0, 0.1, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    muscle = MuscleConstants(*np.array(constants)[:, None])
    pressure, contraction = generator.uniform(100, 600, (200, 1)), generator.uniform(0.0, 0.15, (200, 1))
    force = compute_tension(pressure, contraction, np.zeros((200, 1)), muscle)
    assert (force > 0).all()
    model = LinearMuscleModel.fit(pressure[:, 0], contraction[:, 0], force[:, 0])
    law = np.array([area * a * factor**2, -2 * area * a * factor, area * (a - b), -quadratic, -linear, 0.0])
    # also far from all samples, where another polynomial would show
    farther = generator.uniform(-1000, 1000, 200), generator.uniform(-1, 1, 200)
    np.testing.assert_allclose(model.predict(*farther), terms(*farther) @ law, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("offset", [0.0, 30.0])
def test_equals_normal_equations_in_fifty_digits(generator, offset):
    """With `offset`, contractions lie so far from zero that the six columns as written are nearly dependent."""
    pressure, contraction, force = draw(generator, 40, noise=5.0)
    contraction = contraction + offset
    with mpmath.workdps(50):
        pairs = [[mpmath.mpf(each) for each in pair] for pair in zip(pressure, contraction, strict=True)]
        design = mpmath.matrix([[p * c**2, p * c, p, c**2, c, 1] for p, c in pairs])
        exact = (design.T * design) ** -1 * (design.T * mpmath.matrix(force.tolist()))
        predicted = np.array((design * exact).tolist(), dtype=float)[:, 0]
    model = LinearMuscleModel.fit(pressure, contraction, force)
    np.testing.assert_allclose(model.predict(pressure, contraction), predicted, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("pressure", [300.0, 1e40, 1e-40])
def test_one_pressure_that_at_most_rounding_changes_determines_the_law_there(generator, pressure):
    _, contraction, force = draw(generator, 60, noise=1.0)
    best = np.polyval(np.polyfit(contraction, force, 2), contraction)
    for part in (0.0, 1e-13):
        pressures = pressure * (1 + part * generator.standard_normal(60))
        model = LinearMuscleModel.fit(pressures, contraction, force)
        # what no sample shows adds nothing: another pressure changes no force
        for at in (pressures, pressures * 1.3):
            np.testing.assert_allclose(model.predict(at, contraction), best, rtol=1e-9)


def test_two_contractions_determine_the_law_between_them(generator):
    pressure, _, _ = draw(generator, 60)
    contraction = np.tile([0.0, 0.1], 30)
    force = terms(pressure, contraction) @ PLANTED + generator.standard_normal(60)
    model = LinearMuscleModel.fit(pressure, contraction, force)
    reduced = np.stack([pressure * contraction, pressure, contraction, np.ones(60)], axis=1)
    baseline = sm.OLS(force, reduced).fit()
    np.testing.assert_allclose(model.predict(pressure, contraction), baseline.fittedvalues, rtol=1e-9)
    # at zero contraction, the terms without contraction are the law, so these two remain determined
    still = baseline.params[1] * pressure + baseline.params[3]
    np.testing.assert_allclose(model.predict(pressure, np.zeros(60)), still, rtol=1e-8)


def test_a_pressure_that_follows_contraction_is_explained_all_the_same(generator):
    contraction = generator.uniform(0, 0.25, 60)
    pressure = 100 + 2000 * contraction
    force = terms(pressure, contraction) @ PLANTED
    model = LinearMuscleModel.fit(pressure, contraction, force)
    np.testing.assert_allclose(model.predict(pressure, contraction), force, rtol=1e-9)


@COMMON
@given(
    st.integers(1, 12).flatmap(
        lambda n: arrays(
            float, (3, n), elements=st.one_of(st.floats(-1e50, 1e50), st.floats(-10, 10), st.integers(-2, 2).map(float))
        )
    )
)
def test_any_data_give_finite_forces_and_the_smallest_residuals(values):
    model = LinearMuscleModel.fit(*values)
    predicted = model.predict(*values[:2])
    assert np.isfinite(predicted).all()
    # not worse than predicting the mean force
    size = np.abs(values[2]).max() or 1.0
    error, plain = (np.linalg.norm((values[2] - each) / size) for each in (predicted, values[2].mean()))
    assert error <= plain + 1e-6


@COMMON
@given(st.integers(-20, 20), st.integers(-20, 20), st.integers(-20, 20))
def test_units_change_the_force_by_their_own_alone(of_pressure, of_contraction, of_force):
    pressure, contraction, force = draw(np.random.default_rng(1), 30, noise=5.0)
    model = LinearMuscleModel.fit(pressure, contraction, force)
    units = np.ldexp(1.0, [of_pressure, of_contraction, of_force])
    other = LinearMuscleModel.fit(pressure * units[0], contraction * units[1], force * units[2])
    told, expected = other.predict(pressure * units[0], contraction * units[1]), model.predict(pressure, contraction)
    np.testing.assert_allclose(told, expected * units[2], rtol=1e-9)


def test_predicts_sane_inputs_of_any_one_shape_and_keeps_what_is_missing(generator):
    model = LinearMuscleModel.fit(*draw(generator))
    pressure, contraction = np.full((2, 3), 300.0), np.full((2, 3), 0.1)
    pressure[0, 0] = np.nan
    force = model.predict(pressure, contraction)
    assert force.shape == (2, 3)
    np.testing.assert_array_equal(np.isnan(force), np.isnan(pressure))
    assert model.predict(300.0, 0.1) == pytest.approx(force[1, 1])
    assert model.predict(np.zeros(0), np.zeros(0)).shape == (0,)
    with pytest.raises(ValueError, match=r"of one shape, got \(2,\) and \(3,\)"):
        model.predict(np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match=r"^expected pressure and contraction within 1e\+50, got inf$"):
        model.predict(np.array([np.inf, np.nan]), np.zeros(2))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((np.zeros(2), np.zeros(3), np.zeros(2)), r"vectors of one length, not empty; got shapes \(2,\), \(3,\) and"),
        ((np.zeros(0),) * 3, "not empty"),
        ((np.zeros((2, 2)),) * 3, "vectors of one length"),
        ((np.array([1.0, np.nan]), np.zeros(2), np.zeros(2)), r"a finite pressure within 1e\+50, got nan"),
        ((np.zeros(2), np.array([np.inf, 0.0]), np.zeros(2)), r"a finite contraction within 1e\+50, got inf"),
        ((np.zeros(2), np.zeros(2), np.array([1e60, 0.0])), r"a finite force within 1e\+50, got 1e\+60"),
    ],
)
def test_absurd_data_are_refused_in_one_line(values, message):
    with pytest.raises(ValueError, match=rf"^.*{message}.*\Z"):
        LinearMuscleModel.fit(*values)
