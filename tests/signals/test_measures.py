import numpy as np
import pytest

from stages.signals.measures import error_rate, rmse


def test_error_rate_is_rmse_over_largest_force():
    assert rmse([1.0, 2.0, 5.0], [1.0, 4.0, 4.0]) == pytest.approx(np.sqrt(5 / 3))
    assert error_rate([1.0, 2.0, 5.0], [1.0, 4.0, 4.0]) == pytest.approx(np.sqrt(5 / 3) / 4)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match=r"one shape, not empty; got \(2,\) and \(3,\)"):
        rmse([1.0, 2.0], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="positive measured force"):
        error_rate([1.0], [0.0])
