"""Elements on a test bench: a planted loop is named and mended, and nothing is named where there is none."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from stages.science.discrepancy.amendment import estimate_intervals
from stages.science.discrepancy.fitted_channel import prepare
from stages.science.output_channels.records import thin_out
from tests.science.discrepancy.searches import DISCREPANCY, look, read_values
from tests.science.discrepancy.simulated_records import build_records, move, slide, tabulate, trail, wander
from tests.science.plant.machines import read_plant

STEP_S = 0.02
BLOCKS = 16


def pump_tanks(seed, rim=None, cut=None, samples=1600, levels=(4.0, 5.0)):
    """Levels of two tanks by small steps of Euler's rule; water above a soft rim runs over, half of it down."""
    generator = np.random.default_rng(seed)
    pump = 2.8 + np.convolve(generator.standard_normal(samples + 60), np.ones(60) / 8.0, mode="valid")[:samples]
    (upper, lower), reading = levels, np.empty(samples)
    for k in range(samples):
        reading[k] = lower
        for _ in range(40):
            over = 0.0 if rim is None else 0.3 * np.logaddexp(0.0, (upper - rim) / 0.05) * 0.05
            down = 0.05 * np.sqrt(upper)
            upper = max(upper + 0.1 * (0.045 * max(pump[k], 0.0) - down - over), 0.0)
            lower = max(lower + 0.1 * (down + 0.5 * over - 0.045 * np.sqrt(lower)), 0.0)
    reading += 0.02 * generator.standard_normal(samples)
    return {"pump_v": pump, "level_v": reading if cut is None else np.minimum(reading, cut)}


def build_tanks(**kwargs):
    signals, trials = tabulate(pump_tanks(**kwargs), step_s=4.0)
    return build_records(signals, trials, read_plant("cascaded_tanks"))


def build_force(way, force, **changes):
    return build_records(*tabulate({"position_m": way, "force_n": force}), read_plant(**changes))


def build(added=0.0, seed=1, hole=None, samples=4800):
    way = move(seed, samples)
    force = 300.0 * way + 2.0 + added + 0.05 * np.random.default_rng(seed).standard_normal(len(way))
    if hole is not None:
        force[hole] = np.nan
    return build_force(way, force)


def test_a_hidden_loop_is_named_and_mended():
    found, names = look(build(0.8 * slide(move(0, 1600), 0.004), 0, samples=1600))
    assert names == ["hysteresis"]
    state = found.outputs[0]
    after, before = (np.sqrt(each.raw.sum() / state.samples.sum()) for each in (state.current, state.nominal))
    assert before > 0.3
    assert after < 0.3 * before


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_nothing_is_named_where_nothing_is_missing(seed):
    assert look(build(seed=seed, samples=1600))[1] == []


@pytest.mark.parametrize(("high", "told"), [(280.0, "high"), (400.0, "")])
def test_a_value_that_stands_at_a_bound_says_so(high, told):
    way, constants = move(1), read_plant().model_dump()["constants"]
    constants["stiffness"] |= {"start": 250.0, "low": 200.0, "high": high, "sd": 50.0}
    force = 300.0 * way + 0.05 * np.random.default_rng(1).standard_normal(len(way))
    state = prepare(build_force(way, force, constants=constants))
    fitted = state.current.fit
    rows = estimate_intervals(fitted.model, fitted.values, state.noise, DISCREPANCY, np.random.default_rng(0))
    assert {row["parameter"]: row["at_bound"] for row in rows} == {"stiffness": told, "offset": ""}


def test_blocks_are_cut_as_recorded_and_gaps_are_not_judged():
    output = build(hole=slice(400, 450))
    assert output.measured.shape == (300, BLOCKS)
    assert not output.present[100:150, 1].any()
    assert output.present.sum() == 4800 - 50
    chosen = output.take([3, 1])
    np.testing.assert_array_equal(chosen.measured, output.measured[:, [3, 1]])
    constants = {"stiffness": 300.0, "offset": 2.0}
    np.testing.assert_array_equal(chosen.simulate(constants, []), output.simulate(constants, [])[:, [3, 1]])
    residual = (output.measured - output.simulate(constants, []))[output.present]
    assert residual.std() == pytest.approx(0.05, rel=0.05)


