"""``prune``: old runs go and free what they say; whatever is at work, measured or needed stays whole."""

import json
import os
import shutil
import signal

import pytest

from tests.conftest import ROOT, Command
from tests.faults import check_wholeness, find_parts, ledger_of, obey_permissions, tables_of, wait_until
from tests.pipeline.conftest import ALONE, CONFIG, SLOWLY, Toy


def prune(command, keep, *more, **how):
    """Return what is told of a pruning that ends well."""
    result = command.review("prune", "--keep", str(keep), *more, **how)
    assert result.returncode == 0, result.stderr
    return result.stdout


def amend(run):
    """Return a document of a run that is an option of the configuration."""
    option = run / "documents" / "amended.yaml"
    option.write_text("count: 3\nlabel: amended\nspoil: null\n")
    return option


def told_of(told, folder):
    (line,) = (each for each in told.splitlines() if f"{folder}  " in each)
    return line


def snapshot(folder):
    """Return every file in a folder, with what it is."""
    found = {path: path.lstat() for path in sorted(folder.rglob("*"))}
    return {path: (each.st_ino, each.st_nlink, each.st_size, each.st_mtime_ns) for path, each in found.items()}


def use_of(folder):
    """Return the bytes that a folder takes, each file once."""
    return sum({path.lstat().st_ino: path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()}.values())


def to_bytes(text):
    """Return the number of bytes that a line of totals tells, to the digits that it has."""
    number, unit = text.split()
    return float(number) * {"bytes": 1, "kB": 1e3, "MB": 1e6}[unit]


@pytest.fixture
def many(make_once, tmp_path):
    """The command with the toy workflow, three finished runs of it and one that failed."""

    def run(folder):
        toy = Toy(folder / "outputs")
        for number in range(3):
            assert toy(f"seed={number}").returncode == 0
        assert toy("doubling.fail_at=1", "seed=9").returncode == 1

    return Toy(make_once("toys to prune", run) / "outputs").copy(tmp_path / "outputs")


def test_all_but_the_newest_go_and_the_rest_is_whole(many):
    runs = many.runs
    tables = [tables_of(run) for run in runs]
    assert len({each["numbers.parquet"] for each in tables}) == 4  # one for each seed
    found, before = snapshot(many.outputs), use_of(many.outputs / "runs")
    dry = prune(many, 2, "--dry-run")
    assert dry.splitlines()[-1] == "nothing was changed (--dry-run)"
    assert "2 folders would be removed, " in dry
    assert snapshot(many.outputs) == found
    told = prune(many, 2)
    assert many.runs == runs[2:]
    assert "is among the newest 2" in told_of(told, runs[2])
    freed = told.splitlines()[-1].removeprefix("2 folders removed, ").removesuffix(" freed")
    assert to_bytes(freed) == pytest.approx(before - use_of(many.outputs / "runs"), rel=0.01)
    assert f"{freed} would be freed" in dry
    assert [tables_of(run) for run in many.runs] == tables[2:]
    for run in many.runs:
        check_wholeness(run)
    assert runs[3].name in many.review("list").stdout
    assert "everything is fresh" in many("seed=2", "plan=true").stdout
    assert "not made before" not in many("seed=0", "plan=true").stdout
    prune(many, 0)
    assert many.runs == []
    assert "0 folders removed, 0 bytes freed" in prune(many, 0)


def test_what_a_kept_run_shares_is_not_counted_as_freed(toy):
    for more in ([], ["doubling.digits=3"], ["doubling.digits=4"]):
        toy("counting.count=20000", "doubling.fail_at=0", *more)
    *old, last = toy.runs
    shared = (last / "tables" / "numbers.parquet").stat()
    assert shared.st_nlink == 3
    before = use_of(toy.outputs / "runs")
    told = prune(toy, 1)
    line = told.splitlines()[-1]
    assert "more stay, as folders that are kept have them too" in line
    freed = to_bytes(line.removeprefix("2 folders removed, ").split(" freed")[0])
    assert freed == pytest.approx(before - use_of(toy.outputs / "runs"), rel=0.01)
    assert freed < shared.st_size < to_bytes(line.split("; ")[1].split(" more")[0]) * 1.01
    for run in old:
        assert float(told_of(told, run).split()[-2]) * 1000 > shared.st_size
    check_wholeness(last)


