"""Which trials are fitted, opened and only reported; what a shorter one lacks counts for nothing."""

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.dataset import build_dataset
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.parts import Parts, assign_parts, leave_gaps
from stages.science.discrepancy.settings import choose_verification
from stages.science.recording.datasets import tabulate_session
from tests.science.discrepancy.searches import DISCREPANCY
from tests.science.discrepancy.sessions import record_session
from tests.science.discrepancy.simulated_records import build_records, tabulate
from tests.science.plant.machines import configured, read_plant

GIVEN = ["estimation"] * 8 + ["validation"] * 3 + ["arrow"] * 2


def choose(fitted=None, verification=None, last_share=None):
    return Parts(fitted=fitted, verification=verification, last_share=last_share, gap_share=0.05)


@pytest.mark.parametrize(
    ("names", "purposes"),
    [
        ({"fitted": ["estimation"]}, "ffvffvfv ooo oo"),
        ({"fitted": ["estimation"], "verification": ["validation"]}, "ffffffff vvv oo"),
        ({"fitted": ["estimation"], "last_share": 0.4}, "fffffvvv ooo oo"),
        ({"verification": ["arrow"]}, "ffffffff fff vv"),
        ({}, "ffvffvfv ffv ff"),
        ({"last_share": 0.01}, "ffffffff fff fv"),
    ],
    ids=["share of a part", "named part", "last of a part", "all but a named part", "share of all", "at least one"],
)
def test_trials_are_opened_within_the_fitted_part_or_in_a_named_one(names, purposes):
    found = "".join(purpose[0] for purpose in assign_parts(GIVEN, choose(**names), 0.375))
    assert found == purposes.replace(" ", "")


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ({"fitted": ["estimatoin"]}, "no part 'estimatoin' was recorded; did you mean 'estimation'"),
        ({"fitted": ["arrow"]}, "at least 3 trials"),
        ({"verification": ["estimation", "validation", "arrow"]}, "at least 2 trials to fit, got 0"),
        ({"fitted": ["arrow"], "verification": ["arrow", "validation"]}, "got arrow in both"),
        ({"verification": ["arrow"], "last_share": 0.4}, "verification or last_share, got both"),
    ],
)
def test_impossible_parts_are_refused(names, told):
    with pytest.raises(ValueError, match=told):
        assign_parts(GIVEN, choose(**names), 0.375)


def opened(parts, records, **names):
    purposes = assign_parts(parts, choose(**names), 0.375, records)
    return [k for k, purpose in enumerate(purposes) if purpose == "verification"]


@pytest.mark.parametrize(("count", "kept"), [(3, 1), (4, 2), (5, 2), (6, 2), (8, 3), (16, 6)])
def test_whole_records_are_opened_the_nearest_number_to_the_share(count, kept):
    records = [f"r{k}" for k in range(count) for _ in range(2)]
    found = opened(["given"] * len(records), records)
    assert len({records[k] for k in found}) == kept
    assert len(found) == 2 * kept
    assert count != 6 or {records[k] for k in found} == {"r2", "r5"}


@pytest.mark.parametrize(
    ("parts", "records"),
    [
        (["given"] * 16, ["a"] * 8 + ["b"] * 8),
        (["noise"] * 8 + ["steps"] * 8 + ["sweep"] * 8, ["noise"] * 8 + ["steps"] * 8 + ["sweep"] * 8),
        (["given"] * 24, [f"r{k}" for k in range(24)]),
    ],
)
def test_records_that_are_no_repetitions_are_opened_block_by_block(parts, records):
    assert opened(parts, records) == opened(parts, [])


def make_blocks(count=4, samples=50, record="a"):
    return pd.DataFrame({"record": record, "start_s": np.arange(count) * samples * 0.1, "samples": samples})


