"""``rerun=RUN``: tables made again agreeing or not, here or from another machine."""

import json
import shutil

import pytest

from tests.conftest import Command
from tests.faults import check_wholeness, find_parts, ledger_of, overwrite, tables_of, wait_until
from tests.pipeline.conftest import ALONE, CONFIG, SLOWLY, end, success, the_only_line


@pytest.fixture
def rerun(tmp_path):
    """The command with nothing but its outputs, to repeat what was made in the same."""
    return Command(tmp_path / "outputs", "workers=1")


@pytest.fixture
def lab(tmp_path):
    """The command with the workflow that asks a device."""
    return Command(tmp_path / "outputs", *CONFIG, "workflow=lab")


def repeat(rerun, run="latest", *beside):
    """Repeat a run; return what is printed where all tables agree."""
    return success(rerun, f"rerun={run}", *beside)


def test_a_run_is_made_again_whole_and_agrees(toy, rerun):
    toy("doubling.digits=3", "counting.count=4", "figures=[png]")
    (first,) = toy.runs
    assert repeat(rerun).splitlines()[-1] == f"4 of 4 tables have the same bytes as in {first.name}"
    _, second = toy.runs
    assert tables_of(second) == tables_of(first)
    facts = ledger_of(second)
    assert {each["origin"] for each in facts["stages"].values()} == {second.name}
    command = ledger_of(first)["command"]
    assert facts["rerun_of"] == {"run": first.name, "folder": str(first), "command": command}
    assert facts["comparison"]["tables"] == dict.fromkeys(("numbers", "doubles", "halves", "total"))
    inodes = [{path.stat().st_ino for path in run.glob("tables/*")} for run in toy.runs]
    assert not inodes[0] & inodes[1]
    assert [path.suffix for path in (second / "figures").iterdir()] == [".png"]
    check_wholeness(second)
    assert "everything is fresh" in toy("doubling.digits=3", "counting.count=4").stdout


def test_a_drift_is_told_by_table_and_column(lab, rerun):
    lab()
    name = lab.runs[0].name
    rerun.environment["TOY_DRIFT"] = "1e-9"
    result = rerun("rerun=latest")
    assert result.returncode == 1
    assert result.stdout.splitlines()[-3:] == [
        f"1 of 2 tables have the same bytes as in {name}",
        "  verdicts  value differs in 1 of 3 rows, by at most 1e-09",
        "nothing that the ledgers hold tells why",
    ]
    rerun.environment["TOY_ROWS"] = "4"
    more = rerun(f"rerun={name}")
    assert more.returncode == 1
    assert "verdicts  3 rows then, 6 now" in more.stdout
    assert ledger_of(lab.runs[2])["comparison"]["tables"]["verdicts"] == "3 rows then, 6 now"


def test_what_changed_since_is_told(toy, rerun, own_package):
    toy.environment["PYTHONPATH"] = rerun.environment["PYTHONPATH"] = str(own_package.parent)
    toy("workflow.package=copied_toy")
    (first,) = toy.runs
    facts = ledger_of(first)
    facts["machine"]["model"] = "An older processor"
    facts["git"] = {"commit": "0123456789abcdef", "clean": True}
    facts["stages"]["adding"]["libraries"]["python"] = "3.9.1"
    (first / "run.json").write_text(json.dumps(facts))
    code = own_package / "adding.py"
    code.write_text(code.read_text().replace(".sum()]", ".sum() + 1]"))
    result = rerun("rerun=latest")
    assert result.returncode == 1
    for told in (
        "total  total differs in 1 of 1 rows, by at most 1",
        "code: copied_toy/adding.py",
        "libraries: python 3.9.1 -> ",
        "commit: 0123456789 -> ",
        "machine: model An older processor -> ",
    ):
        assert told in result.stdout[result.stdout.index("3 of 4 tables") :]
    shutil.rmtree(own_package)
    gone = the_only_line(rerun(f"rerun={first.name}"))
    assert "expected the dotted name of a Python package, got 'copied_toy'" in gone
    assert "it ran with commit 0123456789" in gone


