"""Plan, freshness, resume and reuse."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from pipeline.ledger import Ledger
from pipeline.plan import Ingredients, decide
from tests.conftest import Command
from tests.faults import ledger_of, overwrite, tables_of
from tests.pipeline.conftest import CONFIG, refusal, success, the_only_line


def origins_of(run):
    return {name: record["origin"] for name, record in ledger_of(run)["stages"].items()}


def test_plan_says_why_and_writes_nothing(toy):
    order = [line.split()[0] for line in success(toy, "plan=true").splitlines() if "not made before" in line]
    assert order == ["counting", "doubling", "adding"]
    assert not toy.outputs.exists()


def test_run_leaves_tables_figures_ledger_and_report(toy, reference):
    result = success(toy, "figures=[png]")
    (run,) = toy.runs
    assert set(tables_of(run)) == {"numbers.parquet", "doubles.parquet", "halves.parquet", "total.parquet"}
    assert (run / "figures" / "doubles.png").stat().st_size > 1000
    assert json.loads((run / "documents" / "note.json").read_text())["largest"] > 0
    ledger = ledger_of(run)
    assert ledger["status"] == "done"
    stages = ledger["stages"]
    assert {each["measured"] for each in stages.values()} == {False}
    assert stages["doubling"]["inputs"]["numbers"] == stages["counting"]["tables"]["numbers"]["sha256"]
    page = (run / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert "Each number&#39;s double." in page
    assert not ledger["git"] or ledger["git"]["commit"][:10] in page
    assert "://" not in page
    assert "The sum of all" in result
    assert str(run / "report.html") in result
    assert not (run / "parts").exists()
    assert tables_of(run) == reference
    assert "everything is fresh: nothing to run" in success(toy)
    assert len(toy.runs) == 1


def test_a_result_of_another_study_is_not_told_as_a_change():
    old, new = ({f"key_{each}": value for each in range(6)} for value in (1, 2))
    record = {"fingerprint": "-", "config": {"plant": old}, "inputs": {}, "code": {}, "libraries": {}}
    stage = SimpleNamespace(name="fitting", writes=(), extent=())
    ledgers = [SimpleNamespace(finished=lambda name: record)]
    step = decide(stage, Ingredients({"plant": new}, {}, {}, {}, measured=False), ledgers)
    assert step.reason == "not made before: the most similar result differs in plant.key_0 1 -> 2 and 5 more"
    step = decide(stage, Ingredients({"plant": {**old, "key_0": 2}}, {}, {}, {}, measured=False), ledgers)
    assert step.reason == "config changed (plant.key_0 1 -> 2)"


def test_changed_key_reruns_just_the_stages_that_read_it(done):
    plan = done("plan=true", "doubling.digits=2").stdout
    assert "config changed (doubling.digits 16 -> 2)" in plan
    assert "counting  fresh" in plan
    assert "adding    wait   fresh if doubles and halves come out unchanged" in plan
    done("doubling.digits=2")
    first, second = done.runs
    assert origins_of(second) == {"counting": first.name, "doubling": second.name, "adding": second.name}
    assert len({(run / "tables/numbers.parquet").stat().st_ino for run in done.runs}) == 1


def test_equal_content_cuts_off_downstream(done):
    assert done("counting.label=other").returncode == 0
    first, second = done.runs
    assert origins_of(second) == {"counting": second.name, "doubling": first.name, "adding": first.name}


def test_changed_code_reruns_the_stage_and_says_which_file(toy, own_package):
    toy.environment["PYTHONPATH"] = str(own_package.parent)
    toy.fixed += ("workflow.package=copied_toy",)
    assert toy().returncode == 0
    code = own_package / "adding.py"
    code.write_text(code.read_text().replace(".sum()]", ".sum() + 1]"))
    plan = toy("plan=true").stdout
    assert "adding    run    code changed (copied_toy/adding.py)" in plan
    assert "doubling  fresh" in plan
    assert toy().returncode == 0
    assert len(toy.runs) == 2


def test_single_stage_runs_again_on_the_tables_of_another_run(done):
    result = success(done, "stages=[adding]")
    assert "adding    ran" in result
    assert "asked for by name" in result
    first, second = done.runs
    assert origins_of(second) == {"counting": first.name, "doubling": first.name, "adding": second.name}


def test_single_stage_refuses_stale_inputs_and_says_what_to_type(toy):
    line = refusal(toy, "stages=[adding]")
    assert "not fresh (counting: not made before; doubling: not made before)" in line
    assert "type stages=[counting,doubling,adding]" in line


def test_review_lists_shows_and_helps(done):
    name = done.runs[0].name
    assert name in done.review("list").stdout
    assert "doubles (6)" in done.review("show", "latest").stdout
    shown = done.review("show", name[:10], "numbers", "--rows", "2").stdout
    assert "draw" in shown
    assert "first 2 of 6 rows" in shown
    assert "did you mean 'numbers'?" in the_only_line(done.review("show", name, "nmbers"))
    assert "no run '2001'" in the_only_line(done.review("show", "2001"))


def test_reasons_are_told_against_the_most_similar_run(toy):
    toy("doubling.digits=3")
    toy("counting.count=4", "doubling.digits=5")
    plan = toy("doubling.digits=4", "plan=true").stdout
    assert "config changed (doubling.digits 3 -> 4)" in plan
    assert "input" not in plan


STAGE = SimpleNamespace(name="measuring", writes=(), extent=())


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


def test_what_was_measured_is_not_measured_again_when_a_loop_gets_longer_or_shorter(tmp_path):
    lab = Command(tmp_path / "outputs", *CONFIG, "workflow=lab", "figures=[]", "device=real")
    reading = tmp_path / "reading.txt"

    def measure(value, *arguments):
        """Run it while the device says a value; return what was asked of it, and all readings."""
        asked = reading.with_suffix(".log")
        asked.write_text("")
        reading.write_text(value)
        printed = success(lab, f"device.file={reading}", *arguments)
        table = pd.read_parquet(lab.runs[-1] / "tables" / "readings.parquet")
        return len(asked.read_text().split()), table["reading"].to_list(), printed

    def lengthen(count):
        return f"measuring.count={count}"

    assert measure("1", lengthen(2))[:2] == (2, [1.0, 1.0])
    first = lab.runs[0]
    plan = success(lab, f"device.file={reading}", lengthen(4), "plan=true")
    assert f"config changed (measuring.count 2 -> 4); goes on with what {first.name} measured" in plan
    assert measure("2", lengthen(4))[:2] == (2, [1.0, 1.0, 2.0, 2.0])
    assert measure("3", lengthen(1))[:2] == (0, [1.0])
    assert measure("3", lengthen(5))[:2] == (1, [1.0, 1.0, 2.0, 2.0, 3.0])  # goes on with the longest
    assert measure("4", lengthen(2), "measuring.offset=10.0")[:2] == (2, [14.0, 14.0])  # not the same parts
    overwrite(lab.runs[3] / "tables/readings.parquet", b"")
    asked, readings, printed = measure("5", lengthen(5))
    assert (asked, readings) == (0, [1.0, 1.0, 2.0, 2.0, 3.0])
    assert "damaged" in printed
    assert measure("6", lengthen(2), "stages=[measuring]")[:2] == (2, [6.0, 6.0])
    assert measure("7", lengthen(3), "stages=[measuring]")[:2] == (0, [1.0, 1.0, 2.0])
    for run in lab.runs:
        assert {each.name.partition("-")[0] for each in (run / "parts").iterdir()} == {"measuring"}
    simulated = success(lab, "device=simulated", lengthen(3))
    assert "goes on" not in simulated
    assert not (lab.runs[-1] / "parts").exists()
