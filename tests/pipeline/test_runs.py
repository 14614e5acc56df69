"""Plan, freshness, resume and reuse."""

import json

from tests.faults import find_parts, ledger_of, tables_of
from tests.pipeline.conftest import SLOWLY


def test_plan_says_why_and_writes_nothing(toy):
    result = toy("plan=true")
    assert result.returncode == 0
    order = [line.split()[0] for line in result.stdout.splitlines() if "not made before" in line]
    assert order == ["counting", "doubling", "adding"]
    assert not toy.outputs.exists()


def test_run_leaves_tables_figures_ledger_and_report(toy, reference):
    result = toy("figures=[png]")
    assert result.returncode == 0, result.stderr
    (run,) = toy.runs
    assert set(tables_of(run)) == {"numbers.parquet", "doubles.parquet", "halves.parquet", "total.parquet"}
    assert (run / "figures" / "doubles.png").stat().st_size > 1000
    assert json.loads((run / "documents" / "note.json").read_text())["largest"] > 0
    ledger = ledger_of(run)
    assert ledger["status"] == "done"
    assert (
        ledger["stages"]["doubling"]["inputs"]["numbers"] == ledger["stages"]["counting"]["tables"]["numbers"]["sha256"]
    )
    page = (run / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert "Each number&#39;s double." in page
    assert "://" not in page
    assert "The sum of all" in result.stdout
    assert str(run / "report.html") in result.stdout
    assert not (run / "parts").exists()
    assert tables_of(run) == reference
    again = toy()
    assert again.returncode == 0
    assert "everything is fresh: nothing to run" in again.stdout
    assert len(toy.runs) == 1


def test_changed_key_reruns_just_the_stages_that_read_it(done):
    plan = done("plan=true", "doubling.digits=2").stdout
    assert "config changed (doubling.digits 16 -> 2)" in plan
    assert "counting  fresh" in plan
    assert "adding    wait   fresh if doubles and halves come out unchanged" in plan
    done("doubling.digits=2")
    stages = ledger_of(done.runs[1])["stages"]
    assert stages["counting"]["origin"] == done.runs[0].name
    assert stages["doubling"]["origin"] == stages["adding"]["origin"] == done.runs[1].name
    assert (done.runs[1] / "tables/numbers.parquet").stat().st_ino == (
        done.runs[0] / "tables/numbers.parquet"
    ).stat().st_ino


def test_equal_content_cuts_off_downstream(done):
    result = done("counting.label=other")
    assert result.returncode == 0
    stages = ledger_of(done.runs[1])["stages"]
    assert stages["counting"]["origin"] == done.runs[1].name
    assert stages["doubling"]["origin"] == stages["adding"]["origin"] == done.runs[0].name


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
    result = done("stages=[adding]")
    assert result.returncode == 0, result.stderr
    assert "adding    ran" in result.stdout
    assert "asked for by name" in result.stdout
    stages = ledger_of(done.runs[1])["stages"]
    assert stages["adding"]["origin"] == done.runs[1].name
    assert stages["doubling"]["origin"] == done.runs[0].name


def test_single_stage_refuses_stale_inputs_and_says_what_to_type(toy):
    result = toy("stages=[adding]")
    assert result.returncode == 2
    assert "not fresh (counting: not made before; doubling: not made before)" in result.stderr
    assert "type stages=[counting,doubling,adding]" in result.stderr
    assert not toy.outputs.exists()


def test_killed_run_continues_at_the_next_part_with_identical_tables(killed, reference):
    (run,) = killed.runs
    assert len(find_parts(killed)) >= 2
    assert f"{run.name}   killed" in killed.review("list").stdout
    result = killed(SLOWLY)
    assert result.returncode == 0, result.stderr
    assert f"resuming {run}" in result.stdout
    assert killed.runs == [run]
    assert (run / "log.txt").read_text().count("counting: done") == 1
    assert tables_of(run) == reference


def test_review_lists_shows_and_helps(done):
    name = done.runs[0].name
    assert name in done.review("list").stdout
    assert "doubles (6)" in done.review("show", "latest").stdout
    shown = done.review("show", name[:10], "numbers", "--rows", "2").stdout
    assert "draw" in shown
    assert "first 2 of 6 rows" in shown
    wrong = done.review("show", name, "nmbers")
    assert wrong.returncode == 2
    assert "did you mean 'numbers'?" in wrong.stderr
    missing = done.review("show", "2001")
    assert missing.returncode == 2
    assert "no run '2001'" in missing.stderr


def test_reasons_are_told_against_the_most_similar_run(toy):
    toy("doubling.digits=3")
    toy("counting.count=4", "doubling.digits=5")
    plan = toy("doubling.digits=4", "plan=true").stdout
    assert "config changed (doubling.digits 3 -> 4)" in plan
    assert "input" not in plan
