"""Trials that tell names apart: executed as proposed, within the rig's limits, fitted; and none where none would."""

from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest

from stages.identification import discrimination_trials as stage_module
from stages.identification.discrimination_trials import NothingToTell, choose_allowed
from stages.science.discrepancy.excitations import SHAPES
from stages.science.discrepancy.further_trial import choose_next
from stages.science.discrepancy.parts import list_parts
from stages.science.plant.effect import list_effects
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.sources import read_executed, tabulate
from stages.science.rig.reference import replayed_trial
from tests.cpx_e.rig import emulate_rig
from tests.studies import assert_refused, read_stages, run_stage

STAGES = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop", "discrimination_trials"]
RIVALS = "transport_delay", "valve_lag"
OTHERS = ",".join(name for name in list_effects() if name not in RIVALS)
LATE = "rig_plant.effects=[{name: transport_delay, muscles: null, delay_s: 0.003}]"
SMALL = (
    "workflow=identification_with_naming",
    "subsampling.experiments=1",
    "active_loop.trials=4",
    "next_trials=1",
    "propose_trial.least_gain=0.0",
)
AMBIGUOUS = (*SMALL, "plant@rig_plant=nominal", LATE, f"discrepancy.search.left_out=[{OTHERS}]")
"""A command that acts 3 ms late, which a second lag of the valve would explain nearly as well."""


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The study, its stages, tables of designed trials, and what a search of them proposes."""
    study, stages = read_stages([*STAGES, "measurement"], *AMBIGUOUS)
    folder, tables = tmp_path_factory.mktemp("designed"), {}
    for name in STAGES[:-1]:
        tables.update(run_stage(study, stages[name], folder, tables))
    cfg = study.config(stages["discrimination_trials"])
    source = read_executed(cfg.exoskeleton, tables["hardware_recordings"], tables["active_recordings"], None)
    measured, _ = tabulate(source, cfg.exoskeleton, cfg.measurement.largest_jitter)
    settings = cfg.parts, cfg.discrepancy, cfg.propose_trial
    known = choose_next(cfg.plant, measured, *settings, *map(np.random.default_rng, (0, 1)), lead_in_s=1.0)
    return study, stages, tables, known


@pytest.fixture(scope="module")
def executed(designed, tmp_path_factory):
    """The stage's tables, of the same search."""
    study, stages, tables, known = designed
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(stage_module, "choose_next", lambda *args: known)
        return run_stage(study, stages["discrimination_trials"], tmp_path_factory.mktemp("executed"), tables)


def test_what_was_proposed_is_executed_in_the_range_of_what_was_recorded(designed, executed):
    _, _, tables, known = designed
    weighed, best = known.weighed, known.weighed.order[0]
    (row,) = executed["discrimination_trials"].to_dict("records")
    assert {each.split()[0] for each in row["rivals"].split(", ")} == {"none", *RIVALS}  # too few trials confirm either
    assert executed["discrimination_end"]["executed"].item() == 1
    assert row["excitation"] == weighed.spell(best)
    assert row["expected_before"] < row["expected_after"] <= 1.0
    recorded = executed["discrimination_recordings"]
    assert recorded["time_s"].min() == pytest.approx(-1.0)
    before = pd.concat([tables["hardware_recordings"], tables["active_recordings"]]).groupby("muscle")
    movement_s = weighed.outputs[0].time_scale_s
    for muscle, rows in recorded[recorded["time_s"] >= 0.0].groupby("muscle"):
        seen = before.get_group(muscle)
        for lever, column, least in (
            ("pressure_command_kpa", "pressure_command_kpa", 0.99),
            ("motion", "joint_angle_rad", 0.8),
        ):
            share = SHAPES[weighed.kinds[best][lever]](rows["time_s"].to_numpy(), movement_s)
            told, span = rows[column].to_numpy(), np.ptp(seen[column])
            if np.ptp(share) > 0.0:
                assert np.corrcoef(share, told)[0, 1] > least
            else:
                assert np.ptp(told) < (1.0 - least + 1e-9) * 2.0 * span
            assert seen[column].min() - 0.1 * span < told.min() <= told.max() < seen[column].max() + 0.1 * span


def test_what_was_executed_is_fitted_and_the_test_trials_stay_the_same(designed, executed, tmp_path):
    study, stages, tables, _ = designed
    cfg, parts = study.config(stages["discrimination_trials"]), {}
    for name, more in (("without", {}), ("with", executed)):
        given = {**tables, "discrimination_recordings": None, **more}
        found = run_stage(study, stages["measurement"], tmp_path, given)
        measured = MeasuredTables(*(found[each.name] for each in fields(MeasuredTables)))
        rows = list_parts(measured.measured_trials, cfg.parts, cfg.discrepancy.verification_share)
        parts[name] = rows.set_index("trial")["part"]
    assert list(parts["with"].index) == [*parts["without"].index, 6]
    assert parts["with"][6] == "fitted"
    pd.testing.assert_series_equal(parts["with"][:6], parts["without"])


class Limited:
    """A rig whose limits allow but a few of the banks that it is asked for."""

    def __init__(self, rig, allowed):
        self.rig, self.allowed, self.asked = rig, allowed, []

    def __getattr__(self, name):
        return getattr(self.rig, name)

    def check_bank(self, samples, by):
        self.asked.append(samples[by].iloc[0])
        if len(self.asked) not in self.allowed:
            raise ValueError("too fast")


