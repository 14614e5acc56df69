import numpy as np
import pytest

from stages.signals.filtering import differentiate, window_length


def test_there_is_no_phase_lag():
    time = np.arange(1000) / 250
    slope = differentiate(np.sin(2 * np.pi * 2 * time)[:, None], 250.0, 0.05, 2)[:, 0]
    truth = 4 * np.pi * np.cos(4 * np.pi * time)
    shifts = [np.corrcoef(np.roll(slope, shift)[50:-50], truth[50:-50])[0, 1] for shift in range(-3, 4)]
    assert int(np.argmax(shifts)) == 3
    assert np.abs(slope - truth)[20:-20].max() < 0.03 * np.abs(truth).max()


def test_noise_is_reduced(generator):
    noise = generator.standard_normal((2000, 1))
    raw = np.gradient(noise, 1 / 250, axis=0)
    assert differentiate(noise, 250.0, 0.05, 2).std() < 0.15 * raw.std()


@pytest.mark.parametrize(("rate", "expected"), [(250.0, 13), (100.0, 5), (10.0, 3)])
def test_window_is_odd_and_holds_the_polynomial(rate, expected):
    assert window_length(rate, 0.05, 2) == expected
