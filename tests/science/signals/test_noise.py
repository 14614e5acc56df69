import numpy as np
import pytest

from stages.science.signals.noise import band_noise


def test_variance_is_one_and_columns_are_independent(generator):
    noise = np.stack([band_noise(generator, 1000, 2, 250.0, 6.0, 12.0) for _ in range(200)])
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1] == pytest.approx(0.0, abs=0.03)


def test_power_lies_in_the_band(generator):
    noise = band_noise(generator, 5000, 1, 250.0, 8.0, 12.0)[:, 0]
    power = np.abs(np.fft.rfft(noise * np.hanning(5000))) ** 2
    frequencies = np.fft.rfftfreq(5000, 1 / 250)
    inside = (frequencies > 7.8) & (frequencies < 12.2)
    assert power[inside].sum() > 0.999 * power.sum()


def test_an_empty_band_is_refused(generator):
    with pytest.raises(ValueError, match="widen the band"):
        band_noise(generator, 100, 1, 100.0, 60.0, 70.0)