def choose(designed, allowed=(1,), **changed):
    study, stages, tables, known = designed
    cfg = study.config(stages["discrimination_trials"])
    cfg = cfg.model_copy(update={"propose_trial": cfg.propose_trial.model_copy(update=changed)})
    rig = Limited(study.build("rig"), allowed)
    resting = tables["hardware_recordings"].groupby("muscle")[["pressure_command_kpa", "joint_angle_rad"]].mean()
    return choose_allowed(known.weighed, cfg, rig, 1.0, resting, np.random.default_rng(3)), rig.asked


def test_the_best_trial_that_the_rigs_limits_allow_is_executed(designed):
    order = designed[3].weighed.order
    (chosen, rows), asked = choose(designed, (4,), least_gain=-1.0)
    assert (chosen, asked) == (order[3], order[:4])
    assert rows.groupby("muscle").size().tolist() == [1000] * 4
    with pytest.raises(NothingToTell, match="the rig's limits allow no kind of trial"):
        choose(designed, (), least_gain=-1.0)


def test_what_was_proposed_passes_the_limits_of_an_emulated_rig(designed):
    study, stages, tables, known = designed
    cfg, generator = study.config(stages["discrimination_trials"]), np.random.default_rng(4)
    resting = tables["hardware_recordings"].groupby("muscle")[["pressure_command_kpa", "joint_angle_rad"]].mean()
    with emulate_rig("exoskeleton.trial_s=4.0") as (_, rig), rig:
        _, rows = choose_allowed(known.weighed, cfg, rig, 1.0, resting, generator)
        recording = rig.execute(replayed_trial(rows, rig, "p1", "told apart"), generator)
    after = recording.time_s >= 0.0
    assert (recording.status == "ok").all()
    assert (recording.clipped_by[after] == "").all()
    commands = rows.pivot(index="time_s", columns="muscle", values="pressure_command_kpa")[list(rig.muscles)]
    np.testing.assert_allclose(recording.pressure_command_kpa[after], commands, atol=0.5)


def test_no_trial_is_executed_that_tells_too_little_and_random_ones_are_any(designed):
    weighed = designed[3].weighed
    with pytest.raises(NothingToTell, match="less than propose_trial"):
        choose(designed, least_gain=0.9)
    gains = weighed.probability[weighed.order] - weighed.expected_now
    with pytest.raises(NothingToTell, match="the best kind of trial that the rig allows would raise"):
        choose(designed, (len(gains),), least_gain=float(gains[0]) - 1e-9)
    (chosen, _), asked = choose(designed, choice="random", least_gain=0.9)
    assert asked == [chosen]


def test_where_nothing_is_asked_no_trial_is_executed(designed, tmp_path, monkeypatch):
    study, stages, tables, known = designed
    settled = replace(known, question=None, weighed=None)
    monkeypatch.setattr(stage_module, "choose_next", lambda *args: settled)
    found = run_stage(study, stages["discrimination_trials"], tmp_path, tables)
    assert found["discrimination_trials"].empty
    (end,) = found["discrimination_end"].to_dict("records")
    assert end == {"executed": 0, "reason": "no two names are likely enough to be told apart"}


def test_without_trials_the_rig_is_left_alone(designed, tmp_path):
    tables = designed[2]
    none, stages = read_stages(STAGES, *AMBIGUOUS, "next_trials=0")
    found = run_stage(none, stages["discrimination_trials"], tmp_path, tables, rig=object())
    assert found["discrimination_recordings"].empty
    assert found["discrimination_end"]["executed"].item() == 0


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (("rig=replay", f"rig.recordings.free=[{__file__}]"), "next_trials: expected 0, as this rig returns trials"),
        (("measured=recording.csv",), "next_trials: expected 0, as measured=PATH is searched"),
    ],
)
def test_what_cannot_be_executed_or_is_not_searched_is_refused(overrides, told):
    assert_refused(STAGES, told, *SMALL, *overrides)


@pytest.mark.slow
def test_a_further_trial_is_added_to_those_that_there_are(pamid):
    small = (*AMBIGUOUS, "budget=tiny", "active_loop.trials=4", "figures=[]")
    first = pamid(*small, "stages=[bank,subsampling,hyperprior,task,hardware,active_loop,discrimination_trials]")
    assert first.returncode == 0, first.stderr
    again = pamid(*small, "next_trials=2")
    assert again.returncode == 0, again.stderr
    one, two = (pd.read_parquet(run / "tables/discrimination_recordings.parquet") for run in pamid.runs)
    assert list(two["trial"].unique()) == [1, 2]
    pd.testing.assert_frame_equal(two[two["trial"] == 1], one)
    steps = pd.read_parquet(pamid.runs[-1] / "tables/error_by_step.parquet")
    amended = steps[steps["step"].str.startswith("amended plant before")]
    assert list(amended["executed"]) == [6, 7]
    summary = pd.read_parquet(pamid.runs[-1] / "tables/grey_box_summary.parquet").query("muscle == 'mean'")
    rates = summary.set_index("tested_on")["amended_plant"]
    last = steps[steps["step"].str.startswith("amended")].iloc[-1]
    assert last["executed"] == 8
    assert [last["task"], last["bank"]] == pytest.approx([rates["task"], rates["bank"]])
