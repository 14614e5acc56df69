"""What version 0.1 measured is found under today's names, which are told to whoever types the old ones."""

import importlib
import json
import re
import shlex
from pathlib import Path

import pytest
import yaml

from pipeline.config import find_target, read_study
from pipeline.plan import gather
from pipeline.renames import update_facts
from pipeline.stage import load_stages
from tests.composing import CONF, GROUPS, compose_values
from tests.conftest import Command
from tests.pipeline.conftest import refusal

MEASURED = json.loads(Path(__file__).with_name("measured_by_0_1.json").read_text())
"""What it noted of each stage that drove ``rig=festo_cpx``; inputs left out."""


@pytest.mark.parametrize("name", MEASURED)
def test_a_measurement_of_the_first_version_has_the_fingerprint_of_today(name):
    chosen = "rig=festo_cpx", "rig.device.host=192.168.1.1", "experiment=paper_design"
    study, stages = read_study(compose_values(*chosen))
    (stage,) = (each for each in stages if each.name == name)
    today = gather(study, stage, {})
    found = update_facts({"format": 1, "stages": {name: MEASURED[name]}}, 2)["stages"][name]
    assert found["config"] == json.loads(json.dumps(today.config))
    assert found["fingerprint"] == today.fingerprint != MEASURED[name]["fingerprint"]
    assert found["parts"] == MEASURED[name]["fingerprint"]


MACHINE = "kind: first_order\ninput: u\noutput: y\noutput_scale: null\npace_s: null\nconstants: {}\neffects: []\n"
METRIC = "{table:disguise,column:x,where:{},but:{},by:mean}"
SIMULATED_RIG, GAP = "stages.science.rig.sim.SimulatedRig", "workflow=discrepancy measured={folder}"
WORKFLOW = "defaults:\n  - identification\n  - /rivals: stated\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("rivals.experiments=3", "unknown key 'rivals.experiments': it is called 'baselines.experiments' today"),
        ("+rivals.experiments=3", "unknown key 'rivals', which no stage of workflow identification reads: {baselines}"),
        ("-m rivals.experiments=3,4", "unknown key 'rivals.experiments': it is called 'baselines.experiments' today"),
        ("rivals=stated", "unknown key 'rivals': {baselines}"),
        ("rig=operator", "unknown rig 'operator': {manual}"),
        ("active_loop=designed", "unknown active_loop 'designed': {paper}"),
        ("stages=[rivals]", "no stage 'rivals' in workflow identification; {baselines}"),
        ("workflow.stages=[sealed_session]", "no stage 'sealed_session' in stages; {blinded_session}"),
        ("workflow.headline=[rival_curve]", "writes 'rival_curve'; {baseline_curve}"),
        ("+workflow.metrics.x=" + METRIC, "writes 'disguise'; {inverse_crime_check}"),
        ("rig._target_=stages.rig.sim.SimulatedRig", "_target_ stages.rig.sim.SimulatedRig: {" + SIMULATED_RIG + "}"),
        (f"{GAP} plant=first_order +plant.pace_s=1", "unknown key 'plant.pace_s': {plant.time_scale_s}"),
        (
            f"{GAP} discrepancy.search.absorbed=0.9",
            "discrepancy.search.absorbed': {discrepancy.report.most_confounded}",
        ),
        (f"{GAP} plant={{folder}}/machine.yaml", "unknown key 'plant.pace_s': {plant.time_scale_s}"),
        ("--config-dir={folder} workflow=mine", "unknown group 'rivals': {baselines}"),
    ],
)
def test_an_old_name_is_refused_with_todays(pamid, tmp_path, arguments, told):
    (tmp_path / "machine.yaml").write_text(MACHINE)
    (tmp_path / "workflow").mkdir()
    (tmp_path / "workflow" / "mine.yaml").write_text(WORKFLOW)
    line = refusal(pamid, *(each.replace("{folder}", str(tmp_path)) for each in shlex.split(arguments)))
    assert re.sub(r"{([\w.]+)}", r"it is called '\1' today", told) in line


def test_a_run_whose_configuration_has_old_names_is_repeated(done):
    path = done.runs[0] / "config.yaml"
    text = path.read_text().replace("operator_ui: null", "desk: null").replace("interface: operator_ui\n", "")
    assert "desk: null" in text
    path.write_text(text)
    assert "4 of 4 tables have the same bytes" in Command(done.outputs)("rerun=latest", "workers=1").stdout


def test_todays_names_are_those_of_today():
    renames = yaml.safe_load((CONF / "renames.yaml").read_text())
    tables = [table for stage in load_stages("stages") for table in stage.writes]
    known = {each.name for each in [*load_stages("stages"), *tables]}.union(*(each.columns for each in tables))
    assert {*renames["names"].values()} <= known
    assert {each.partition(".")[0] for each in renames["keys"].values()} <= GROUPS
    for option, today in renames["options"].items():
        assert (CONF / option.partition("=")[0] / f"{today}.yaml").is_file()
    for target in renames["targets"].values():
        find_target(target) if target.rpartition(".")[2][0].isupper() else importlib.import_module(target)
