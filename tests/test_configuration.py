"""What the main job's configuration refuses, and with which words; nothing is run here."""

import re
import shlex

import pytest
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser

from pipeline.config import read_study
from pipeline.errors import ConfigError
from tests.composing import compose_values
from tests.conftest import ROOT

NEED_A_PATH = ("rig=manual", "rig=replay", "rerun=")
"""Parts of commands that name what is not here."""


def validated(*overrides):
    return read_study(compose_values(*overrides))


REFUSED = """\
active_loop.trials=0 -> : input should be greater than 0, got 0
active_loop.utility=yy -> : input should be 'y_y',
active_loop.memory_mb=0 -> : input should be
subsampling.every=0 -> : input should be greater than 0, got 0
bank.trajectories=0 -> : input should be greater than 0
bank.pressure.range_kpa.pam1.low=900 -> bank.pressure.range_kpa.pam1: expected low <= high, got 900.0 and 200
~bank.pressure.range_kpa.pam1 -> bank.pressure.range_kpa: expected a range for every muscle, none for pam1
+bank.pressure.range_kpa.pam5={low: 1.0,high: 2.0} -> no muscle 'pam5'; did you mean 'pam4'?
hyperprior.rows.log_noise_sd.variance=0 -> : input should be greater
~hyperprior.rows.log_noise_sd -> hyperprior.rows lacks log_noise_sd
+hyperprior.muscles.pam9={} -> hyperprior.muscles: no muscle 'pam9'; did you mean 'pam4'?
~hyperprior.data_sheet.MAS-10 -> hyperprior.data_sheet has no type 'MAS-10' of pam2
+plant.typo=1 -> unknown key 'plant.typo'
+participants.p1.dela_s=1 -> unknown key 'participants.p1.dela_s': did you mean 'delay_s'?
+rig.lead_inn_s=1 -> unknown key 'rig.lead_inn_s': did you mean 'lead_in_s'?
rig._target_=stages.science.rig.sim.SimulatedRg ->
    stages.science.rig.sim has no class SimulatedRg; did you mean 'SimulatedRig'?
rig._target_=stages.science.rig.simm.SimulatedRig -> cannot import stages.science.rig.simm
+mucles=4 -> unknown key 'mucles'
seed=-1 -> : input should be greater than or equal to 0, got -1; set seed=0
active_loop.utility=yy -> got 'yy'; did you mean 'y_y'?
active_loop.reuse_trajectories=7 -> got 7; set active_loop.reuse_trajectories=true
active_loop.memory_mb=1e9 -> : input should be less than or equal to 1048576, got 1000
workflow.package= -> : expected the dotted name of a Python package, got ''
rig._target_=.sim.Rig -> _target_: expected the dotted name of a class, as package.module.Class, got
rig._target_=stages.science.rig.contract.Rig -> expected a class that can be built, got an abstract one
rig._target_=pathlib.PurePath -> rig
active_loop.trials=39 -> : expected at most 38 (40 movements of the bank less 2 initial
bank.trajectories=2 -> : expected more than the 2 initial trials
bank.trajectories=1000000000 -> : expected at most 12500 movements of 1000 samples and 4
subsampling.initial_trials=41 -> : expected at most the bank's 40 movements, got 41
subsampling.every=1000 -> : expected less than the 1000 samples of a trial
subsampling.experiments=1000000000 -> : expected at most 3125 for each participant
subsampling.experiments=1000 -> : expected at most 208 for each participant
active_loop.points_per_trial=100000 -> : input should be less than or equal to 2000
active_loop.points_per_trial=200 ->
    : expected at most 2000 points in the end (initial_points + trials x points_per_trial), beyond which an
    exact GP takes days, got 10 + 10 x 200 = 2010; lower one of them
active_loop.initial_points=100000 -> : input should be less than or equal to 2000
active_loop.trials=100000 -> : input should be less than or equal to 2000
active_loop.starts=1000000 -> : input should be less than or equal to 1000
active_loop.controls=[random,variance,random] ->
    : expected each control once, got random 2 times; set active_loop.controls=[random,variance]
active_loop.controls=[integrated_variance] -> : expected other than the design's integrated_variance, got it alone
exoskeleton.trial_s=0.01 ->
    exoskeleton.velocity_filter.window_s: expected a window that a trial of 2 samples (trial_s 0.01 at
    sampling_rate_hz 250.0) can hold, got 0.05; lower it or raise trial_s
exoskeleton.trial_s=1e300 -> : input should be less than or equal to 3600
exoskeleton.trial_s=3600.0 -> bank.trajectories: expected at most 13 movements of 900000 samples
exoskeleton.sampling_rate_hz=1e9 -> : input should be less than or equal to 10000
exoskeleton.velocity_filter.window_s=5.0 -> : expected a window that a
exoskeleton.velocity_filter.window_s=0.001 -> expected less than the 1 samples of the window (window_s 0.001
exoskeleton.velocity_filter.order=13 -> : expected less than the 13 samples
participants.p1.tremor_low_hz=13.0 -> : expected at most tremor_high_hz, 12.0
rig.experimenter.tremor_low_hz=13.0 -> : expected at most tremor_high_hz, 12.0
participants.p1.tremor_high_hz=125.0 -> : expected less than half of exoskeleton.sampling_rate_hz, 125.0, got 125.0
participants.p2.noise_hz=200.0 -> : expected less than half of exoskeleton.sampling
participants.p2.noise_hz=0.01 -> : expected a band that holds a multiple of 0.1 Hz
participants.p1.delay_s=100 -> : expected less than exoskeleton.trial_s, 4.0, got 100
rig.experimenter.delay_s=100 -> : expected less than exoskeleton.trial_s, 4.0, got 100
rig.lead_in_s=1e9 -> : input should be less than or equal to 60
hyperprior.rows.log_noise_sd.mean=1000 -> : input should be less than or equal
hyperprior.rows.log_noise_sd.mean=-50 -> : input should be greater than or
hyperprior.rows.log_noise_sd.variance=1e9 -> : input should be less than
hyperprior.data_sheet.MAS-10.max_contraction=0.01 -> : expected more than 0.028, the least contraction of pam2
bank.pressure.range_kpa.pam1.high=300.0 ->
    : expected at most the 250.0 kPa of rig.limits.MAS-40.high_kpa, got 300.0; lower it
rig.limits.MAS-10.low_kpa=60.0 -> bank.pressure.range_kpa.pam2.low: expected at least the 60.0 kPa of rig.limits.MAS-10
bank.pressure.range_kpa.pam1={low: 0.0,high: 0.0} -> bank.pressure.range_kpa.pam1.high: expected more than 0
bank.pressure.hold_s.high=1e300 -> : input should be less than or equal to 3600
plant.integration_step_s=1 ->
    : expected at most 0.0175, beyond which the motion of joint EFE against its end stop diverges, got 1.0;
    lower it
plant.integration_step_s=1e-9 -> : input should be greater than or equal to 0.00001
rig=manual & rig.folder= -> rig.folder: expected the path of the folder that receives recordings, got ''
rig=manual & rig.folder=x & bank.pressure.range_kpa.pam1.high=700.0 ->
    bank.pressure.range_kpa.pam1.high: expected at most the 600.0 kPa of max_pressure_kpa of pam1, got 700.0
bank.pressure.hold_s={low: 0.0,high: 0.0} & bank.pressure.transition_s={low: 0.0,high: 0.0} ->
    bank.pressure.hold_s: expected levels that, with transition_s, last a sample (0.004 s) on average, got 0
bank.pressure.hold_s={low: 0.0,high: 0.0} & bank.pressure.step_share=1.0 ->
    bank.pressure.hold_s: expected levels that, with transition_s, last a sample (0.004 s) on average, got 0
exoskeleton.trial_s=0.3 & active_loop.points_per_trial=76 ->
    active_loop.points_per_trial: expected at most the 75 samples of a trial, got 76
exoskeleton.trial_s=0.3 & active_loop.initial_points=151 ->
    active_loop.initial_points: expected at most the 150 samples of the 2 initial trials, got 151
active_loop.utility=log_det & active_loop.joint_every=200 ->
    active_loop.joint_every: expected less than the 200 samples that a trajectory keeps
active_loop.reuse_trajectories=true & active_loop.trials=1000 ->
    active_loop.points_per_trial: expected at most 2000 points in the end
"""
"""Overrides, and words in which they are refused; words that begin with a colon follow the key."""