def test_columns_and_types_are_told(lab, rerun, own_package):
    lab.environment["PYTHONPATH"] = rerun.environment["PYTHONPATH"] = str(own_package.parent)
    lab("workflow.package=copied_toy")
    path = own_package / "judging.py"
    text = path.read_text().replace('"value"', '"worth"').replace('column(int, "from', 'column(float, "from')
    path.write_text(text.replace("range(len(values)),", "[1.0 * each for each in range(len(values))],"))
    result = rerun("rerun=latest")
    assert result.returncode == 1, result.stderr
    assert "verdicts  without column value; with new column worth; number: int64 -> float64" in result.stdout


def test_what_real_hardware_measured_is_taken_over(lab, rerun, tmp_path):
    reading = tmp_path / "reading.txt"
    reading.write_text("3.5")
    real = ("device=real", f"device.file={reading}")
    assert lab(*real).returncode == 0
    (first,) = lab.runs
    assert ledger_of(first)["stages"]["measuring"]["measured"] is True
    reading.write_text("99")
    printed = repeat(rerun)
    assert f"1 of 1 tables have the same bytes as in {first.name}" in printed
    assert "taken over from it, as real hardware measured them: readings" in printed
    facts = ledger_of(lab.runs[1])
    assert facts["comparison"]["measured"] == ["readings"]
    assert tables_of(lab.runs[1]) == tables_of(first)
    older = ledger_of(first)
    for record in older["stages"].values():
        del record["measured"]
    (first / "run.json").write_text(json.dumps(older))
    assert "measured them: readings" in repeat(rerun, first.name)
    assert "everything is fresh" in lab(*real).stdout
    overwrite(first / "tables/readings.parquet", b"")
    line = the_only_line(rerun(f"rerun={first.name}"))
    assert f"tables/readings.parquet of run {first.name} is damaged" in line
    assert "cannot be made again; restore it" in line
    assert len(lab.runs) == 3


def test_a_job_of_a_sweep_and_a_run_from_elsewhere(toy, rerun, tmp_path):
    assert toy(*ALONE, "sweep=s", "seed=0,1", "doubling.digits=3").returncode == 0
    (folder,) = (each for each in (toy.outputs / "sweeps" / "s").glob("*seed=1*"))
    for name in (f"s/{folder.name}", f"s/{folder.name[:25]}"):
        printed = repeat(rerun, name, "figures=[]")
        assert f"4 of 4 tables have the same bytes as in s/{folder.name}" in printed
    shutil.copytree(folder, tmp_path / "from elsewhere")
    shutil.rmtree(toy.outputs)
    shutil.rmtree(tmp_path / "from elsewhere" / "tables")
    assert "4 of 4 tables have the same bytes as in from elsewhere" in repeat(rerun, tmp_path / "from elsewhere")
    (run,) = toy.runs
    assert ledger_of(run)["rerun_of"]["folder"] == str(tmp_path / "from elsewhere")


def test_only_the_stages_of_the_run_are_made_again(done, rerun):
    done("stages=[doubling]")
    assert "3 of 3 tables have the same bytes" in repeat(rerun)
    assert set(ledger_of(done.runs[-1])["stages"]) == {"counting", "doubling"}
    assert {each["origin"] for each in ledger_of(done.runs[-1])["stages"].values()} == {done.runs[-1].name}


