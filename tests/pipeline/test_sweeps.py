"""Sweeps by Hydra's multirun: resumed, extended, killed at every level, by two processes at once; nothing is lost."""

import os
import shutil
import signal
import time
from collections import Counter
from importlib.util import find_spec

import pandas as pd
import pytest

from pipeline.sweeps.launch import LONGEST_NAME, name_job, new_launch_name
from tests.conftest import Command
from tests.faults import check_wholeness, ledger_of, limit_file_size, tables_of, wait_until
from tests.pipeline.conftest import (
    ALONE,
    CONFIG,
    children_of,
    end,
    refusal,
    success,
    the_only_line,
    wait_for_the_end_of,
)


class Sweeping(Command):
    """The command with a workflow whose jobs fail or die, and a file in which each begins and ends."""

    def __init__(self, folder, *fixed):
        super().__init__(folder / "outputs", *CONFIG, "workflow=trials", "sweep=s", *fixed)
        self.log = folder / "log.txt"
        self.environment |= {"TOY_LOG": str(self.log)}

    @property
    def sweep(self):
        return self.outputs / "sweeps" / "s"

    @property
    def table(self):
        return pd.read_parquet(self.sweep / "sweep.parquet")

    @property
    def statuses(self):
        return Counter(self.table["status"])

    def count(self, word):
        """Return how often each seed was begun or ended."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return Counter(int(line.split()[1]) for line in lines if line.startswith(word))

    def job(self, seed):
        (found,) = (each for each in self.sweep.iterdir() if f"seed={seed}," in f"{each.name},")
        return found


@pytest.fixture
def sweeping(request, tmp_path):
    """A sweep whose jobs are spread over processes, in the slow step by a launcher that is started and ends in full."""
    made = Sweeping(tmp_path, "-m")
    made.anew = request.node.get_closest_marker("slow") is not None
    return made


@pytest.fixture
def alone(tmp_path):
    """A sweep whose jobs follow each other."""
    return Sweeping(tmp_path, *ALONE)


def mend(sweeping, line):
    """Run the command that a line ends with, as printed, when what made jobs fail is mended."""
    sweeping.environment |= {"TOY_MENDED": "yes"}
    return sweeping.retype(line.split("type: ", 1)[-1])


@pytest.mark.slow
def test_40_jobs_with_3_failures_are_finished_by_the_printed_command(sweeping):
    """Although a worker and then the launcher are killed on the way: what was done is not done again."""
    arguments = ("seed=range(40)", "trying.fail_at=[3,12,26]", "trying.pause_s=0.1", "hydra.launcher.n_jobs=2")
    process = sweeping.start(*arguments)
    wait_until(process, lambda: len(sweeping.count("ended")) >= 8)
    os.kill(next(iter(find_workers(process.pid))), signal.SIGKILL)
    wait_until(process, lambda: len(sweeping.count("ended")) >= 18)
    assert "a worker process was killed; its jobs begin again, and the sweep goes on" in kill_launcher(process)
    done = {seed for seed in sweeping.count("begun") if ledger_of(sweeping.job(seed))["status"] == "done"}
    assert 14 <= len(done) < 37
    until_killed = sweeping.count("begun")
    result = end(sweeping.start(*arguments), 300)
    assert result.returncode == 1
    assert "37 done, 3 failed" in result.stdout
    lines = result.stderr.splitlines()
    for seed in (3, 12, 26):
        assert sum(f"seed={seed}," in line and f"ArithmeticError: cannot try {seed}" in line for line in lines) == 1
    assert "3 of 40 jobs are not done; when that is mended, type: " in lines[-1]
    assert sweeping.statuses == {"done": 37, "failed": 3}
    before = sweeping.count("begun")
    again = mend(sweeping, lines[-1])
    assert again.returncode == 0, again.stderr
    assert {*sweeping.statuses} == {"done"}
    assert sweeping.count("begun") - before == dict.fromkeys((3, 12, 26), 1)
    assert sweeping.count("ended").keys() == set(range(40))
    assert not (before - until_killed).keys() & done
    broken_off = sum(count - 1 for seed, count in before.items() if seed not in (3, 12, 26))
    assert broken_off <= 4


def test_a_sweep_is_planned_run_extended_and_tabled(alone):
    plan = success(alone, "seed=0,1", "counting.count=2,3", "plan=true")
    assert "4 jobs (4 not begun)" in plan
    assert "seed: 0, 1" in plan
    assert not alone.outputs.exists()
    assert alone("seed=0,1", "counting.count=2").returncode == 0
    assert "4 jobs (2 done, 2 not begun)" in success(alone, "seed=0,1", "counting.count=2,3")
    assert alone.count("ended") == {0: 2, 1: 2}
    table = alone.table.set_index("seed")
    assert sorted(table["counting.count"]) == ["2", "2", "3", "3"]
    assert alone.statuses == {"done": 4}
    assert table.loc["1", "score_m"].min() > table.loc["0", "score_m"].max()
    assert (table["wall_s"] > 0).all()
    assert (table["peak_memory_mb"] > 10).all()


def test_an_earlier_jobs_tables_are_shared_also_by_jobs_that_begin_together(sweeping):
    assert sweeping("trying.pause_s=0.1,0.2,0.3").returncode == 0
    jobs = list(sweeping.sweep.glob("[!.]*/"))
    assert len({ledger_of(each)["stages"]["counting"]["origin"] for each in jobs}) == 1
    assert len({(each / "tables" / "numbers.parquet").stat().st_ino for each in jobs}) == 1


def test_the_first_failure_stops_the_rest_if_asked(alone):
    result = alone("seed=range(6)", "trying.fail_at=[1]", "on_failure=stop")
    assert result.returncode == 1
    assert alone.count("begun") == {0: 1, 1: 1}
    assert alone.statuses == {"done": 1, "failed": 1, "not begun": 4}


def test_jobs_that_fail_or_are_killed_lose_no_other_and_are_made_again_alone_or_together(alone):
    result = alone("seed=0,1,2,-1", "trying.fail_at=[1]", "trying.die_at=[2]", "trying.pause_s=0.05")
    assert result.returncode == 1
    assert "ArithmeticError: cannot try 1" in result.stderr
    assert "killed by SIGKILL" in result.stderr
    assert "perhaps for want of memory" in result.stderr
    assert "seed: input should be greater than or equal to 0, got -1" in result.stderr
    assert alone.statuses == {"done": 1, "failed": 2, "killed": 1}
    assert alone.count("begun") == dict.fromkeys(range(3), 1)
    page = (alone.job(2) / "report.html").read_text()
    assert ">killed<" in page
    assert "killed by SIGKILL" in page

    assert set(tables_of(alone.job(0))) == {"numbers.parquet", "tried.parquet"}
    facts = ledger_of(alone.job(0))
    assert facts["seconds"] >= 0.05
    assert facts["metrics"]["score_m"] == {
        "value": pytest.approx(pd.read_parquet(alone.job(0) / "tables" / "tried.parquet")["score"].item()),
        "unit": "m",
    }

    page = alone.job(1) / "report.html"
    assert ">failed<" in page.read_text()
    mended = mend(alone, ledger_of(alone.job(1))["command"])
    assert mended.returncode == 0, mended.stderr
    assert ledger_of(alone.job(1))["status"] == "done"
    assert ">done<" in page.read_text()
    assert ">failed<" not in page.read_text()
    again = mend(alone, result.stderr.splitlines()[-1])
    assert again.returncode == 1
    assert alone.statuses == {"done": 3, "failed": 1}
    assert alone.count("begun") == {0: 1, 1: 2, 2: 2}


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_jobs_at_a_safe_point(sweeping, number, code):
    process = sweeping.start("seed=range(6)", "trying.pause_s=1.5")
    wait_until(process, lambda: sweeping.count("begun"))
    process.send_signal(number)
    result = end(process)
    assert result.returncode == code
    assert "to continue, type: " in result.stderr
    assert {*sweeping.statuses} <= {"interrupted", "not begun", "done"}
    assert sweeping("seed=range(6)", "trying.pause_s=1.5").returncode == 0
    assert sweeping.count("ended") == dict.fromkeys(range(6), 1)


@pytest.mark.slow
def test_a_full_disk_loses_nothing(sweeping):
    more = ("seed=0,1,2", "counting.count=30000")
    result = sweeping(*more, before=limit_file_size(200_000))
    assert result.returncode == 1
    for job in sweeping.sweep.glob("[!.]*/"):
        check_wholeness(job)
    success(sweeping, *more)
    assert {*sweeping.statuses} == {"done"}


def test_a_copied_sweep_is_whole_elsewhere(alone, tmp_path):
    alone("seed=0,1", "trying.fail_at=[1]")
    other = Sweeping(tmp_path / "other", *ALONE)
    shutil.copytree(alone.outputs, other.outputs)
    shutil.rmtree(alone.outputs)
    (other.sweep / "sweep.parquet").unlink()
    other.environment |= {"TOY_MENDED": "yes"}
    result = success(other, "seed=0,1,2", "trying.fail_at=[1]", "on_failure=stop")
    assert "3 jobs (1 done, 1 failed, 1 not begun)" in result
    assert other.count("ended") == {1: 1, 2: 1}
    assert {*other.statuses} == {"done"}


def test_one_job_after_the_other_without_the_parallel_launcher(sweeping):
    success(sweeping, "seed=0,1", "hydra/launcher=basic")
    assert sweeping.log.read_text().splitlines() == ["begun 0", "ended 0", "begun 1", "ended 1"]
    assert "(done before)" in success(sweeping, "seed=0,1", "hydra/launcher=basic", "on_finished=refresh")
    assert sweeping.count("begun") == {0: 1, 1: 1}


def test_a_missing_value_or_a_stage_that_cannot_be_imported_fails_its_job_alone(alone, tmp_path):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "__init__.py").touch()
    (tmp_path / "broken" / "counting.py").write_text("import nothing_of_this_name\n")
    alone.environment["PYTHONPATH"] = str(tmp_path)
    result = alone("workflow=scales,count", "workflow.package=tests.pipeline.toy,broken")
    assert result.returncode == 1, result.stderr
    assert alone.statuses == {"done": 1, "failed": 3}
    for told in ("missing value: set it as weighing.what=...", "ModuleNotFoundError: No module named 'nothing_of_this"):
        assert told in result.stderr
    assert result.stderr.splitlines()[-1].startswith("3 of 4 jobs are not done; ")


def test_help_runs_nothing(sweeping):
    assert "== Choices of a group" in success(sweeping, "--help", apart=False)
    assert not sweeping.outputs.exists()


def test_a_folder_that_cannot_be_written_is_told_in_one_line(alone):
    alone.sweep.parent.mkdir(parents=True)
    alone.sweep.write_text("no folder")
    assert the_only_line(alone("seed=0,1")).startswith(f"cannot write to {alone.sweep} (Not a directory)")


@pytest.mark.slow
def test_a_launcher_killed_between_jobs_leaves_nothing_at_work(sweeping):
    process = sweeping.start("seed=range(40)", "counting.count=2", "hydra.launcher.n_jobs=1")
    wait_until(process, lambda: len(sweeping.count("ended")) >= 3)
    kill_launcher(process)
    ended = sweeping.count("ended")
    time.sleep(2.0)
    assert sweeping.count("ended") == ended


@pytest.mark.slow
def test_a_killed_launchers_workers_end_also_while_they_wait(sweeping):
    process = sweeping.start("seed=0,1,2", "trying.pause_s=3.0", "hydra.launcher.n_jobs=3")
    workers = wait_until(process, lambda: len(sweeping.count("begun")) == 3 and find_workers(process.pid))
    os.kill(process.pid, signal.SIGSTOP)  # so that the workers, done, wait
    wait_until(process, lambda: len(sweeping.count("ended")) == 3)
    process.kill()
    process.communicate(timeout=30)  # not before the workers have let go of what it prints to
    wait_for_the_end_of(workers)


@pytest.mark.slow
def test_two_processes_share_a_sweep_and_what_the_other_begins_is_no_failure(sweeping):
    processes = [sweeping.start("seed=range(5)", "trying.pause_s=1.0", "on_failure=stop") for _ in range(2)]
    for result in [end(each, 120) for each in processes]:
        assert result.returncode == 0, result.stderr + result.stdout
        assert "failed" not in result.stdout
    assert sweeping.count("begun") == sweeping.count("ended") == dict.fromkeys(range(5), 1)
    assert {*sweeping.statuses} == {"done"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("sweep=a/b", "seed=0,1"), "sweep: "),
        (("workers=1,2",), "more than once"),
        (("sweep=a,b", "seed=0"), "sweep: expected one name"),
        (("seed=interval(0,3)",), "seed: expected values"),
        (("counting=glob(*)",), "counting: expected values"),
        (("seed=range(0)",), "no job, as a key has no value at all"),
        (("sweep=2026", "seed=0,1"), "sweep: expected a name"),
        (("sweep=latest", "seed=0,1"), "sweep: expected a name"),
        (("sweep=null", "seed=0,1"), "sweep: expected a name"),
        (("+experiment=quick,paper",), "experiment: an option is chosen already"),
        (("counting=few,nothing",), "nothing"),
        (("hydra.launcher.n_jobs=x",), "hydra.launcher.n_jobs=x: "),
        (("counting.label=a b,c=d",), "needs quotes"),
        (("--cfg", "job", "seed=0,1"), "Only one of"),
        (("on_failure=giveup", "seed=0,1"), "on_failure: "),
        (("hydra/sweeper=none", "seed=0,1"), "unknown"),
        (("operator_ui=terminal", "seed=0,1"), "operator_ui: expected null in a sweep"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused_in_one_line(sweeping, arguments, told):
    sweeping.fixed = tuple(each for each in sweeping.fixed if each != "sweep=s" or arguments[0][:5] != "sweep")
    assert told in refusal(sweeping, *arguments, apart=False)


def find_workers(parent):
    """Return the processes that a launcher started."""
    found = children_of(parent)
    return {each: line for each, line in found.items() if "loky" in line and "resource_tracker" not in line}


def kill_launcher(process):
    """Kill a launcher, and wait until none of its workers is there any more; return what it printed."""
    workers = find_workers(process.pid)
    process.kill()
    printed = end(process)
    wait_for_the_end_of(workers)
    return printed.stdout


def test_launches_of_one_second_are_told_apart():
    names = [new_launch_name() for _ in range(50)]
    assert sorted(set(names)) == names


def test_slurm_is_refused_in_a_line_where_it_is_not(tmp_path):
    sweeping = Sweeping(tmp_path, "-m", "hydra/launcher=slurm")
    planned = success(sweeping, "seed=0,1", "plan=true")
    assert "2 jobs (2 not begun)" in planned
    sweeping.environment |= {"PATH": str(tmp_path)}
    line = the_only_line(sweeping("seed=0,1"))
    if find_spec("submitit") is None:
        assert line.endswith("hydra-submitit-launcher is not installed; type: pip install -e '.[cluster]'")
    else:
        assert line.startswith("hydra/launcher=slurm: no sbatch here; type the command on a login node")
    mistyped = the_only_line(sweeping("seed=0,1", "hydra.launcher.timeout=5"))
    assert mistyped == "unknown key 'hydra.launcher.timeout': did you mean 'timeout_min'?"


def test_a_long_name_keeps_the_end_of_each_override_where_its_value_stands():
    same = [f"columns.name_of_signal_{each}=column_{each}" for each in "abcdefgh"]
    one, other = (name_job([*same, f"discrepancy.verification_share={share}", "seed=1"]) for share in (0.3, 0.4))
    assert ("share=0.3," in one, "share=0.4," in other) == (True, True)
    assert len(one.rpartition("-")[0]) <= LONGEST_NAME
    assert name_job(["seed=1", *reversed(same)]) == name_job([*same, "seed=1"])
