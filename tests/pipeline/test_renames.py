"""What version 0.1 measured is found under today's names."""

import json
from pathlib import Path

import pytest

from pipeline.config import read_study
from pipeline.plan import gather
from pipeline.renames import update_facts
from tests.composing import compose_values

MEASURED = json.loads(Path(__file__).with_name("measured_by_0_1.json").read_text())
"""What it noted of each stage that drove ``rig=festo_cpx``; inputs left out."""


@pytest.mark.parametrize("name", MEASURED)
def test_a_measurement_of_the_first_version_has_the_fingerprint_of_today(name):
    study, stages = read_study(compose_values("rig=festo_cpx"))
    (stage,) = (each for each in stages if each.name == name)
    today = gather(study, stage, {})
    found = update_facts({"format": 1, "stages": {name: MEASURED[name]}}, 2)["stages"][name]
    assert found["config"] == json.loads(json.dumps(today.config))
    assert found["fingerprint"] == today.fingerprint != MEASURED[name]["fingerprint"]
    assert found["parts"] == MEASURED[name]["fingerprint"]
