"""Two tanks: levels at rest in closed form, water that is not lost, a rim that holds, and lists that are checked."""

import numpy as np
import pytest

from stages.science.plant.record_plant import HEAD, read_initial_state
from tests.science.plant.machines import begin_surely, read_plant, simulate, solve

STEP_S = 4.0
CONSTANTS = {"upper_outflow": 0.05, "lower_inflow": 0.05, "lower_outflow": 0.04, "pump_gain": 0.04}
CONSTANTS |= {"reading_offset": 0.3, "input_delay_s": 0.0}
RIM, CUT = ("overflow", "rim"), ("saturation", "tank_reading")


def begin(upper=4.0, lower=6.0, error=1e-3):
    return begin_surely(lower + 0.3, 0.05 * np.sqrt(upper) - 0.04 * np.sqrt(lower), error)


def fill(pump, effects=(), begun=None, **changes):
    constants, begun = {**CONSTANTS, **changes}, begun or begin()
    return simulate(read_plant("cascaded_tanks"), {"pump_v": pump}, constants, effects, begun, STEP_S)


def test_levels_rest_where_torricelli_says():
    reading = fill(np.full(3000, 2.5))
    upper = (0.04 * 2.5 / 0.05) ** 2
    lower = (0.05 * np.sqrt(upper) / 0.04) ** 2
    assert reading[-1] == pytest.approx(lower + 0.3, abs=1e-6)
    assert reading[0] == pytest.approx(6.3)
    np.testing.assert_allclose(
        read_plant("cascaded_tanks").simulate({"pump_v": np.full((9, 1), 2.5)}, STEP_S, np.zeros(1), CONSTANTS),
        lower + 0.3,
    )


@pytest.mark.parametrize(("held", "input_delay_s"), [(False, 0.0), (True, 0.5 * STEP_S)], ids=["straight", "held"])
def test_the_way_there_is_that_of_another_integrator(held, input_delay_s):
    pump = 2.5 + np.sin(0.05 * np.arange(200))

    def change(time, levels):
        at = time / STEP_S
        filled = 0.04 * (pump[min(int(at), 199)] if held else np.interp(at, np.arange(200), pump))
        down, out = 0.05 * np.sqrt(max(levels[0], 0.0)), 0.04 * np.sqrt(max(levels[1], 0.0))
        return [filled - down, down - out]

    exact = solve(change, [4.0, 6.0], np.arange(200) * STEP_S)
    np.testing.assert_allclose(fill(pump, input_delay_s=input_delay_s), exact[1] + 0.3, atol=2e-3)


def test_each_record_begins_where_its_own_first_readings_say(generator):
    pump = np.tile(2.5 + np.sin(0.05 * np.arange(300))[:, None], 2)
    levels = [(4.0, 6.0), (1.0, 9.0)]
    exact = np.stack([fill(column, begun=begin(*each)) for column, each in zip(pump.T, levels, strict=True)], axis=1)
    measured = exact + 0.02 * generator.standard_normal(exact.shape)
    begun = read_initial_state(list(measured[:HEAD].T), STEP_S)
    measured[HEAD:] = np.nan
    found = read_plant("cascaded_tanks").simulate(
        {"pump_v": pump, "level_v": measured}, STEP_S, np.zeros(1), CONSTANTS, (), begun
    )
    np.testing.assert_allclose(found, exact, atol=0.05)


def test_above_the_rim_water_runs_over_and_a_share_of_it_down():
    pump = np.full(3000, 4.0)
    lost, kept = (fill(pump, [(*RIM, {"scale_over_rim": 1.0, "share_down": share})])[-1] for share in (0.0, 1.0))
    assert lost - 0.3 == pytest.approx((0.05 * np.sqrt(5.0) / 0.04) ** 2, rel=1e-3)
    assert kept - 0.3 == pytest.approx((0.04 * 4.0 / 0.04) ** 2, rel=1e-3)


def test_a_rim_that_is_never_reached_and_a_reading_never_cut_change_nothing():
    pump = 1.5 + 0.5 * np.sin(0.05 * np.arange(500))
    effects = [
        (*RIM, {"scale_over_rim": 0.05, "share_down": 0.5}),
        (*CUT, {"share": 1.0, "lowest": 0.0, "highest": 20.0}),
    ]
    np.testing.assert_array_equal(fill(pump), fill(pump, effects))
    absent = [(*RIM, {"scale_over_rim": 0.0, "share_down": 0.5}), (*CUT, {"share": 0.0, "highest": 0.1})]
    np.testing.assert_array_equal(fill(np.full(500, 4.0)), fill(np.full(500, 4.0), absent))


def test_a_reading_is_cut_and_the_level_is_not():
    pump = np.concatenate([np.full(500, 4.0), np.full(500, 1.0)])
    plain, cut = fill(pump), fill(pump, [(*CUT, {"share": 1.0, "lowest": 1.4, "highest": 2.0})])
    assert plain.min() < 7.0
    np.testing.assert_array_equal(cut, np.clip(plain, 7.0, 10.0))
