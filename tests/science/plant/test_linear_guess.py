"""What a record tells before any fit: the pace of sines, derivatives through a filter, coefficients of any size."""

import numpy as np
import pytest

from stages.science.plant.linear_guess import filter_derivatives, find_pace, regress

STEP_S = 0.01


def test_the_pace_minds_neither_drift_nor_size_but_where_the_power_lies():
    time = np.arange(4000) * STEP_S
    slow, quick = np.sin(2 * np.pi * 0.5 * time), np.sin(2 * np.pi * 4.0 * time)
    pace = find_pace([slow + 0.3 * quick], STEP_S)
    for omega in 2 * np.pi * np.array([0.5, 2.0, 9.0]):
        assert find_pace([5.0 + np.sin(omega * time[:2000])], STEP_S) == pytest.approx(1 / omega, rel=0.1)
    assert find_pace([40.0 * (slow + 0.3 * quick) + 3.0 * time - 7.0], STEP_S) == pytest.approx(pace, rel=0.05)
    assert find_pace([slow + 3.0 * quick], STEP_S) == pytest.approx(1 / (2 * np.pi * 4.0), rel=0.1)
    assert find_pace([slow, slow, quick], STEP_S) == pytest.approx(pace, rel=0.1)
    assert find_pace([np.full(100, 2.0)], STEP_S) == pytest.approx(10 * STEP_S)  # one that never changes


@pytest.mark.parametrize("hertz", [0.3, 1.5])
def test_filtered_derivatives_are_those_of_the_filtered_signal(hertz):
    omega, tau_s = 2 * np.pi * hertz, 0.05
    time = np.arange(3000) * STEP_S
    found = filter_derivatives(np.sin(omega * time), 2, tau_s, STEP_S)[1000:]
    passed = 1.0 / (1.0 + 1j * omega * tau_s) ** 3
    for order in range(3):
        truth = np.imag((1j * omega) ** order * passed * np.exp(1j * omega * time))[1000:]
        np.testing.assert_allclose(found[:, order], truth, atol=5e-3 * np.abs(truth).max())
    settled = filter_derivatives(np.full(50, 3.0), 1, 0.1, STEP_S)
    np.testing.assert_allclose(settled, [[3.0, 0.0]] * 50, atol=1e-9)


def test_columns_of_any_size_bring_back_their_coefficients_and_one_that_is_nothing_has_none(generator):
    sizes, truth = np.array([1e-6, 1.0, 1e5, 0.0]), np.array([4e6, -2.0, 3e-5, 0.0])
    rows = [generator.standard_normal((300, 4)) * sizes for _ in range(2)]
    told = [each @ truth + 0.01 * generator.standard_normal(300) for each in rows]
    np.testing.assert_allclose(regress(rows, told, 10), truth, rtol=5e-3)


def test_samples_in_which_filters_settle_are_left_out_but_never_most_of_a_record(generator):
    rows = [generator.standard_normal((200, 1)), generator.standard_normal((30, 1))]
    told = [3.0 * each[:, 0] for each in rows]
    told[0][:50] = 1e6
    assert regress(rows, told, 50) == pytest.approx(3.0)
    told[1][:15] = 1e6
    assert regress(rows, told, 50) == pytest.approx(3.0)