def test_a_run_at_work_or_paused_stays_and_one_that_was_killed_or_interrupted_goes(killed):
    process = killed.start("doubling.pause_s=0.1")
    wait_until(process, lambda: [part for part in find_parts(killed) if killed.runs[0] not in part.parents])
    busy = killed.runs[1]
    assert "is at work" in told_of(prune(killed, 0), busy)
    assert killed.runs == [busy]
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    check_wholeness(busy)
    process = killed.start(SLOWLY)
    wait_until(process, lambda: find_parts(killed))
    process.send_signal(signal.SIGTERM)
    process.communicate()
    (busy / "run.json").write_text(json.dumps(ledger_of(busy) | {"status": "paused"}))
    assert ledger_of(killed.runs[1])["status"] == "interrupted"
    assert "is paused, and waits for a person" in told_of(prune(killed, 0), busy)
    assert killed.runs == [busy]


def test_what_was_measured_stays(tmp_path):
    reading = tmp_path / "reading.txt"
    reading.write_text("3.5")
    lab = Command(tmp_path / "outputs", *CONFIG, "workflow=lab")
    lab("device=real", f"device.file={reading}")
    lab()
    real = lab.runs[0]
    for _ in range(2):  # the second time with ledgers that do not say it
        assert "holds what measuring measured on real hardware" in told_of(prune(lab, 0), real)
        assert lab.runs == [real]
        lab("seed=1")
        for run in lab.runs:
            facts = ledger_of(run)
            for record in facts["stages"].values():
                record.pop("measured", None)
            (run / "run.json").write_text(json.dumps(facts))
    text = (real / "run.json").read_text()
    (real / "run.json").write_text(text.replace("measuring.Real", "no_device.Real"))
    reason = "may hold what measuring measured: tests.pipeline.toy.no_device.Real cannot be asked"
    assert reason in told_of(prune(lab, 0), real)


def test_what_a_kept_run_needs_stays_and_what_that_needs(done, tmp_path):
    scales = Command(done.outputs, *CONFIG, "workflow=scales")
    (base,) = done.runs
    done("counting.label=unneeded")
    done(f"counting={os.path.relpath(amend(base), ROOT)}")
    middle = done.runs[-1]
    scales(f"weighing.what={middle}/tables")
    last = scales.runs[-1]
    told = prune(done, 1)
    assert done.runs == [base, middle, last]
    assert f"is needed by {last.name}, which names {middle}/tables" in told_of(told, middle)
    assert f"is needed by {middle.name}, which names " in told_of(told, base)
    assert "everything is fresh" in scales(f"weighing.what={middle}/tables", "plan=true").stdout
    moved = Command(tmp_path / "moved")
    shutil.move(done.outputs, moved.outputs)
    prune(moved, 1)
    assert [run.name for run in moved.runs] == [base.name, middle.name, last.name]
    shutil.rmtree(moved.runs[-1])
    prune(moved, 0)
    assert moved.runs == []


def test_a_path_that_counts_from_within_a_run_is_understood(done):
    base = done.runs[-1]
    within = Command(done.outputs, "--config-dir", str(ROOT / "tests/pipeline/conf"), "workflow=toy")
    within.root = amend(base).parent
    assert within("counting=amended.yaml").returncode == 0
    assert "which names amended.yaml" in told_of(prune(done, 1), base)
    assert len(done.runs) == 2


