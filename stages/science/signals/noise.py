"""Band-limited noise: what makes a person's movement a person's."""

import numpy as np
from numpy.typing import NDArray

from stages.science.signals.trajectories import Array


def band_noise(
    generator: np.random.Generator, samples: int, columns: int, sampling_rate_hz: float, low_hz: float, high_hz: float
) -> Array:
    """Draw Gaussian noise (samples, columns) whose power lies between two frequencies, with unit expected variance.

    Columns are independent; the band between the frequencies is flat, and the mean never in it. A `ValueError` tells
    that no frequency of a signal of this length and rate lies in the band.
    """
    band = select_band(samples, sampling_rate_hz, low_hz, high_hz)
    if not band.any():
        raise ValueError(
            f"noise band: expected a frequency of a {samples}-sample signal at {sampling_rate_hz} Hz "
            f"between {low_hz} and {high_hz} Hz; widen the band"
        )
    draws = generator.standard_normal((2, int(band.sum()), columns))
    spectrum = np.zeros((band.size, columns), dtype=complex)
    spectrum[band] = draws[0] + 1j * draws[1]
    scale = 2 * samples / np.sqrt(4.0 * band.sum())
    return np.ascontiguousarray(np.fft.irfft(spectrum, n=2 * samples, axis=0)[:samples] * scale)


def select_band(samples: int, sampling_rate_hz: float, low_hz: float, high_hz: float) -> NDArray[np.bool_]:
    """Return which frequencies of a signal, drawn at twice its length, lie in a band; not the mean, not Nyquist's."""
    frequencies = np.fft.rfftfreq(2 * samples, 1.0 / sampling_rate_hz)
    band: NDArray[np.bool_] = (frequencies > 0.0) & (frequencies >= low_hz) & (frequencies <= high_hz)
    band[-1] = False
    return band