def test_a_loop_remembers_what_was_before_its_block():
    output = build()
    form = next(each for each in output.forms if each.form == "element_maxwell_slip")
    constants, values = {"stiffness": 300.0, "offset": 2.0}, {"share": 0.2, "width": 0.5}
    whole = output.simulate(constants, [(form, values)])
    np.testing.assert_array_equal(output.take([9]).simulate(constants, [(form, values)])[:, 0], whole[:, 9])


def test_samples_far_quicker_than_the_movement_are_averaged():
    way = np.repeat(move(1, 1200), 4)
    output = build_force(way, 300.0 * way + np.tile([1.0, -1.0], len(way) // 2), time_scale_s=8.0)
    assert output.step_s == pytest.approx(4 * STEP_S)
    np.testing.assert_allclose(output.measured, output.simulate({"stiffness": 300.0, "offset": 0.0}, []), atol=1e-9)


@pytest.mark.parametrize("stride", [4, 5])
def test_means_of_a_push_keep_its_sum_and_its_moment(generator, stride):
    """Then whatever it moves ends in the same place, with the same velocity; a gap stays one."""
    values = generator.standard_normal(200 * stride)
    values[: 3 * stride] = values[-3 * stride :] = 0.0
    places = np.arange(len(values))
    means = thin_out(pd.DataFrame({"force_n": values, "position_m": values}), stride, ("force_n",))
    middles = places.reshape(200, stride).mean(axis=1)
    assert stride * means["force_n"].sum() == pytest.approx(values.sum())
    assert stride * means["force_n"] @ middles == pytest.approx(values @ places)
    np.testing.assert_allclose(means["position_m"], values.reshape(200, stride).mean(axis=1))
    rows = pd.DataFrame({"force_n": generator.standard_normal(100)}, index=np.arange(100.0))
    rows.iloc[42] = np.nan
    lost = thin_out(rows, 10, ("force_n",))["force_n"].isna()
    assert np.flatnonzero(lost).tolist() == [2, 3, 4, 5]


def test_a_gap_that_no_motion_sees_costs_nothing():
    """A free mass remembers what pushed it for ever, so that one lost sample would be the end of its record."""
    time = np.arange(4000) * STEP_S
    force = np.sin(2.0 * np.pi * 0.2 * time)
    position = -force / (2.0 * np.pi * 0.2) ** 2
    for lost, judged in (([1000, 2500], 4000), (slice(1000, 1200), 1000)):
        pushed = force.copy()
        pushed[lost] = np.nan
        output = build_records(*tabulate({"force_n": pushed, "position_m": position}), read_plant("servo_drive"))
        assert output.present.sum() * output.averaged == pytest.approx(judged, abs=BLOCKS * output.averaged)


SWING = np.sin(2.0 * np.pi * 0.2 * STEP_S * np.arange(4000))


@pytest.mark.parametrize(
    ("force", "told"),
    [
        (np.where(np.arange(4000) < 500, np.nan, SWING), r"position_m: expected 10 samples or more .* values, after"),
        (np.zeros(4000), "signal force_n: expected an input that acts, got 0 throughout"),
        (np.full(4000, 2.5), r"signal force_n: expected an input that changes, got 2\.5 throughout; by"),
        (None, "signal force_n: expected values, got none; known are position_m"),
    ],
    ids=["a gap at first", "never acts", "never changes", "missing"],
)
def test_a_record_that_cannot_be_judged_is_refused(force, told):
    signals = {"position_m": -SWING} if force is None else {"force_n": force, "position_m": -SWING}
    with pytest.raises(ValueError, match=told):
        build_records(*tabulate(signals), read_plant("servo_drive"))


@pytest.mark.parametrize(("samples", "told"), [(45, "or set measurement.blocks=4 or fewer"), (29, "; record more$")])
def test_advice_on_short_records_can_be_followed(samples, told):
    with pytest.raises(ValueError, match=told):
        build_force(move(1, samples), move(2, samples))


@pytest.mark.parametrize("pulled", [1.0, 0.0])
def test_a_resonance_that_the_input_sets_off_is_no_noise(generator, pulled):
    """Of thirty samples a period, decaying in three."""
    decay, turn = np.exp(-1.0 / 90.0), 2.0 * np.pi / 30.0
    way = move(1) + 0.002 * generator.standard_normal(4800)
    rings = lfilter([0.0, 1.0], [1.0, -2.0 * decay * np.cos(turn), decay**2], way)
    force = 300.0 * way + pulled * rings / rings.std() + 0.05 * generator.standard_normal(4800)
    state = prepare(build_force(way, force, time_scale_s=2.0))
    gap = np.sqrt(state.nominal.raw.sum() / state.samples.sum())
    assert state.leftover.family == "memory" or not pulled  # of noise the family is that which happens to leave least
    assert (gap > 3.0 * 0.05 and state.floor < 0.6 * gap) if pulled else 0.97 * 0.05 < state.floor < 1.05 * 0.05


@pytest.mark.parametrize("heated", [0.0, 0.6])
def test_records_follow_one_another_in_the_order_of_the_file(generator, heated):
    """Twelve, whose names are no alphabet, of a clock that begins anew; the slope falls from the first to the last."""
    rows, blocks = [], []
    for k in range(12):
        way = move(k, 400)
        slope = 300.0 * (1.0 - heated * (k + np.arange(400) / 400.0) / 12.0)
        force = slope * way + 0.05 * generator.standard_normal(400)
        signals, trials = tabulate({"position_m": way, "force_n": force}, blocks=1)
        rows.append(signals.assign(record=f"run {k + 1}"))
        blocks.append(trials.assign(record=f"run {k + 1}"))
    output = build_records(pd.concat(rows), pd.concat(blocks), read_plant())
    np.testing.assert_allclose(output.start_s, 400 * STEP_S * np.arange(12))
    state = prepare(output)
    gap = np.sqrt(state.nominal.raw.sum() / state.samples.sum())
    assert state.floor == pytest.approx(0.05, rel=0.15)
    assert gap > 3.0 * 0.05 if heated else gap < 1.1 * 0.05


@pytest.mark.slow
@pytest.mark.parametrize("tau_s", [0.06, 0.0])
def test_a_filter_of_the_load_cell_is_named(generator, tau_s):
    """Of a cylinder with a spring; of the spring alone it would be creep of .79, or this, and without it a lag."""
    pressure, way = 300.0 + 100.0 * wander(generator, 3000, 60), move(1, 3000)
    law = pressure - 60.0 * (way - way.mean()) / np.ptp(way)
    force = trail(law, tau_s, STEP_S) if tau_s else law
    force = force + 0.3 * generator.standard_normal(3000)
    signals = {"s_m": way, "p_kpa": pressure, "f_n": force}
    named = {"along": "s_m", "pressure": "p_kpa", "output": "f_n", "second_pressure": None, "speed": None}
    found, names = look(build_records(*tabulate(signals), read_plant("cylinder", **named)))
    assert names == (["channel_misalignment"] if tau_s else [])
    (state,) = found.outputs
    assert state.ratio(state.current.raw) < 1.1
    if tau_s:
        assert [form.form for form in state.current.forms] == ["element_filtered"]
        seconds = read_values(state)[1]["channel_misalignment"]["paces"] * state.output.time_scale_s
        assert seconds == pytest.approx(tau_s, abs=0.5 * STEP_S)


@pytest.mark.slow
def test_a_hidden_cubic_overflow_and_cut_of_the_reading_are_named_and_nothing_without_them():
    way = move(4, 2400)
    middle = 0.5 * (way.min() + way.max())
    assert look(build(2.0e5 * (way - middle) ** 3, 4, samples=2400))[1][0] == "cubic_stiffness"
    assert look(build_tanks(seed=1, rim=6.0))[1] == ["overflow"]
    assert look(build_tanks(seed=3))[1] == []
    level = float(np.quantile(pump_tanks(seed=2)["level_v"], 0.85))
    found, names = look(build_tanks(seed=2, cut=level))
    assert names == ["saturation"]
    assert 5.0 * read_values(found.outputs[0])[1]["saturation"]["highest"] == pytest.approx(level, rel=0.01)


def test_records_of_tanks_that_begin_at_other_levels_leave_noise_alone():
    told = [
        tabulate(pump_tanks(seed, samples=500, levels=levels), 4.0, record)
        for seed, (record, levels) in enumerate({"a": (4.0, 5.0), "b": (1.0, 8.0), "c": (8.0, 2.0)}.items())
    ]
    signals, trials = (pd.concat(each, ignore_index=True) for each in zip(*told, strict=True))
    state = prepare(build_records(signals, trials, read_plant("cascaded_tanks")))
    assert state.ratio(state.nominal.raw) < 1.05
    assert np.sqrt(state.nominal.raw.sum() / state.samples.sum()) < 1.2 * 0.02