def test_sweeps_stay_unless_told_and_go_whole(toy):
    for name, seeds in (("old", "0"), ("new", "0,1")):
        made = toy(*ALONE, f"sweep={name}", f"seed={seeds}", f"counting.label={name}", apart=True)
        assert made.returncode == 0, made.stderr
    toy()
    sweeps = toy.outputs / "sweeps"
    prune(toy, 0)
    assert toy.runs == []
    assert len(list(sweeps.glob("*/*/run.json"))) == 3
    assert "is the newest" in told_of(prune(toy, 0, "--sweeps", "1"), sweeps / "new")
    assert [each.name for each in sweeps.iterdir()] == ["new"]
    for job in (sweeps / "new").glob("[!.]*/"):
        check_wholeness(job)
    assert "2 done" in toy(*ALONE, "sweep=new", "seed=0,1", "counting.label=new", "plan=true").stdout
    scales = Command(toy.outputs, *CONFIG, "workflow=scales")
    job = next((sweeps / "new").glob("*seed=0*"))
    assert scales(f'weighing.what="{job}/tables"').returncode == 0
    assert f"is needed by {toy.runs[0].name}" in told_of(prune(toy, 1, "--sweeps", "0"), sweeps / "new")


@pytest.mark.slow
def test_a_sweep_at_work_stays(toy):
    process = toy.start("-m", "sweep=s", "seed=0,1", SLOWLY)
    wait_until(process, lambda: list(toy.outputs.glob("sweeps/s/.launches/*/launch.json")))
    for _ in range(3):
        prune(toy, 0, "--sweeps", "0")
        assert list(toy.outputs.glob("sweeps/s/.launches/*/launch.json"))
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors + output
    prune(toy, 0, "--sweeps", "0")
    assert not list((toy.outputs / "sweeps").iterdir())


def test_links_are_not_followed_and_read_only_files_go(done, tmp_path):
    (run,) = done.runs
    outside = tmp_path / "precious"
    outside.mkdir()
    (outside / "file").write_text("kept")
    (run / "documents" / "link").symlink_to(outside)
    (run / "documents" / "file link").symlink_to(outside / "file")
    (run / "documents").chmod(0o500)
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(run, elsewhere, symlinks=True)
    (run.parent / "2001-01-01_00-00-00").symlink_to(elsewhere)
    assert "is a link to elsewhere; remove it by hand" in prune(done, 0, before=obey_permissions)
    assert not run.exists()
    assert (outside / "file").read_text() == "kept"
    assert (elsewhere / "run.json").exists()


def die_at_the_second_folder():
    """Have a process end, as if it was killed, when it has removed one folder."""
    remove, count = os.rmdir, iter(range(2))
    os.rmdir = lambda *what, **how: os._exit(9) if next(count) == 1 else remove(*what, **how)


def test_killed_in_between_leaves_what_the_next_one_clears_up(many):
    first, *others = many.runs
    assert many.review("prune", "--keep", "3", before=die_at_the_second_folder).returncode == 9
    (hidden,) = many.outputs.glob("runs/.pruned-*")
    assert any(hidden.rglob("*"))
    assert not first.exists()
    assert f"{first.name} " not in many.review("list").stdout
    assert "not made before" not in many("seed=2", "plan=true").stdout
    assert many("seed=4").returncode == 0
    assert "left by a prune that was stopped" in prune(many, 4, "--dry-run")
    assert hidden.exists()
    prune(many, 4)
    assert not hidden.exists()
    assert many.runs[:3] == others


def test_a_folder_that_cannot_be_removed_or_read_is_left_alone(done):
    (run,) = done.runs
    run.parent.chmod(0o555)
    result = done.review("prune", "--keep", "0", before=obey_permissions)
    run.parent.chmod(0o755)
    assert result.returncode == 1
    (line,) = result.stderr.splitlines()
    assert f"cannot remove {run} (Permission denied); make {run.parent} writable" in line
    assert "0 folders removed, 0 bytes freed" in result.stdout
    check_wholeness(run)
    (run / "run.json").write_text("{}")
    (run.parent / "mine").mkdir()
    (run.parent / "note.txt").touch()
    before = snapshot(run.parent)
    reason = "has no run.json that can be read; look at it, and remove it by hand"
    assert reason in told_of(prune(done, 0), run)
    assert snapshot(run.parent) == before


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
    assert "no outputs folder" in toy.review("prune", "--keep", "1").stderr
    assert not toy.outputs.exists()
    toy.outputs.mkdir()
    assert "0 folders removed" in prune(toy, 1)


def test_outputs_that_are_no_folder(toy):
    toy.outputs.write_text("a letter")
    result = toy.review("prune", "--keep", "1")
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)
