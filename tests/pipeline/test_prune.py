"""``prune``: old runs go and free what they say; whatever is at work, measured or needed stays whole."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, Command
from tests.faults import check_wholeness, find_parts, ledger_of, obey_permissions, tables_of, wait_until

CONFIG = ("--config-dir", "tests/pipeline/conf")
SLOWLY = "doubling.pause_s=0.4"


def snapshot(folder):
    """Return every file in a folder, with what it is."""
    return {
        path: (path.lstat().st_ino, path.lstat().st_nlink, path.lstat().st_size) for path in sorted(folder.rglob("*"))
    }


def use_of(folder):
    """Return the bytes that a folder takes, each file once."""
    found = {path.lstat().st_ino: path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()}
    return sum(found.values())


def told_of(result, run):
    (line,) = (each for each in result.stdout.splitlines() if f"{run}  " in each)
    return line


def two(text):
    """Return the number of bytes that a line of totals tells, to the digits that it has."""
    number, unit = text.split()
    return float(number) * {"bytes": 1, "kB": 1e3, "MB": 1e6}[unit]


def test_all_but_the_newest_go_and_the_rest_is_whole(toy):
    for number in range(4):
        assert toy(f"seed={number}").returncode == 0
    toy("doubling.fail_at=1", "seed=9")
    runs = toy.runs
    tables = [tables_of(run) for run in runs]
    before = use_of(toy.outputs / "runs")
    dry = toy.review("prune", "--keep", "2", "--dry-run")
    assert dry.returncode == 0, dry.stderr
    assert dry.stdout.splitlines()[-1] == "nothing was changed (--dry-run)"
    assert "3 folders would be removed, " in dry.stdout
    assert toy.runs == runs
    result = toy.review("prune", "--keep", "2")
    assert result.returncode == 0, result.stderr
    assert toy.runs == runs[3:]
    assert "is among the newest 2" in told_of(result, runs[3])
    freed = result.stdout.splitlines()[-1].removeprefix("3 folders removed, ").removesuffix(" freed")
    assert two(freed) == pytest.approx(before - use_of(toy.outputs / "runs"), rel=0.01)
    assert f"{freed} would be freed" in dry.stdout
    assert [tables_of(run) for run in toy.runs] == tables[3:]
    for run in toy.runs:
        check_wholeness(run)
    assert runs[4].name in toy.review("list").stdout
    assert "everything is fresh" in toy("seed=3", "plan=true").stdout
    assert "not made before" not in toy("seed=0", "plan=true").stdout
    assert toy.review("prune", "--keep", "0").returncode == 0
    assert toy.runs == []
    assert "0 folders removed, 0 bytes freed" in toy.review("prune", "--keep", "0").stdout


def test_what_a_kept_run_shares_is_not_counted_as_freed(toy):
    many = "counting.count=20000"
    stop = "doubling.fail_at=0"
    toy(many, stop)
    toy(many, stop, "doubling.digits=3")
    toy(many, stop, "doubling.digits=4")
    first, second, last = toy.runs
    shared = (last / "tables" / "numbers.parquet").stat()
    assert shared.st_nlink == 3
    before = use_of(toy.outputs / "runs")
    result = toy.review("prune", "--keep", "1")
    line = result.stdout.splitlines()[-1]
    assert "more stay, as folders that are kept have them too" in line
    freed = line.removeprefix("2 folders removed, ").split(" freed")[0]
    assert two(freed) == pytest.approx(before - use_of(toy.outputs / "runs"), rel=0.01)
    assert two(freed) < shared.st_size < two(line.split("; ")[1].split(" more")[0]) * 1.01
    for run in (first, second):
        assert float(told_of(result, run).split()[-2]) * 1000 > shared.st_size
    check_wholeness(last)


@pytest.mark.slow
def test_a_run_at_work_or_paused_stays(toy):
    toy("seed=1")
    process = toy.start("doubling.pause_s=1.5")
    wait_until(process, lambda: find_parts(toy))
    busy = toy.runs[-1]
    result = toy.review("prune", "--keep", "0")
    assert "is at work" in told_of(result, busy)
    assert toy.runs == [busy]
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    facts = ledger_of(busy) | {"status": "paused"}
    (busy / "run.json").write_text(json.dumps(facts))
    assert "is paused, and waits for a person" in told_of(toy.review("prune", "--keep", "0"), busy)
    check_wholeness(busy)


def test_killed_and_interrupted_runs_go(toy):
    for number in (signal.SIGKILL, signal.SIGTERM):
        process = toy.start(SLOWLY, f"counting.label=a{int(number)}")
        wait_until(process, lambda: find_parts(toy))
        process.send_signal(number)
        process.communicate()
        result = toy.review("prune", "--keep", "0")
        assert result.returncode == 0, result.stderr
        assert toy.runs == []


def test_what_was_measured_stays(tmp_path):
    reading = tmp_path / "reading.txt"
    reading.write_text("3.5")
    lab = Command(tmp_path / "outputs", *CONFIG, "workflow=lab")
    lab("device=real", f"device.file={reading}")
    lab()
    real, simulated = lab.runs
    for _ in range(2):  # the second time with ledgers that do not say it
        assert "holds what measuring measured on real hardware" in told_of(lab.review("prune", "--keep", "0"), real)
        assert real.exists()
        assert not simulated.exists()
        lab("seed=1")
        simulated = lab.runs[-1]
        for run in lab.runs:
            facts = ledger_of(run)
            for record in facts["stages"].values():
                record.pop("measured", None)
            (run / "run.json").write_text(json.dumps(facts))
    text = (real / "run.json").read_text()
    (real / "run.json").write_text(text.replace("device.Real", "no_device.Real"))
    result = lab.review("prune", "--keep", "0")
    assert "may hold what measuring measured: tests.pipeline.toy.no_device.Real cannot be asked" in told_of(
        result, real
    )


def test_what_a_kept_run_needs_stays_and_what_that_needs(toy, tmp_path):
    scales = Command(toy.outputs, *CONFIG, "workflow=scales")
    toy("counting.label=unneeded")
    toy()
    base = toy.runs[-1]
    option = base / "documents" / "amended.yaml"
    option.write_text("count: 3\nlabel: amended\nspoil: null\n")
    toy(f"counting={os.path.relpath(option, ROOT)}")
    middle = toy.runs[-1]
    scales(f"weighing.what={middle}/tables")
    last = scales.runs[-1]
    result = toy.review("prune", "--keep", "1")
    assert result.returncode == 0
    assert toy.runs == [base, middle, last]
    assert f"is needed by {last.name}, which names {middle}/tables" in told_of(result, middle)
    assert f"is needed by {middle.name}, which names " in told_of(result, base)
    assert "everything is fresh" in scales(f"weighing.what={middle}/tables", "plan=true").stdout
    moved = Command(tmp_path / "moved")
    shutil.move(toy.outputs, moved.outputs)
    assert moved.review("prune", "--keep", "1").returncode == 0
    assert [run.name for run in moved.runs] == [base.name, middle.name, last.name]
    shutil.rmtree(moved.runs[-1])
    moved.review("prune", "--keep", "0")
    assert moved.runs == []


def test_a_path_that_counts_from_within_a_run_is_understood(toy):
    toy()
    base = toy.runs[-1]
    (base / "documents" / "amended.yaml").write_text("count: 3\nlabel: amended\nspoil: null\n")
    line = [sys.executable, "-m", "pipeline", "--config-dir", str(ROOT / "tests/pipeline/conf"), "workflow=toy"]
    environment = {**toy.environment, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [*line, f"outputs={toy.outputs}", "counting=amended.yaml"],
        cwd=base / "documents",
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "which names amended.yaml" in told_of(toy.review("prune", "--keep", "1"), base)
    assert len(toy.runs) == 2


@pytest.mark.slow
def test_sweeps_stay_unless_told_and_go_whole(toy):
    for name in ("old", "new"):
        assert toy("-m", f"sweep={name}", "seed=0,1", f"counting.label={name}").returncode == 0
    toy()
    sweeps = toy.outputs / "sweeps"
    result = toy.review("prune", "--keep", "0")
    assert result.returncode == 0
    assert toy.runs == []
    assert len(list(sweeps.glob("*/*/run.json"))) == 4
    result = toy.review("prune", "--keep", "0", "--sweeps", "1")
    assert "is the newest" in told_of(result, sweeps / "new")
    assert [each.name for each in sweeps.iterdir()] == ["new"]
    for job in (sweeps / "new").glob("[!.]*/"):
        check_wholeness(job)
    assert "2 done" in toy("-m", "sweep=new", "seed=0,1", "counting.label=new", "plan=true").stdout
    scales = Command(toy.outputs, *CONFIG, "workflow=scales")
    job = next((sweeps / "new").glob("*seed=0*"))
    assert scales(f'weighing.what="{job}/tables"').returncode == 0
    kept = toy.review("prune", "--keep", "1", "--sweeps", "0")
    assert f"is needed by {toy.runs[0].name}" in told_of(kept, sweeps / "new")


@pytest.mark.slow
def test_a_sweep_at_work_stays(toy):
    process = toy.start("-m", "sweep=s", "seed=0,1", SLOWLY)
    wait_until(process, lambda: list(toy.outputs.glob("sweeps/s/.launches/*/launch.json")))
    for _ in range(3):
        result = toy.review("prune", "--keep", "0", "--sweeps", "0")
        assert result.returncode == 0
        assert list(toy.outputs.glob("sweeps/s/.launches/*/launch.json"))
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors + output
    assert toy.review("prune", "--keep", "0", "--sweeps", "0").returncode == 0
    assert not list((toy.outputs / "sweeps").iterdir())


def test_links_are_not_followed_and_read_only_files_go(toy, tmp_path):
    toy()
    (run,) = toy.runs
    outside = tmp_path / "precious"
    outside.mkdir()
    (outside / "file").write_text("kept")
    (run / "documents" / "link").symlink_to(outside)
    (run / "documents" / "file link").symlink_to(outside / "file")
    (run / "documents").chmod(0o500)
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(run, elsewhere, symlinks=True)
    (run.parent / "2001-01-01_00-00-00").symlink_to(elsewhere)
    result = toy.review("prune", "--keep", "0", before=obey_permissions)
    assert result.returncode == 0, result.stderr
    assert "is a link to elsewhere; remove it by hand" in result.stdout
    assert not run.exists()
    assert (outside / "file").read_text() == "kept"
    assert (elsewhere / "run.json").exists()


def test_what_cannot_be_read_is_left_alone(toy):
    toy()
    (run,) = toy.runs
    (run / "run.json").write_text("{}")
    (run.parent / "mine").mkdir()
    (run.parent / "note.txt").touch()
    before = snapshot(run.parent)
    result = toy.review("prune", "--keep", "0")
    assert result.returncode == 0
    assert "has no run.json that can be read; look at it, and remove it by hand" in told_of(result, run)
    assert snapshot(run.parent) == before


KILLED = """
import os, sys
from pipeline.review import __main__ as review, prune

