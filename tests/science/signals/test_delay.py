import numpy as np
import pytest

from stages.science.signals.delay import find_delay

RATE_HZ = 100.0


def wander(generator, time_s):
    parts = [(generator.uniform(0.2, 1.5), generator.uniform(0.0, 6.3), generator.uniform(0.2, 1.0)) for _ in range(5)]
    return sum(size * np.sin(2 * np.pi * hz * time_s + phase) for hz, phase, size in parts)


@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.163, 0.3, 0.457])
@pytest.mark.parametrize("seed", range(3))
def test_a_delay_is_found_to_a_fraction_of_a_sample_and_noise_moves_it_little(seed, delay_s):
    time_s = np.arange(800) / RATE_HZ
    shown, followed = (wander(np.random.default_rng(seed), at_s) for at_s in (time_s, time_s - delay_s))
    assert find_delay(shown, 0.3 + 0.8 * followed, RATE_HZ, 1.0) == pytest.approx(delay_s, abs=0.003)
    noisy = followed + 0.1 * followed.std() * np.random.default_rng(2).standard_normal(800)
    assert find_delay(shown, noisy, RATE_HZ, 1.0) == pytest.approx(delay_s, abs=0.02)


def test_what_does_not_follow_has_no_delay(generator):
    time_s = np.arange(800) / RATE_HZ
    shown = wander(generator, time_s)
    assert np.isnan(find_delay(shown, np.full(800, 0.4), RATE_HZ, 1.0))
    assert np.isnan(find_delay(shown, generator.standard_normal(800), RATE_HZ, 1.0))
    assert np.isnan(find_delay(np.sin(time_s / 3), np.sin((time_s - 2.0) / 3), RATE_HZ, 1.0))
