"""The discrepancy engine on a dynamic plant: an oscillator that hides a spring, or nothing."""

import numpy as np
import pytest
import yaml

from stages.discrepancy.fitted_cell import prepare
from stages.discrepancy.naming import SearchSettings
from stages.discrepancy.remainder import weigh_remainder
from stages.discrepancy.search import search
from stages.discrepancy.whole_record_cell import build_whole_records
from tests.discrepancy.oscillators import CONFIGURATION, NOISE_V, WANDER_V, configured, shake


@pytest.fixture(scope="module")
def settings():
    stated = yaml.safe_load((CONFIGURATION / "discrepancy" / "stated.yaml").read_text())
    return SearchSettings(**stated["search"])


def look_for(cell, settings, generator):
    found = search([prepare(cell)], settings, generator)
    return found, [each.name for each in found.named]


def compare(cell, fitted):
    """Root mean square of measured less simulated over the standard deviation of measured."""
    deviation = (cell.measured - cell.simulate(*fitted.fit.model.name_values(fitted.fit.values)))[cell.present]
    return float(np.sqrt(np.mean(deviation**2)) / cell.measured[cell.present].std())


@pytest.mark.slow
def test_a_hidden_hardening_spring_is_named_and_mended(settings, generator):
    cell = build_whole_records(*shake(generator, lambda x, w: 3.0 * x**3), configured("silverbox"))
    fitted, unused = cell.take(range(8)), cell.take(range(8, 12))
    found, names = look_for(fitted, settings, generator)
    state = found.cells[0]
    assert names == ["cubic_stiffness"]
    assert found.named[0].probability > 0.9
    share = state.current.fit.model.name_values(state.current.fit.values)[1][0][1]["share"]
    assert share == pytest.approx(3.0 * 0.2**2, rel=0.05)
    assert found.rounds[0].absorbed["sensor_offset"] > 0.99
    assert compare(unused, state.nominal) > 0.04
    assert compare(unused, state.current) < 1.05 * np.hypot(NOISE_V, WANDER_V / np.sqrt(2)) / unused.measured.std()


@pytest.mark.slow
def test_dry_friction_is_named(settings, generator):
    rub = 0.02
    cell = build_whole_records(
        *shake(generator, lambda x, w: rub * w / np.sqrt(w**2 + 0.005**2)), configured("silverbox")
    )
    assert look_for(cell, settings, generator)[1] == ["coulomb_friction"]


@pytest.mark.slow
def test_nothing_is_named_in_a_linear_oscillator(settings, generator):
    cell = build_whole_records(*shake(generator, lambda x, w: 0.0 * x), configured("silverbox"))
    found, names = look_for(cell, settings, generator)
    assert names == []
    assert weigh_remainder(found, settings, generator)["response_v"].unknown < 0.5


def test_blocks_can_be_taken_in_any_order(generator):
    signals, blocks = shake(generator, lambda x, w: x**3, records=3)
    cell = build_whole_records(signals, blocks, configured("silverbox"))
    constants = {each.name: each.prior_mean for each in cell.constants}
    whole = cell.simulate(constants, [])
    assert (cell.take([2, 0]).simulate(constants, []) == whole[:, [2, 0]]).all()
    assert (cell.take([2, 0]).measured == cell.measured[:, [2, 0]]).all()


def test_a_gap_in_the_input_is_not_judged_until_its_motion_has_died(generator):
    signals, blocks = shake(generator, lambda x, w: 0.0 * x, records=1, samples=1500)
    lost = (signals["signal"] == "drive_v") & signals["time_s"].between(0.9995, 1.0505)
    cell = build_whole_records(signals.assign(value=signals["value"].mask(lost)), blocks, configured("silverbox"))
    unjudged = np.flatnonzero(~cell.present[:, 0]) * cell.step_s + blocks["start_s"].iloc[0]
    assert unjudged[0] == pytest.approx(1.0, abs=0.003)
    assert unjudged[-1] == pytest.approx(1.05 + np.log(1e3) / (2 * np.pi * 68.0 * 0.05), abs=0.005)


def test_the_end_of_a_short_block_is_not_judged(generator):
    signals, blocks = shake(generator, lambda x, w: 0.0 * x, records=2)
    cell = build_whole_records(signals, blocks.assign(start_s=[0.0, 0.6], samples=[1000, 200]), configured("silverbox"))
    assert cell.present[:, 0].sum() == 1000
    assert (np.flatnonzero(cell.present[:, 1]) == np.arange(200)).all()


def test_a_record_begins_in_the_motion_that_its_first_samples_show(generator):
    signals, blocks = shake(generator, lambda x, w: 0.0 * x, records=3)
    late = signals[signals["time_s"] > 0.5].copy()
    late["time_s"] -= late["time_s"].min()
    cell = build_whole_records(late, blocks.assign(start_s=0.0, samples=600), configured("silverbox"))
    constants = {each.name: each.prior_mean for each in cell.constants}
    error = cell.measured - cell.simulate(constants, [])
    assert np.sqrt((error[:30] ** 2).mean()) < 3.0 * np.hypot(NOISE_V, WANDER_V)


def test_a_missing_signal_is_refused(generator):
    signals, blocks = shake(generator, lambda x, w: 0.0 * x, records=1)
    plant = configured("silverbox").model_copy(update={"output": "answer_v"})
    with pytest.raises(ValueError, match="signal answer_v: expected values, got none; known are drive_v, response_v"):
        build_whole_records(signals, blocks, plant)
