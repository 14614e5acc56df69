"""Scores of left-out trials against closed forms, and what may not count: a trial's own offset and gain."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from scipy.signal import lfilter

from stages.science.discrepancy.trial_scores import compare_by
from stages.science.output_channels.grams import Collector, Columns
from stages.science.output_channels.noise import Noise, make_plain, whiten
from stages.science.output_channels.trial_noise import TrialNoise, estimate_trial_noise, split_residual
from tests.science.discrepancy.toys import make_toy

TOY = make_toy(0, trials=8, samples=400)
ANY = 1e9


def draw(seed, correlation=0.0):
    noise = 0.01 * np.random.default_rng(seed).standard_normal(TOY.measured.shape)
    return lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], noise, axis=0)


def test_a_residual_is_its_shape_and_its_offset_and_its_part_along_what_was_simulated():
    measured = TOY.measured - TOY.measured.mean(axis=0)
    offset, gain = np.linspace(-1.0, 1.0, 8), np.linspace(0.5, -0.5, 8)
    shape, found, along = split_residual(offset + gain * measured, TOY)
    np.testing.assert_allclose(shape, 0.0, atol=1e-12)
    np.testing.assert_allclose(found, offset, atol=1e-12)
    np.testing.assert_allclose(along, np.abs(gain) * measured.std(axis=0), atol=1e-12)


def test_a_trial_whose_simulation_stands_still_has_an_offset_and_no_gain():
    still = np.where(np.arange(8) < 4, 100.0 / 3.0, TOY.measured)
    residual = TOY.measured - still
    shape, offset, along = split_residual(residual, TOY)
    parts = (shape**2).sum(axis=0) + len(residual) * (offset**2 + along**2)
    np.testing.assert_allclose(parts, (residual**2).sum(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(along[:4], 0.0)


def test_a_wrong_gain_hides_no_noise():
    noise = 10.0 * draw(1)
    shape, _, _ = split_residual(noise + 0.4 * (TOY.measured - noise), TOY)
    assert shape.std() == pytest.approx(noise.std(), rel=0.01)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_correlated_samples_count_as_bartlett_says(correlation):
    expected = TOY.measured.size * (1.0 - correlation**2) / (1.0 + correlation**2)
    found = [compare_by(TOY, draw(seed, correlation), ANY).effective for seed in range(8)]
    assert np.median(found) == pytest.approx(expected, rel=0.25)
    assert correlation or found[1] == pytest.approx(TOY.measured.size, rel=0.25)


def test_trials_that_differ_count_for_less():
    uneven = draw(2) * np.where(np.arange(8) == 3, 5.0, 1.0)
    assert compare_by(TOY, uneven, ANY).effective < 0.02 * compare_by(TOY, draw(2), ANY).effective


def test_differences_of_scores_are_those_of_an_integrated_likelihood():
    small, large = draw(3), 1.3 * draw(4)
    scores = compare_by(TOY, small, ANY)
    count = int(scores.effective)

    def integrate(residual):
        shape, offset, along = split_residual(residual, TOY)
        total = 0.0
        for part, number, least in ((shape, count, 0.0), (offset, 8, scores.noise), (along, 8, scores.noise)):
            mean, width = (part**2).mean() + least, np.array([-1.0, 1.0]) / np.sqrt(number)
            top = stats.norm.logpdf(np.sqrt(mean), 0.0, np.sqrt(mean))

            def density(log_sd, mean=mean, number=number, top=top):
                return np.exp(number * (stats.norm.logpdf(np.sqrt(mean), 0.0, np.exp(log_sd)) - top))

            total += -0.5 * number * np.log(mean) + np.log(quad(density, *(0.5 * np.log(mean) + 8.0 * width))[0])
        return total

    expected = integrate(small) - integrate(large)
    assert scores.score(small) - scores.score(large) == pytest.approx(expected, rel=0.01)


def test_jitter_of_trials_does_not_drown_a_better_shape():
    jitter = 0.03 * np.random.default_rng(5).standard_normal(8)
    better, worse = draw(6) + jitter, 1.1 * draw(6) + jitter
    scores = compare_by(TOY, better, ANY)
    assert scores.score(better) - scores.score(worse) == pytest.approx(scores.effective * np.log(1.1), rel=0.05)


def test_jitter_beyond_the_largest_counts_against_a_model():
    largest = 0.1
    size = np.sqrt(TOY.measured.var(axis=0).mean())
    scores = compare_by(TOY, draw(7), largest)
    offset = 5.0 * largest * size * np.where(np.arange(8) % 2, 1.0, -1.0)
    moved = draw(7) - draw(7).mean(axis=0)
    sd = np.sqrt((largest * size) ** 2 + scores.noise)
    expected = stats.norm.logpdf(0.0, 0.0, np.sqrt(scores.noise)) - stats.norm.logpdf(offset[0], 0.0, sd)
    expected += 0.5 * scores.noise / sd**2 - 0.5
    assert scores.score(moved) - scores.score(moved + offset) == pytest.approx(8.0 * expected, rel=1e-6)


def test_trials_are_whitened_by_the_covariance_of_their_offset_gain_and_shape():
    toy = make_toy(1, trials=3, samples=60)
    noise, rng = TrialNoise(0.7, 0.3, 0.2, toy.measured), np.random.default_rng(8)
    toy = replace(toy, present=toy.present & (np.arange(60)[:, None] >= [0, 5, 20]))
    signals = rng.standard_normal((60, 3, 3)) + rng.standard_normal((3, 3))
    signals[~toy.present] = 0.0
    found = Collector(toy, noise, Columns(signals[:, :, 1:2])).collect(signals[:, :, [0, 2]], noise)
    for k in range(3):
        kept = toy.present[:, k]
        along = toy.measured[kept, k] - toy.measured[kept, k].mean()
        along *= np.sqrt(kept.sum()) / np.linalg.norm(along)
        covariance = 0.7**2 * np.eye(kept.sum()) + 0.3**2 + 0.2**2 * np.outer(along, along)
        expected = signals[kept, k].T @ np.linalg.solve(covariance, signals[kept, k])
        np.testing.assert_allclose(found.slopes[k], expected[:2, :2], rtol=1e-9)
        np.testing.assert_allclose([*found.cross[k], found.square[k]], expected[2, :], rtol=1e-9)


@pytest.mark.parametrize("noise", [make_plain(0.7), Noise(0.7, 0.3, 0.03, 0.2, 1.5)], ids=["white", "coloured"])
def test_columns_beside_signals_are_summed_as_signals_are(noise):
    signals = np.random.default_rng(8).standard_normal((*TOY.measured.shape, 3)) * TOY.present[:, :, None]
    whole = Collector(TOY, noise).collect(signals, noise)
    parted = Collector(TOY, noise, Columns(signals[:, :, 1:2])).collect(signals[:, :, [0, 2]], noise)
    for name in ("slopes", "cross", "square"):
        np.testing.assert_allclose(getattr(parted, name), getattr(whole, name), rtol=1e-9, atol=1e-9)
    white = whiten(signals, TOY.present, noise, TOY.step_s)
    np.testing.assert_allclose(whole.square, (white[:, :, 2] ** 2).sum(axis=0), rtol=1e-9)


def test_the_noise_of_trials_is_that_which_was_drawn_up_to_the_largest():
    toy = make_toy(2, trials=60, samples=200)
    rng = np.random.default_rng(9)
    centred = toy.measured - toy.measured.mean(axis=0)
    size = np.sqrt((centred**2).mean())
    residual = 0.1 * rng.standard_normal(toy.measured.shape) + 0.5 * size * rng.standard_normal(60)
    residual += 0.05 * centred * rng.standard_normal(60)
    found = estimate_trial_noise(residual, toy, 0.2)
    assert found.shape == pytest.approx(0.1, rel=0.2)
    assert found.offset == pytest.approx(0.2 * size, rel=1e-6)
    assert found.gain == pytest.approx(0.05 * size, rel=0.3)
