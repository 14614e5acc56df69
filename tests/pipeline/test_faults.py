"""Faults that really happen to real processes: nothing lost, nothing half-written taken for whole, one clear line."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import partialmethod
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.files import write_folder, write_text
from tests.faults import (
    STOPPING,
    check_wholeness,
    find_parts,
    find_temporaries,
    ledger_of,
    limit_file_size,
    obey_permissions,
    overwrite,
    slow_down_disk,
    tables_of,
    wait_until,
)
from tests.pipeline.conftest import SLOWLY, end, kill, success, the_only_line


def finish(toy, reference, *arguments):
    """The same command again ends well, with the tables of an unbroken run and no leftovers."""
    printed = success(toy, *arguments)
    assert tables_of(toy.runs[-1]) == reference
    assert not find_temporaries(toy)
    return printed


@pytest.mark.slow
def test_killed_at_twelve_random_instants(toy, reference):
    generator = np.random.default_rng(3)
    for delay_s in generator.uniform(0.0, 2.0, 12):
        process = toy.start(SLOWLY, "figures=[png]")
        time.sleep(delay_s)
        kill(process)
        for run in toy.runs:
            check_wholeness(run)
        if process.returncode == 0:
            assert tables_of(toy.runs[-1]) == reference
            shutil.rmtree(toy.outputs)
    finish(toy, reference, SLOWLY)


def test_killed_in_the_middle_of_writing_a_table(toy):
    many = "counting.count=100000"
    process = toy.start(many, "doubling.fail_at=0", before=slow_down_disk)
    wait_until(process, lambda: [path for path in find_temporaries(toy) if path.suffix == ".parquet"])
    kill(process)
    (run,) = toy.runs
    assert find_temporaries(toy)
    assert tables_of(run) == {}
    check_wholeness(run)
    again = toy(many, "doubling.fail_at=0")
    assert f"resuming {run}" in again.stdout
    assert not find_temporaries(toy)
    assert len(pd.read_parquet(run / "tables/numbers.parquet")) == 100000


def test_killed_in_the_middle_of_writing_a_part(toy, reference):
    process = toy.start(SLOWLY, before=slow_down_disk)
    wait_until(process, lambda: [path for path in find_temporaries(toy) if path.parent.parent.name == "parts"])
    kill(process)
    (run,) = toy.runs
    check_wholeness(run)
    assert f"{run.name}   killed" in toy.review("list").stdout
    assert f"resuming {run}" in finish(toy, reference, SLOWLY)
    assert toy.runs == [run]
    assert (run / "log.txt").read_text().count("counting: done") == 1


def test_full_disk(toy):
    arguments = ("counting.count=30000", "doubling.fail_at=0")
    line = the_only_line(toy(*arguments, before=limit_file_size(200_000)), 1)
    assert f"cannot write to {toy.runs[0]}: File too large" in line
    assert "what was finished is kept; make room, then type: " in line
    assert line.endswith("doubling.fail_at=0")
    assert tables_of(toy.runs[0]) == {}
    assert not find_temporaries(toy)
    assert f"{toy.runs[0].name}   failed" in toy.review("list").stdout
    assert f"resuming {toy.runs[0]}" in toy(*arguments).stdout
    assert len(pd.read_parquet(toy.runs[0] / "tables/numbers.parquet")) == 30000


def test_full_file_system(toy, reference):
    toy.outputs.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=48k", "tmpfs", toy.outputs], capture_output=True)
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted here")
    try:
        for _ in range(2):
            assert "No space left on device" in the_only_line(toy(), 1)
            check_wholeness(toy.runs[0])
        subprocess.run(["mount", "-o", "remount,size=8m", toy.outputs], check=True)
        finish(toy, reference)
        assert len(toy.runs) == 1
    finally:
        subprocess.run(["umount", toy.outputs], check=True)


def test_read_only_outputs(toy, reference):
    toy.outputs.mkdir(mode=0o555)
    line = the_only_line(toy(before=obey_permissions))
    assert f"cannot write to {toy.outputs / 'runs'} (Permission denied)" in line
    assert "choose another with outputs=PATH" in line
    assert toy.runs == []
    toy.outputs.chmod(0o755)
    finish(toy, reference)


def test_run_that_cannot_be_read_or_lacks_a_table_is_passed_over(done, reference):
    (run,) = done.runs
    (run / "tables/doubles.parquet").chmod(0)
    plan = done("plan=true", before=obey_permissions)
    assert f"tables/doubles.parquet of run {run.name} cannot be read (Permission denied)" in plan.stdout
    shown = done.review("show", "latest", "doubles", before=obey_permissions)
    assert "cannot be read (permission denied)" in the_only_line(shown)
    run.chmod(0)
    assert "unreadable" in done.review("list", before=obey_permissions).stdout
    run.chmod(0o755)
    facts = ledger_of(run)
    facts["stages"]["counting"]["tables"] = {}
    (run / "run.json").write_text(json.dumps(facts))
    finish(done, reference)
    assert len(done.runs) == 2


def test_file_in_the_way(toy, reference):
    toy("doubling.fail_at=3")
    (run,) = toy.runs
    (run / "config.yaml").unlink()
    (run / "config.yaml").mkdir()
    line = the_only_line(toy("doubling.fail_at=3"), 1)
    assert f"cannot write to {run}/config.yaml: Is a directory" in line
    assert "make it writable or move it away" in line


def test_report_is_made_again(done):
    page = done.runs[0] / "report.html"
    page.write_text(page.read_text()[:200])
    assert done().returncode == 0
    assert page.read_text().rstrip().endswith("</html>")


def test_outputs_that_are_no_folder(toy):
    toy.outputs.write_text("a letter")
    for arguments in ([], ["plan=true"]):
        assert f"cannot read {toy.outputs / 'runs'} (Not a directory)" in the_only_line(toy(*arguments))
    assert toy.outputs.read_text() == "a letter"


def test_finished_tables_are_read_only(done):
    paths = [str(path) for path in done.runs[0].glob("*/*")]
    writing = "import os, sys; print([path for path in sys.argv[1:] if os.access(path, os.W_OK)])"
    line = [sys.executable, "-c", writing, *paths]
    assert subprocess.run(line, preexec_fn=obey_permissions, capture_output=True, text=True).stdout == "[]\n"
    assert len(paths) >= 6


def flipped(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 1
    return bytes(content)


DAMAGES = {
    "truncated": lambda path: path.read_bytes()[:-40],
    "flipped": flipped,
    "foreign": lambda path: path.with_name("numbers.parquet").read_bytes(),
    "older": lambda path: pd.read_parquet(path).drop(columns="double").to_parquet(),
    "missing": lambda path: pd.read_parquet(path).assign(double=float("nan")).to_parquet(),
    "one missing": lambda path: pd.read_parquet(path).assign(double=lambda its: its["double"].shift()).to_parquet(),
}


@pytest.mark.parametrize("damage", ["truncated", "flipped", "foreign", "missing", "one missing"])
def test_damaged_table_is_remade(done, reference, damage):
    path = done.runs[0] / "tables/doubles.parquet"
    overwrite(path, DAMAGES[damage](path))
    told = finish(done, reference)
    assert f"tables/doubles.parquet of run {done.runs[0].name} is damaged" in told
    assert ledger_of(done.runs[1])["stages"]["doubling"]["origin"] == done.runs[1].name


@pytest.mark.parametrize("damage", ["truncated", "older", "missing", "one missing"])
def test_damaged_part_is_told_and_not_taken(killed, reference, damage):
    part = sorted(find_parts(killed))[0]
    path = part / "doubles.parquet"
    overwrite(path, DAMAGES[damage](path))
    line = the_only_line(killed(SLOWLY), 1)
    assert str(path) in line
    assert f"remove the folder {part}, and this part of the loop is made again" in line
    shutil.rmtree(part)
    finish(killed, reference, SLOWLY)
    assert len(killed.runs) == 1


def test_unreadable_ledger_is_passed_over(done, reference):
    ledger = done.runs[0] / "run.json"
    facts, half = ledger_of(done.runs[0]), ledger.read_text()[:-100]
    of_an_older_format = json.dumps({**facts, "format": 0})
    del facts["stages"]["doubling"]["tables"]
    damaged = (json.dumps(facts), 5000 * "[", of_an_older_format, half)
    for text in damaged:
        ledger.write_text(text)
        assert "unreadable" in done.review("list").stdout
        the_only_line(done.review("show", done.runs[0].name))
        assert done("plan=true").stdout.count("not made before") == 3
        assert ledger.read_text() == text
    finish(done, reference)
    assert len(done.runs) == 2
    assert ledger.read_text() == damaged[-1]


def test_stage_that_breaks_its_contract(toy):
    told = "table numbers (on write): column draw: expected no missing value, got nan in row 2"
    assert told in the_only_line(toy("counting.spoil=missing_value"), 1)
    assert tables_of(toy.runs[0]) == {}
    assert ledger_of(toy.runs[0])["status"] == "failed"


def test_clock_set_back(killed, reference):
    killed()
    for run, name in zip(killed.runs, ("2099-01-01_00-00-00", "2099-01-02_00-00-00"), strict=True):
        ledger = (run / "run.json").read_text().replace(run.name, name)
        (run / "run.json").write_text(re.sub(r'"20\d\d-', '"2099-', ledger))
        run.rename(run.with_name(name))
    assert killed("counting.label=later").returncode == 0
    now, _, ahead = killed.runs
    assert ledger_of(now)["started"] < ledger_of(ahead)["started"]
    assert ledger_of(now)["sequence"] > ledger_of(ahead)["sequence"]
    assert str(now) in killed.review("show", "latest").stdout
    assert tables_of(now) == reference
    assert "everything is fresh" in killed("counting.label=later").stdout
    assert "resuming" in killed(SLOWLY).stdout
    assert len(killed.runs) == 3


def test_four_runs_at_once(toy, reference):
    processes = [toy.start("doubling.pause_s=0.05") for _ in range(4)]
    results = [end(process, 120) for process in processes]
    assert [each.returncode for each in results] == [0] * 4, results
    assert len(toy.runs) >= 1
    for run in toy.runs:
        check_wholeness(run)
        assert ledger_of(run)["status"] == "done"
        assert tables_of(run) == reference
    assert "everything is fresh" in toy("doubling.pause_s=0.05").stdout


def test_a_run_beside_one_of_the_same_study(toy, reference):
    first = toy.start(SLOWLY)
    wait_until(first, lambda: find_parts(toy))
    first.send_signal(signal.SIGSTOP)  # until the other one is at work
    (run,) = toy.runs
    before = (run / "config.yaml").stat().st_mtime_ns
    second = toy.start(SLOWLY)
    wait_until(second, lambda: len(toy.runs) == 2)
    first.send_signal(signal.SIGCONT)
    for result in (end(first), end(second)):
        assert result.returncode == 0, result.stderr
    assert [tables_of(each) == reference for each in toy.runs] == [True, True]
    assert (run / "config.yaml").stat().st_mtime_ns == before
    assert "resumed" not in (run / "log.txt").read_text()


@pytest.mark.parametrize("deaf", ["null", "swallow", "wrap"])
@pytest.mark.parametrize("number", STOPPING)
def test_signal_in_a_stage(toy, reference, number, deaf):
    code, word = STOPPING[number]
    arguments = ("doubling.pause_s=0.3", f"doubling.deaf={deaf}")
    process = toy.start(*arguments)
    wait_until(process, lambda: find_parts(toy))
    time.sleep(0.05)  # into the next pause
    process.send_signal(number)
    line = the_only_line(end(process, 30), code)
    assert f"doubling interrupted: stopped by {word}; to continue, type: " in line
    assert line.endswith(arguments[-1])
    assert ledger_of(toy.runs[0])["status"] == "interrupted"
    assert "Traceback" not in (toy.runs[0] / "log.txt").read_text()
    assert len(find_parts(toy)) < 6
    finish(toy, reference, *arguments)
    assert len(toy.runs) == 1


def test_impatient_ctrl_c(toy, reference):
    process = toy.start("doubling.pause_s=0.3", anew=True)
    wait_until(process, lambda: find_parts(toy))
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
    the_only_line(end(process, 30), 130)
    assert ledger_of(toy.runs[0])["status"] == "interrupted"
    finish(toy, reference, "doubling.pause_s=0.3")


THREADED = """
import threading, time
from pipeline.interruption import watch