def test_a_gap_stands_between_a_fitted_block_and_the_opened_one_beside_it():
    trials = pd.concat([make_blocks(2, record=""), make_blocks(), make_blocks(record="b")], ignore_index=True)
    f, v, o = "fitted", "verification", "other"
    gaps = leave_gaps(trials, [f, v, f, v, f, f, v, o, f, v], 0.05)
    assert gaps["left_after"].tolist() == [0, 0, 3, 0, 0, 0, 0, 0, 3, 0]
    assert gaps["left_before"].tolist() == [0, 0, 0, 0, 3, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("machine", ["second_order", "static_map"])
def test_a_gap_is_not_judged_and_nothing_else_is_lost(machine):
    swing = machine == "second_order"
    plant = read_plant(machine, **({} if swing else {"time_scale_s": 1.0}))
    names = ("drive_v", "response_v") if swing else ("position_m", "force_n")
    rows, _ = tabulate({name: np.sin(np.arange(200) * 0.1 + k) for k, name in enumerate(names)}, 0.1)
    trials = make_blocks()
    gaps = leave_gaps(trials, ["fitted", "verification", "fitted", "fitted"], 0.1)
    whole, cut = (build_records(rows, each, plant) for each in (trials, trials.join(gaps)))
    assert (whole.present & ~cut.present).sum(axis=0).tolist() == [5, 0, 5, 0]
    assert not cut.present[45:, 0].any()
    assert not cut.present[:5, 2].any()
    assert cut.present[5:, 2].all()
    np.testing.assert_array_equal(cut.measured, whole.measured)


@pytest.mark.parametrize(
    ("trials", "share", "chosen"), [(10, 0.2, [4, 9]), (12, 0.25, [3, 7, 11]), (4, 0.7, [1, 2]), (3, 0.01, [2])]
)
def test_verification_trials_are_spread_evenly_at_least_the_last_and_two_are_left_to_fit(trials, share, chosen):
    assert choose_verification(trials, share) == chosen


def test_a_shorter_trial_shortens_no_other():
    samples, meta = record_session(trials=6, seconds=0.6, muscles=("pam1",))
    samples = samples[(samples["trial"] != 2) | (samples["time_s"] < 0.4)]
    rows = samples.groupby("trial").size()
    assert rows[2] < rows[1]
    for output in build_muscle_channels(tabulate_session(samples, meta, "short"), DISCREPANCY):
        np.testing.assert_array_equal(output.present.sum(axis=0), rows // 2)  # recorded at 250 Hz, judged at 125
        own = samples.pivot(index="time_s", columns="trial", values=output.channel).ffill().to_numpy()
        padded = np.pad(own, ((1, 1), (0, 0)), mode="edge")
        smooth = (0.25 * padded[:-2] + 0.5 * own + 0.25 * padded[2:])[::2]
        np.testing.assert_allclose(output.measured[output.present], smooth[output.present])


def test_constants_that_meta_json_does_not_tell_are_those_of_the_plant():
    samples, meta = record_session(trials=4, seconds=0.6, muscles=("pam1",))
    tables = tabulate_session(samples, {**meta, "nominal": {"valve_tau_s": 0.051}}, "short")
    plant, purposes = configured().plant, pd.DataFrame({"trial": range(4), "part": "fitted"})
    outputs = build_dataset(plant, tables, purposes, DISCREPANCY).outputs
    told = {each.name: each.prior_mean for output in outputs for each in output.constants}
    usual = plant.find_model("pam1", meta["muscles"]["pam1"]["type"])
    expected = (0.051, usual.braid_angle_deg, usual.contraction_factor, usual.damping_n_s)
    names = ("valve_tau_s", "braid_angle_deg", "contraction_factor", "damping_n_s")
    assert tuple(told[name] for name in names) == expected


def test_a_type_of_muscle_without_constants_or_largest_pressure_is_refused():
    samples, meta = record_session(trials=4, seconds=0.6, muscles=("pam1",))
    unknown = {"pam1": {**meta["muscles"]["pam1"], "type": "MAS-5"}}
    purposes = pd.DataFrame({"trial": range(4), "part": "fitted"})
    bare = tabulate_session(samples, {**meta, "muscles": unknown, "nominal": {}}, "short")
    with pytest.raises(ValueError, match="no constants for muscle pam1 or its type MAS-5"):
        build_dataset(configured().plant, bare, purposes, DISCREPANCY)
    told = tabulate_session(samples, {**meta, "muscles": unknown}, "short")
    with pytest.raises(ValueError, match=r"type \+discrepancy.max_pressure_kpa.MAS-5=600"):
        build_dataset(configured().plant, told, purposes, DISCREPANCY)


def test_the_share_that_the_past_makes_is_zero_if_reversed_time_leaves_the_force():
    built = build_muscle_channels(tabulate_session(*record_session(trials=2, muscles=("pam1",)), "two"), DISCREPANCY)
    force = next(each for each in built if each.channel == "force_n")

    def share(form, **values):
        return force.find_past_share(form, {each.name: each.starts[-1] for each in form.parameters} | values)

    shares = {form.name: share(form) for form in force.forms}
    assert all(shares[name] < 1e-6 for name in ("cubic_stiffness", "moment_arm_variation", "sensor_gain"))
    assert all(shares[name] > 0.2 for name in ("hysteresis", "creep", "coulomb_friction", "channel_misalignment"))
    assert shares["viscous_friction"] == pytest.approx(1.0, abs=0.01)
    opening = next(form for form in force.forms if form.form == "opening")
    at_once, late = (share(opening, slack=0.03, load=0.2, tau_s=tau_s) for tau_s in (0.0, 0.1))
    assert at_once < 1e-6 < 0.2 < late


def test_the_last_share_is_that_of_each_record_of_several_blocks_and_of_all_that_are_one():
    assert opened(["given"] * 10, list("aaaaabbbbb"), last_share=0.4) == [3, 4, 8, 9]
    assert opened(["given"] * 7, list("aaaaabc"), last_share=0.4) == [3, 4, 6]
    assert opened(["given"] * 5, list("abcde"), last_share=0.4) == [3, 4]
    assert opened(["given"] * 5, [""] * 5, last_share=0.4) == [3, 4]