@pytest.mark.parametrize("case", re.sub(r"\n +", " ", REFUSED).splitlines())
def test_refuses(case):
    typed, told = case.split(" -> ")
    overrides = typed.split(" & ")
    with pytest.raises(ConfigError) as refusal:
        validated(*overrides)
    key = overrides[-1].partition("=")[0] if told.startswith(":") else ""
    assert f"{key}{told}" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_as_many_trials_as_one_likes_where_trajectories_may_be_reused():
    validated("active_loop.reuse_trajectories=true", "active_loop.trials=39", "bank.trajectories=2")


@pytest.mark.parametrize("options", ["full nominal p1", "tiny rich p2", "full rich both", "tiny nominal both"])
def test_accepts_every_option(options):
    budget, plant, participant = options.split()
    study, stages = validated(f"budget={budget}", f"plant={plant}", f"participant={participant}")
    assert list(study.values["participants"]) == (["p1", "p2"] if participant == "both" else [participant])
    assert stages[0].name == "bank"


def test_every_file_of_the_configuration_begins_with_a_comment_and_every_key_of_the_project_has_one():
    silent = []
    for path in (ROOT / "conf").rglob("*.yaml"):
        lines = path.read_text().splitlines()
        comments = [line for line in lines[:2] if line.startswith("# ") and not line.startswith("# @package")]
        assert comments, f"{path} begins without a comment that says what it is"
        if "hydra" in path.parts or path.parent.name == "budget":
            continue
        for number, line in enumerate(lines, start=1):
            key, _, value = line.partition(":")
            is_value = value.strip() and not line.lstrip().startswith(("#", "- ", "_target_"))
            is_value = is_value and not value.strip().startswith(("${", "{low", "{name"))
            if is_value and "#" not in value and '"assumed' not in value and "source:" not in line:
                silent.append(f"{path.relative_to(ROOT)}:{number} {key.strip()}")
    assert not silent


def test_overrides_named_in_the_readme_parse_and_validate():
    found = []
    for line in (ROOT / "README.md").read_text().splitlines():
        for part in line.split("`"):
            if part.startswith("python -m pipeline ") and not any(each in part for each in NEED_A_PATH):
                found.append([each for each in shlex.split(part)[3:] if each != "-m"])
    assert found
    for overrides in found:
        jobs = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides(overrides), None)[0]
        assert len(jobs) == (16 if "sweep=night" in overrides else 1)
        for each in jobs[:1]:
            validated(*each)
