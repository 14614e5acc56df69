"""The hardware stage: initial trials as ever, the protocol's passive trials where there is a protocol."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from pipeline.context import Context
from stages.science.rig.contract import RECORDING_COLUMNS, tidy
from stages.science.rig.manual import ManualRig, TrialRequested
from stages.science.rig.reference import replayed_trial
from stages.science.rig.sim import SimulatedRig
from stages.science.signals.lead_in import leave_out_lead_in
from tests.science.rig.test_manual import execute_by_hand
from tests.studies import read_stages, run_stage

PROTOCOL = ["+protocol=default", "protocol.experiments=2"]
STAGES = ["bank", "subsampling", "hardware"]


class MachineOfSteel(SimulatedRig):
    """A simulation that is told to be real."""

    real: ClassVar[bool] = True


KEPT_PACE = {"period_p50_s": pytest.approx(0.004), "period_p99_s": pytest.approx(0.004), "overruns": 0, "samples": 2000}


@pytest.fixture(scope="module")
def without(tmp_path_factory):
    """Tables without a protocol."""
    study, stages = read_stages(STAGES)
    return run_all(study, stages, STAGES, tmp_path_factory.mktemp("without"), {})


@pytest.fixture(scope="module")
def passive(tmp_path_factory, without):
    """Study, stages and tables with a protocol of two experiments of three trials, and the same bank."""
    study, stages = read_stages([*STAGES, "protocol"], *PROTOCOL)
    folder = tmp_path_factory.mktemp("passive")
    return study, stages, run_all(study, stages, ["protocol", "hardware"], folder, without)


def run_all(study, stages, names, folder, tables):
    tables = dict(tables)
    for name in names:
        tables.update(run_stage(study, stages[name], folder, tables))
    return tables


def test_without_a_protocol_there_are_no_recordings_of_one(without):
    table = without["protocol_recordings"]
    assert table.empty
    assert list(table.columns) == ["experiment", "trial", *RECORDING_COLUMNS]
    assert table["force_n"].dtype == float
    assert table["trial"].dtype == int


def check_executor(tables, rig, real):
    (row,) = tables["executed_by"].to_dict("records")
    assert row == {"rig": rig, "real": real, "sampling_rate_hz": 250.0, **KEPT_PACE}


def test_initial_trials_are_the_same_with_and_without_and_it_is_said_what_executed_them(without, passive):
    for tables in (without, passive[2]):
        check_executor(tables, "SimulatedRig", False)
    pd.testing.assert_frame_equal(passive[2]["hardware_recordings"], without["hardware_recordings"])
    assert without["hardware_recordings"]["participant"].eq("p1").all()


def test_every_commanded_trial_is_recorded_as_commanded(passive):
    commands, recordings = passive[2]["protocol_commands"], leave_out_lead_in(passive[2]["protocol_recordings"])
    assert recordings.groupby("experiment")["trial"].unique().map(list).to_dict() == {1: [1, 2, 3], 2: [1, 2, 3]}
    for name in ("experiment", "trial", "time_s", "muscle", "pressure_command_kpa"):
        np.testing.assert_array_equal(recordings[name], commands[name])


def test_recordings_are_sane(passive):
    study, _, tables = passive
    recordings, machine = leave_out_lead_in(tables["protocol_recordings"]), study.build("rig").exoskeleton
    lag = (recordings["pressure_kpa"] - recordings["pressure_command_kpa"]).abs()
    assert lag.max() < 60.0
    for muscle in machine.muscles:
        rows, joint = (
            recordings[recordings["muscle"] == muscle.name],
            machine.joints[machine.joint_names.index(muscle.joint)],
        )
        assert rows["joint_angle_rad"].between(joint.lower_rad, joint.upper_rad).all()
        assert rows["force_n"].gt(0).mean() > 0.9
        assert np.ptp(rows["joint_angle_rad"]) > 0.5


def test_is_what_the_rig_returns_for_a_passive_trial_with_nobody(passive, tmp_path):
    study, _, tables = passive
    rows = tables["protocol_commands"].query("experiment == 2 and trial == 3")
    drawn = Context("hardware", tmp_path, study.settings.seed, None, None, stream="hardware").generator("nobody", 2, 3)
    with study.build("rig") as rig:
        expected = tidy(rig.execute(replayed_trial(rows, rig, "nobody", ""), drawn), rig)
    found = tables["protocol_recordings"].query("experiment == 2 and trial == 3")
    for name in RECORDING_COLUMNS:
        np.testing.assert_array_equal(found[name], expected[name])


def test_a_real_rigs_trials_land_one_by_one_with_the_same_rows(passive, tmp_path):
    study, stages, tables = passive
    rig = MachineOfSteel.model_validate(study.build("rig").model_dump())
    found = run_stage(study, stages["hardware"], tmp_path, tables, rig)
    for name in ("hardware_recordings", "protocol_recordings"):
        pd.testing.assert_frame_equal(found[name], tables[name])
    check_executor(found, "MachineOfSteel", True)
    landed = sorted(each.name for each in (tmp_path / "parts" / "hardware").glob("nobody*"))
    assert landed == [f"nobody~{experiment}~{trial}" for experiment in (1, 2) for trial in (1, 2, 3)]


def test_an_operator_is_asked_for_passive_trials_and_told_that_nobody_moves(passive, tmp_path):
    study, stages, tables = passive
    few = tables | {"protocol_commands": tables["protocol_commands"].query("experiment == 1 and trial <= 2")}
    simulated = study.build("rig")
    rig = ManualRig(
        exoskeleton=simulated.exoskeleton, participants=simulated.participants, folder=str(tmp_path / "told")
    )
    asked, found = [], None
    while found is None and len(asked) < 6:
        try:
            found = run_stage(study, stages["hardware"], tmp_path, few, rig)
        except TrialRequested as request:
            asked.append(request.asks)
            execute_by_hand(request.asks)
    names = [
        f"{name} {number}" for name in ("p1 experiment 1 initial", "protocol experiment 1 trial") for number in (1, 2)
    ]
    assert [each["trial"] for each in asked] == names
    last = asked[-1]
    assert (last["kind"], last["participant"], last["reference_rad"]) == ("passive", "nobody", {})
    rows = few["protocol_commands"].query("trial == 2 and muscle == 'pam3'")
    assert last["pressure_command_kpa"]["pam3"] == list(rows["pressure_command_kpa"])
    told = pd.read_csv(Path(last["save_as"]))
    recorded = found["protocol_recordings"].query("trial == 2")
    np.testing.assert_array_equal(recorded["force_n"], told["force_n"])
    check_executor(found, "ManualRig", True)
