import numpy as np
import pytest

from stages.science.signals.filtering import differentiate, window_length


def test_noise_is_reduced(generator):
    noise = generator.standard_normal((2000, 1))
    raw = np.gradient(noise, 1 / 250, axis=0)
    assert differentiate(noise, 250.0, 0.05, 2).std() < 0.15 * raw.std()


@pytest.mark.parametrize(("rate", "expected"), [(250.0, 13), (100.0, 5), (10.0, 3)])
def test_window_is_odd_and_holds_the_polynomial(rate, expected):
    assert window_length(rate, 0.05, 2) == expected