def test_changed_and_missing_input_files_are_told(rerun, tmp_path):
    option, data = tmp_path / "few.yaml", tmp_path / "data"
    data.mkdir()
    for name in "abc":
        (data / name).write_text(name)
    option.write_text(f"what: {data}\nothers: []\n")
    scales = Command(rerun.outputs, *CONFIG, "workflow=scales", f"weighing={option}")
    assert scales().returncode == 0
    (first,) = scales.runs
    assert "note: " not in repeat(rerun)
    (data / "a").write_text("aa")
    (data / "b").unlink()
    (data / "d").touch()
    option.write_text("what: nothing\n")
    result = rerun(f"rerun={first.name}")
    assert result.returncode == 1
    for line in (
        f"note: input weighing.what/a changed since {first.name}",
        f"note: input weighing.what/b is no longer there since {first.name}",
        f"note: input weighing.what/d is new since {first.name}",
        f"note: weighing={option} has other bytes now; what {first.name} had of it is taken from its config.yaml",
        "  input files: weighing.what/a, weighing.what/b, weighing.what/d",
    ):
        assert line in result.stdout
    assert ledger_of(scales.runs[-1])["given"] == ledger_of(first)["given"]
    shutil.rmtree(data)
    line = the_only_line(rerun(f"rerun={first.name}"))
    assert f"rerun={first.name}: weighing.what: expected the path of a file or folder, got '{data}'" in line


def test_a_killed_repetition_goes_on_by_itself_and_is_taken_for_nothing_else(toy, rerun):
    toy(SLOWLY)
    (first,) = toy.runs
    process = rerun.start("rerun=latest")
    wait_until(process, lambda: len(find_parts(toy)) >= 2)
    process.terminate()
    assert f"rerun={first.name} workers=1 outputs=" in the_only_line(end(process), 143)
    assert "everything is fresh" in toy(SLOWLY).stdout
    shutil.copytree(first, first.with_name("2001-01-01_00-00-00"))
    assert "expected a run that is done, got one that is interrupted" in the_only_line(rerun("rerun=latest"))
    printed = repeat(rerun, first.name)
    assert f"resuming {toy.runs[-1]}" in printed
    assert "4 of 4 tables have the same bytes" in printed


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("rerun=",), "rerun=: expected one run"),
        (("rerun=latest", "rerun=latest"), "rerun=: expected one run"),
        (("rerun=latest", "seed=1"), "seed=1: expected nothing beside rerun=RUN but outputs=, workers=, figures="),
        (("rerun=latest", "-m"), "-m: expected nothing beside"),
        (("rerun=latest", "plan=true"), "plan=true: expected nothing beside"),
        (("rerun=latest", "workers=0"), "workers: input should be greater than or equal to 1"),
        (("rerun=latest", "workers=1,2"), "workers=1,2: expected one value"),
        (("rerun=latest", "figures=[gif]"), "figures.0: "),
        (("rerun=latest", "workers=[1"), "an override has a character that needs quotes"),
        (("rerun=latst",), "did you mean 'latest'?"),
        (("rerun=s/nothing",), "no run 's/nothing'"),
        (("rerun=tests/pipeline",), "expected the folder of a run, got one without run.json"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(done, rerun, arguments, told):
    assert told in the_only_line(rerun(*arguments))
    assert len(done.runs) == 1


def test_a_run_that_is_not_whole_is_refused(toy, rerun):
    toy("doubling.fail_at=3")
    assert "expected a run that is done, got one that is failed" in the_only_line(rerun("rerun=latest"))
    toy()
    run = toy.runs[-1]
    kept = (run / "config.yaml").read_text()
    for text, told in (
        ("words\n", "to hold a whole configuration, got none"),
        ("a: [1\n", "cannot be read"),
        ("a: ${b}\n", "cannot be read (Interpolation key 'b' not found)"),
        ("", "to hold a whole configuration, got none"),
        (kept + "surplus: 1\n", "unknown key 'surplus'"),
    ):
        (run / "config.yaml").write_text(text)
        assert told in the_only_line(rerun("rerun=latest")), text
    (run / "config.yaml").unlink()
    assert f"there is no {run / 'config.yaml'}" in the_only_line(rerun("rerun=latest"))
    (run / "run.json").write_text("{}")
    assert "cannot be read, or is of another version" in the_only_line(rerun(f"rerun={run}"))
    assert len(toy.runs) == 2


def test_an_edited_configuration_is_seen(done, rerun):
    config = done.runs[0] / "config.yaml"
    config.write_text(config.read_text().replace("count: 6", "count: 7"))
    result = rerun("rerun=latest")
    assert result.returncode == 1
    assert "configuration: config.yaml is no longer what the stages had then" in result.stdout
