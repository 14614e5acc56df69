"""The time-shift analysis against SciPy and statsmodels, with planted verdicts, and the stage on a small bank."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pipeline.context import Context
from stages.paper.time_shift import Config, TimeShift, compare_shifts, summarise, time_shift
from stages.science.figures.learning_curves import draw_shift_curves
from tests import planted
from tests.planted import assert_holm, assert_paired
from tests.science.muscle_models.data import LOOP, MUSCLES, make_bank, make_tables
from tests.studies import PickledContext, run_alone, stop_after

SECTION = {"amplitudes_s": [0.1, 0.3], "experiments": 2, "margin": 0.005, "loop": {**LOOP, "trials": 2}}


def make_curve(generator, costs, experiments=12, sd=0.001, tested_on=("bank",)):
    """Return error rates where each amplitude costs so much after every trial, on top of what experiments share."""
    means = {0.0: 0.05, **{amplitude_s: 0.05 + cost for amplitude_s, cost in costs.items()}}
    curve = planted.make_curve(generator, means, experiments, sd / 2.0, tested_on, people=("p1",), start=0.08)
    curve["error_rate"] += curve["experiment"].map(pd.Series(0.01 * generator.standard_normal(experiments + 1)))
    return curve.rename(columns={"arm": "amplitude_s"}).assign(rmse_n=100.0 * curve["error_rate"])


def compared(curve, margin=0.005):
    return compare_shifts(curve, margin).set_index(["amplitude_s", "tested_on", "measure"])


@pytest.mark.parametrize(
    ("cost", "sd", "verdict"),
    [
        (0.02, 0.001, "worse with shift"),
        (-0.02, 0.001, "better with shift"),
        (0.0, 0.001, "equivalent"),
        (0.002, 0.0005, "worse within the margin"),
        (-0.002, 0.0005, "better within the margin"),
        (0.0, 0.05, "undecided"),
    ],
)
def test_planted_costs_turn_the_verdict(cost, sd, verdict, generator):
    told = compared(make_curve(generator, {0.3: cost}, sd=sd))
    assert set(told["verdict"]) == {verdict}
    assert np.sign(told["difference"]).eq(np.sign(cost)).all() or not cost


def test_each_amplitude_and_test_set_has_its_own_verdict(generator):
    curve = make_curve(generator, {0.1: 0.0, 1.0: 0.02}, tested_on=("bank", "unseen_bank"))
    told = compared(curve)
    assert_holm(told, 8)
    verdicts = told["verdict"]
    assert (verdicts.loc[0.1] == "equivalent").all()
    assert (verdicts.loc[1.0] == "worse with shift").all()


def test_agrees_with_scipy_and_statsmodels(generator):
    curve = make_curve(generator, {0.3: 0.001}, sd=0.004)
    averages = curve.groupby(["amplitude_s", "experiment", "trial"])["error_rate"].mean().unstack("trial")
    values = {"final": averages[2], "curve": averages[[1, 2]].mean(axis=1)}
    told = compared(curve)
    for measure, each in values.items():
        row = told.loc[(0.3, "bank", measure)]
        shifted, without = each.loc[0.3].to_numpy(), each.loc[0.0].to_numpy()
        assert_paired(row, shifted, without, 0.005)
        assert (row["with_mean"], row["without_mean"]) == pytest.approx((shifted.mean(), without.mean()))
        assert row["before"] == pytest.approx(averages[0].loc[0.0].mean())
        assert row["n"] == 12


def test_one_experiment_decides_nothing(generator):
    told = compared(make_curve(generator, {0.3: 0.02}, experiments=1))
    assert (told["verdict"] == "undecided").all()
    assert told[["low", "high", "d_z", "p_t", "p_holm", "p_tost", "power", "n_needed"]].isna().all(axis=None)


def test_curves_are_means_over_experiments_of_averages_over_muscles(generator):
    curve = make_curve(generator, {0.3: 0.02}, sd=0.01)
    told = summarise(curve).set_index(["tested_on", "amplitude_s", "trial"]).loc[("bank", 0.3, 2)]
    its = curve.query("amplitude_s == 0.3 and trial == 2").groupby("experiment")["error_rate"].mean()
    assert (told["error_rate_mean"], told["error_rate_sd"]) == pytest.approx((its.mean(), its.std(ddof=1)))


def test_the_figure_has_a_panel_for_each_test_set_and_a_line_for_each_amplitude(generator):
    curve = make_curve(generator, {0.1: 0.0, 0.3: 0.02}, tested_on=("bank", "unseen_bank"))
    axes = draw_shift_curves(summarise(curve)).axes
    assert [axis.get_title() for axis in axes] == ["tested on the bank", "tested on an unseen bank"]
    lines = [container.lines[0] for container in axes[1].containers]
    assert [line.get_label() for line in axes[1].containers] == ["none", "up to 0.1 s", "up to 0.3 s"]
    assert len({(line.get_marker(), line.get_linestyle()) for line in lines}) == 3
    expected = 100 * summarise(curve).query("tested_on == 'unseen_bank' and amplitude_s == 0.3")["error_rate_mean"]
    np.testing.assert_allclose(np.asarray(lines[2].get_ydata(), dtype=float), expected.to_numpy())


def run(folder, tables, context=PickledContext, **section):
    cfg = Config(time_shift=TimeShift(**{**SECTION, **section}), seed=0)
    return list(run_alone(time_shift, cfg, folder, tables, context=context).values())


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    generator = np.random.default_rng(3)
    tables = {**make_tables(generator), "unseen_bank": make_bank(generator, movements=2)}
    folder = tmp_path_factory.mktemp("time_shift")
    curve, comparison = run(folder, tables, Context)
    return SimpleNamespace(tables=tables, folder=folder, curve=curve, comparison=comparison)


def test_the_stage_tells_every_trial_and_compares_every_amplitude(small):
    assert len(small.curve) == 3 * 2 * 3 * 2 * len(MUSCLES)
    assert len(small.comparison) == 2 * 2 * 2
    assert (small.comparison["n"] == 2).all()
    largest = small.tables["unseen_bank"].groupby("muscle")["force_n"].max()
    unseen = small.curve.query("tested_on == 'unseen_bank'")
    np.testing.assert_allclose(unseen["rmse_n"], unseen["error_rate"] * unseen["muscle"].map(largest))
    assert (small.folder / "figures" / "time_shift.png").exists()


def test_experiments_are_paired(small):
    curve = small.curve.set_index(["experiment", "tested_on", "muscle"])
    first = curve[curve["trial"] == 0]
    for amplitude_s in (0.1, 0.3):
        same = first[first["amplitude_s"] == amplitude_s]["error_rate"] - first[first["amplitude_s"] == 0]["error_rate"]
        assert (same == 0).all()
    last = curve[curve["trial"] == 2]
    assert (last[last["amplitude_s"] == 0.3]["error_rate"] != last[last["amplitude_s"] == 0]["error_rate"]).any()
    assert first[first["amplitude_s"] == 0]["error_rate"].nunique() == len(first) / 3


def test_amplitudes_do_not_depend_on_the_others_and_the_unseen_bank_may_be_absent(small, tmp_path):
    tables = {name: table for name, table in small.tables.items() if name != "unseen_bank"}
    curve, comparison = run(tmp_path, tables, amplitudes_s=[0.3], experiments=1)
    assert set(comparison["tested_on"]) == {"bank"}
    same = small.curve.query("amplitude_s != 0.1 and experiment < 2 and tested_on == 'bank'")
    pd.testing.assert_frame_equal(curve, same.reset_index(drop=True))


def test_a_killed_run_goes_on_and_a_copy_in_another_process_finds_the_same(small, tmp_path, monkeypatch):
    stop_after(monkeypatch, 1, run, tmp_path, small.tables)
    landed = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "parts" / "time_shift").iterdir()}
    assert sorted(landed) == ["experiment 1"]
    curve, comparison = run(tmp_path, small.tables)
    assert {name: (tmp_path / "parts" / "time_shift" / name).stat().st_mtime_ns for name in landed} == landed
    pd.testing.assert_frame_equal(curve, small.curve)
    pd.testing.assert_frame_equal(comparison, small.comparison)
