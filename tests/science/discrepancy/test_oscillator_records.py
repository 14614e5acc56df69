"""The discrepancy engine on a dynamic plant: an oscillator that hides friction, or nothing."""

import numpy as np
import pytest

from stages.science.discrepancy.decision import decide
from tests.science.discrepancy.oscillators import NOISE_V, WANDER_V, configured, shake
from tests.science.discrepancy.searches import DISCREPANCY, look
from tests.science.discrepancy.simulated_records import build_records


@pytest.mark.slow
@pytest.mark.parametrize(("rub", "told"), [(0.02, ["coulomb_friction"]), (0.0, [])], ids=["dry friction", "nothing"])
def test_dry_friction_is_named_and_nothing_in_a_linear_oscillator(rub, told, generator):
    signals, blocks = shake(generator, lambda x, w: rub * w / np.sqrt(w**2 + 0.005**2))
    found, names = look(build_records(signals, blocks, configured("silverbox")))
    assert names == told
    assert told or decide(found, DISCREPANCY, generator).status == "no_discrepancy"


@pytest.fixture(scope="module")
def linear():
    """Signals and blocks of three records without any effect."""
    return shake(np.random.default_rng(20260701), lambda x, w: 0.0 * x, records=3)


def test_a_gap_in_the_input_is_not_judged_until_its_motion_has_died(linear):
    signals, blocks = linear
    lost = (signals["signal"] == "drive_v") & signals["time_s"].between(0.9995, 1.0505)
    lost &= signals["record"] == "record 0"
    output = build_records(signals.assign(value=signals["value"].mask(lost)), blocks, configured("silverbox"))
    unjudged = np.flatnonzero(~output.present[:, 0]) * output.step_s + blocks["start_s"].iloc[0]
    assert unjudged[0] == pytest.approx(1.0, abs=0.003)
    assert unjudged[-1] == pytest.approx(1.05 + np.log(1e3) / (2 * np.pi * 68.0 * 0.05), abs=0.005)
    assert output.present[:, 1:].all()


def test_the_end_of_a_short_block_is_not_judged(linear):
    signals, blocks = linear
    blocks = blocks[:2].assign(start_s=[0.0, 0.6], samples=[1000, 200])
    output = build_records(signals, blocks, configured("silverbox"))
    assert output.present[:, 0].sum() == 1000
    assert (np.flatnonzero(output.present[:, 1]) == np.arange(200)).all()


def test_a_record_begins_in_the_motion_that_its_first_samples_show(linear):
    signals, blocks = linear
    late = signals[signals["time_s"] > 0.5].copy()
    late["time_s"] -= late["time_s"].min()
    output = build_records(late, blocks.assign(start_s=0.0, samples=600), configured("silverbox"))
    constants = {each.name: each.prior_mean for each in output.constants}
    simulated = output.simulate(constants, [])
    assert np.sqrt(((output.measured - simulated)[:30] ** 2).mean()) < 3.0 * np.hypot(NOISE_V, WANDER_V)
    assert (output.take([2, 0]).simulate(constants, []) == simulated[:, [2, 0]]).all()