for _ in range(4):
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
try:
    with watch():
        print("ready", flush=True)
        time.sleep(60)
except BaseException as error:
    print(error, flush=True)
"""


def test_a_storm_of_ctrl_c_among_threads_says_nothing_of_its_own():
    for _ in range(10):
        line, pipe = [sys.executable, "-c", THREADED], subprocess.PIPE
        with subprocess.Popen(line, stdout=pipe, stderr=pipe, text=True) as process:
            process.stdout.readline()
            while process.poll() is None:
                process.send_signal(signal.SIGINT)
            result = end(process, 30)
        assert (result.returncode, result.stdout, result.stderr) == (0, "stopped by Ctrl-C\n", "")


def is_listening(process):
    """SIGTERM is handled: Python has begun to run the command."""
    with open(f"/proc/{process.pid}/status") as status:
        caught = next(line for line in status if line.startswith("SigCgt")).split()[1]
    return int(caught, 16) >> (signal.SIGTERM - 1) & 1


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="a process's signals cannot be seen here")
@pytest.mark.parametrize(
    ("number", "delays_s"),
    [(signal.SIGINT, (0.0, 0.3, 0.7)), (signal.SIGTERM, (0.1, 0.5))],
)
def test_signal_at_any_instant_of_the_start(toy, number, delays_s):
    code, word = STOPPING[number]
    for delay_s in delays_s:
        process = toy.start("doubling.pause_s=60", anew=True)
        wait_until(process, lambda process=process: is_listening(process))
        time.sleep(delay_s)
        process.send_signal(number)
        line = the_only_line(end(process, 30), code)
        assert f"stopped by {word}" in line
        assert line.endswith("doubling.pause_s=60")


def test_a_reader_who_leaves_does_not_stop_the_run(toy, reference):
    process = toy.start(anew=True)
    process.stdout.close()
    with process.stderr:
        errors = process.stderr.read()
    assert process.wait(timeout=60) == 0
    assert errors == ""
    assert ledger_of(toy.runs[0])["status"] == "done"
    assert tables_of(toy.runs[0]) == reference


def test_stage_that_raises(toy, reference):
    result = toy("doubling.fail_at=3")
    assert "doubling failed: ArithmeticError: cannot double 3" in the_only_line(result, 1)
    (run,) = toy.runs
    assert (run / "log.txt").read_text().count("Traceback") == 1
    assert f"report: {run / 'report.html'}" in result.stdout
    page = (run / "report.html").read_text()
    assert "ArithmeticError: cannot double 3" in page
    assert "Traceback (most recent call last):" in page
    assert "What was done before is kept; this goes on from there, when that is mended:" in page
    plan = re.search(r"<summary>plan.*?</table>", page, re.DOTALL).group()
    rows = re.findall(r"<tr><td>(\w+)</td><td>([\w ]+)</td>", plan)
    assert rows == [("counting", "ran"), ("doubling", "failed"), ("adding", "not reached")]
    assert "<summary>counting: " in page
    assert "<summary>adding: " not in page
    check_wholeness(run)
    assert "doubles.parquet" not in tables_of(run)
    finish(toy, reference)
    assert ledger_of(toy.runs[1])["stages"]["counting"]["origin"] == run.name


def test_outputs_copied_to_another_place(killed, reference, tmp_path):
    killed()
    copied = killed.copy(tmp_path / "elsewhere" / "my outputs")
    shutil.rmtree(killed.outputs)
    assert "everything is fresh" in copied().stdout
    assert "resuming" in finish(copied, reference, SLOWLY)
    assert not killed.outputs.exists()
    shutil.rmtree(copied.runs[0])
    assert tables_of(copied.runs[0]) == reference


def test_another_study_goes_on_with_the_parts_of_a_loop_that_was_killed(killed, reference):
    (before,) = killed.runs
    landed = len(find_parts(killed))
    assert killed("workflow.name=other", SLOWLY).returncode == 0
    other = next(run for run in killed.runs if run != before)
    assert tables_of(other) == reference
    assert f"doubling: goes on with parts of {before.name}" in (other / "log.txt").read_text()
    assert len(find_parts(killed)) == landed


@pytest.fixture
def reached(monkeypatch):
    """What reaches the disk, by inode, and what is named, in this order."""
    reached, sync = [], os.fsync

    def sync_and_note(handle):
        reached.append(os.fstat(handle).st_ino)
        sync(handle)

    def note(path, rename, target):
        reached.append("named")
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", sync_and_note)
    for rename in (Path.replace, Path.rename):
        monkeypatch.setattr(Path, rename.__name__, partialmethod(note, rename))
    return reached


def test_bytes_then_the_name_then_the_folder_reach_the_disk(tmp_path, reached):
    write_text(tmp_path / "a.txt", "whole")
    assert reached == [(tmp_path / "a.txt").stat().st_ino, "named", tmp_path.stat().st_ino]


def test_files_then_their_folder_then_its_name_reach_the_disk(tmp_path, reached):
    folder = tmp_path / "part"
    write_folder(folder, {"a": b"whole", "b": b"too"})
    assert reached == [
        *(each.stat().st_ino for each in (folder / "a", folder / "b", folder)),
        "named",
        tmp_path.stat().st_ino,
    ]
    assert (folder / "a").read_bytes() == b"whole"
    write_folder(folder, {"a": b"other"})
    assert (folder / "a").read_bytes() == b"whole"
    assert [*tmp_path.iterdir()] == [folder]