delete = prune._delete
count = 0

def die(folder):
    global count
    count += 1
    if count == 3:
        os._exit(9)
    delete(folder)

prune._delete = die
review.main(sys.argv[1:])
"""


def test_killed_in_between_leaves_what_the_next_one_clears_up(toy):
    toy("seed=0")
    toy("seed=1")
    first, last = toy.runs
    line = [sys.executable, "-c", KILLED, "--outputs", str(toy.outputs), "prune", "--keep", "1"]
    assert subprocess.run(line, cwd=ROOT, capture_output=True).returncode == 9
    (hidden,) = toy.outputs.glob("runs/.pruned-*")
    assert any(hidden.rglob("*"))
    assert not first.exists()
    assert f"{first.name} " not in toy.review("list").stdout
    assert "not made before" not in toy("seed=1", "plan=true").stdout
    assert toy("seed=2").returncode == 0
    assert hidden.exists()
    assert "left by a prune that was stopped" in toy.review("prune", "--keep", "2", "--dry-run").stdout
    assert hidden.exists()
    assert toy.review("prune", "--keep", "2").returncode == 0
    assert not hidden.exists()
    assert last in toy.runs


def test_a_folder_that_cannot_be_removed_is_told(toy):
    toy("seed=0")
    (run,) = toy.runs
    run.parent.chmod(0o555)
    result = toy.review("prune", "--keep", "0", before=obey_permissions)
    run.parent.chmod(0o755)
    assert result.returncode == 1
    (line,) = result.stderr.splitlines()
    assert f"cannot remove {run} (Permission denied); make {run.parent} writable" in line
    assert "0 folders removed, 0 bytes freed" in result.stdout
    check_wholeness(run)


def test_dry_run_changes_nothing(toy):
    toy("seed=0")
    toy("seed=1")
    before = snapshot(toy.outputs)
    times = {path: path.lstat().st_mtime_ns for path in before}
    assert toy.review("prune", "--keep", "1", "--dry-run").returncode == 0
    assert snapshot(toy.outputs) == before
    assert {path: path.lstat().st_mtime_ns for path in before} == times


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("prune",), "--keep"),
        (("prune", "--keep", "-1"), "expected"),
        (("prune", "--keep", "many"), "expected a number from 0, got many"),
        (("prune", "--keep", "1", "--sweeps", "x"), "expected a number from 0, got x"),
    ],
)
def test_bad_input_is_refused(toy, arguments, told):
    result = toy.review(*arguments)
    assert result.returncode == 2
    assert told in result.stderr.splitlines()[-1]
    assert not toy.outputs.exists()


def test_outputs_that_are_not_there_or_no_folder(toy, tmp_path):
    assert "0 folders removed" in toy.review("prune", "--keep", "1").stdout
    assert not toy.outputs.exists()
    Path(toy.outputs).write_text("a letter")
    result = toy.review("prune", "--keep", "1")
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
