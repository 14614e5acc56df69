import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stages.science.plant.valve import respond

STEP = 0.004


def solve_valve(command, rise, fall):
    """Pressure at the sampling instants, sample by sample with an adaptive solver."""
    pressure = [command[0]]
    for held in command[:-1]:

        def flow(_, p, held=held):
            return (held - p) / (rise if held > p[0] else fall)

        solved = solve_ivp(flow, (0, STEP), [pressure[-1]], rtol=1e-10, atol=1e-10).y[0, -1] if rise else held
        pressure.append(solved)
    return np.array(pressure)


@pytest.mark.parametrize(("rise", "fall"), [(0.04, 0.04), (0.03, 0.06), (0.0, 0.0)])
def test_a_held_command_is_answered_exactly(generator, rise, fall):
    command = np.repeat(generator.uniform(50, 500, 12), 10)
    pressure = respond(command[:, None], np.array([rise]), np.array([fall]), STEP)[:, 0]
    assert pressure == pytest.approx(solve_valve(command, rise, fall), rel=1e-7)
