"""What makes a stage's tables stale, and what does not."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.ledger import Ledger
from pipeline.plan import Ingredients, decide

STAGE = SimpleNamespace(name="measuring", writes=())


@pytest.mark.parametrize("measured", [True, False])
def test_what_was_measured_outlives_a_change_of_code_and_libraries_alone(measured):
    before = Ingredients({"seed": 1}, {"bank": "abc"}, {"stages/bank.py": "123"}, {"numpy": "2.0"}, measured)
    record = {**vars(before), "status": "done", "fingerprint": before.fingerprint, "origin": "then"}
    ledger = Ledger(Path("runs/then"), {"stages": {STAGE.name: {**record, "tables": {}, "files": {}}}})
    assert decide(STAGE, before, [ledger]).action == "fresh"
    changes = {"code": {"stages/bank.py": "456"}, "libraries": {"numpy": "2.1"}}
    steps = {name: decide(STAGE, replace(before, **{name: value}), [ledger]) for name, value in changes.items()}
    assert {name: step.action for name, step in steps.items()} == dict.fromkeys(steps, "kept" if measured else "run")
    told = "measured in then; since then " if measured else ""
    assert steps["code"].reason == f"{told}code changed (stages/bank.py)"
    assert steps["libraries"].reason == f"{told}library changed (numpy 2.0 -> 2.1)"
    for change in ({"config": {"seed": 2}}, {"inputs": {"bank": "def"}}):
        assert decide(STAGE, replace(before, **change), [ledger]).action == "run"
