"""Sweeps on two emulated nodes: spread, killed at every level, collected; nothing is lost, nothing done twice."""

import os
import signal
import subprocess
import time
from collections import Counter

import pytest

from tests.cluster.conftest import find_jobs, queue
from tests.cluster.emulated import NODES, wait_until
from tests.faults import check_wholeness, ledger_of
from tests.pipeline.conftest import end

pytestmark = pytest.mark.cluster
SLOW_TABLE = ("workflow=toy", "workers=1", "counting.label=a,b", "doubling.pause_s=0.5")
"""Two jobs that need the same table of stage doubling, of six parts, which takes some seconds."""
ALONE = "+hydra.launcher.additional_parameters.exclusive=true"
"""Each of Slurm's jobs has a node to itself."""


def run_stages(sweep):
    return [folder.name for folder in sweep.jobs.values() if " doubling: run, " in (folder / "log.txt").read_text()]


def test_tables_have_the_bytes_of_a_serial_run(sweep, serial):
    arguments = ("workflow=toy", "workers=1", "seed=range(4)", "doubling.pause_s=0.2")
    spread = sweep(*arguments)
    result = spread()
    assert result.returncode == 0, result.stdout + result.stderr
    assert spread.statuses == {"done": 4}
    assert set(spread.hosts.values()) == {*NODES}
    for folder in spread.jobs.values():
        check_wholeness(folder)
    assert spread.tables == serial(*arguments)
    again = spread()
    assert again.returncode == 0
    assert "submitted" not in again.stdout
    assert again.stdout.count("kept ") == 4


def test_two_nodes_want_one_table_and_one_makes_it(sweep, serial):
    racing = sweep(*SLOW_TABLE, ALONE)
    result = racing()
    assert result.returncode == 0, result.stdout + result.stderr
    assert {*racing.hosts.values()} == {*NODES}
    assert racing.count_runs("doubling") == 1
    assert racing.tables == serial(*SLOW_TABLE)


def test_a_node_that_crashes_while_it_makes_a_table_is_replaced(sweep, serial, lab):
    """The other one takes the table over, and then the job, which Slurm begins again there, in the same folder."""
    arguments = (*SLOW_TABLE[:-1], "doubling.pause_s=4")
    racing = sweep(*arguments, ALONE)
    process = racing.start()
    wait_until(lambda: racing.folder.exists() and len(list(racing.folder.glob("*/parts/*/[!.]*"))) >= 2, "parts", 120)
    (maker,) = run_stages(racing)
    host = racing.hosts[maker]
    lab.crash(host)
    wait_until(lambda: any(state == "PENDING" for _, state, _ in queue()), "the job to be requeued", 90)
    (name,) = (name for name, state, _ in queue() if state == "PENDING")
    subprocess.run(["scontrol", "update", f"jobid={name}", "starttime=now"], check=True)
    result = end(process, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    assert racing.statuses == {"done": 2}
    assert set(racing.hosts.values()) == {*NODES} - {host}
    assert len(run_stages(racing)) == 2
    assert racing.tables == serial(*arguments)


def test_a_requeued_job_goes_on_in_its_folder(sweep, serial):
    arguments = ("workflow=toy", "workers=1", "seed=3", "doubling.pause_s=1.5")
    alone = sweep(*arguments)
    process = alone.start()
    wait_until(lambda: alone.folder.exists() and len(list(alone.folder.glob("*/parts/*/[!.]*"))) >= 3, "parts", 120)
    ((name, _, _),) = queue()
    subprocess.run(["scontrol", "requeue", name], check=True)
    wait_until(lambda: queue()[0][1] == "PENDING", "the queue")
    subprocess.run(["scontrol", "update", f"jobid={name}", "starttime=now"], check=True)
    result = end(process, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    (folder,) = alone.jobs.values()
    assert " resumed: " in (folder / "log.txt").read_text()
    assert ledger_of(folder)["stages"]["counting"]["status"] == "done"
    assert alone.count_runs("counting") == 1
    assert alone.tables == serial(*arguments)


def test_a_time_limit_ends_a_job_and_is_told(sweep, serial):
    arguments = ("workflow=trials", "seed=0,1", "trying.pause_s=0,500")
    limited = sweep(*arguments, "hydra.launcher.timeout_min=1", "hydra.launcher.jobs_per_task=2")
    result = limited()
    assert result.returncode == 1, result.stdout + result.stderr
    told = [line for line in result.stderr.splitlines() if "reached its time limit of 1 min" in line]
    assert len(told) == 2
    assert "hydra.launcher.timeout_min= sets it" in told[0]
    assert result.stderr.strip().splitlines()[-1].startswith("2 of 4 jobs are not done; when that is mended, type: ")
    assert limited.statuses == {"done": 2, "killed": 2}


def test_a_drained_node_ends_what_it_has_and_the_other_does_the_rest(sweep, lab):
    draining = sweep("workflow=trials", "seed=range(8)", "trying.pause_s=3")
    process = draining.start()
    wait_until(lambda: len(draining.count("begun")) >= 4, "jobs", 120)
    subprocess.run(["scontrol", "update", "nodename=n2", "state=drain", "reason=test"], check=True)
    result = end(process, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    assert lab.states()["n2"] == "drained"
    assert draining.find_repeated("trying") == []
    assert Counter(draining.hosts.values())["n2"] == 2


def test_ctrl_c_stops_jobs_at_a_safe_point_and_empties_the_queue(sweep):
    stopped = sweep("workflow=trials", "seed=range(6)", "trying.pause_s=4")
    process = stopped.start()
    wait_until(lambda: len(stopped.count("begun")) >= 3, "jobs", 120)
    process.send_signal(signal.SIGINT)
    result = end(process, timeout=120)
    assert result.returncode == 130, result.stdout + result.stderr
    assert "Ctrl-C: the jobs at work stop at a safe point" in result.stdout
    assert not [each for each in queue() if each[1] != "COMPLETING"]
    assert stopped.statuses["not begun"] >= 1
    assert stopped.statuses["interrupted"] >= 1
    again = stopped("hydra.launcher.jobs_per_task=2")
    assert again.returncode == 0, again.stdout + again.stderr
    assert stopped.find_repeated("trying") == []


def test_slurm_refuses(sweep):
    result = sweep("workflow=trials", "seed=0,1", "hydra.launcher.partition=none")()
    assert result.returncode == 2
    assert result.stderr.strip() == "Slurm takes no jobs: sbatch: error: invalid partition specified: none"


def test_200_jobs_are_finished_by_the_same_command(sweep, serial):
    """Although jobs are killed, one of Slurm's is cancelled, and then the launcher is killed, whose jobs go on."""
    arguments = ("workflow=trials", "seed=range(200)", "trying.pause_s=0.3")
    storm = sweep(*arguments, "hydra.launcher.jobs_per_task=8")
    process = storm.start()
    killed = set()
    for number in (6, 14, 22):
        wait_until(lambda number=number: len(storm.count("ended")) >= number, "jobs", 180, look_s=0.05)
        victims = find_jobs()[:2]
        for each in victims:
            os.kill(each, signal.SIGKILL)
        killed |= {*victims}
    running = [name for name, state, _ in queue() if state == "RUNNING"]
    subprocess.run(["scancel", running[0]], check=True)
    wait_until(lambda: len(storm.count("ended")) >= 60, "jobs", 180, look_s=0.05)
    process.kill()
    end(process)
    before = storm.count("ended")
    time.sleep(5)
    assert len(storm.count("ended")) > len(before)
    for _ in range(2):
        result = storm()
        if result.returncode == 0:
            break
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr
    assert storm.statuses == {"done": 200}
    assert storm.find_repeated("trying") == []
    assert sum(storm.count("begun").values()) <= 200 + len(killed) + 8
    found = {name.replace("pause_s=0.3", "pause_s=0"): tables for name, tables in storm.tables.items()}
    assert found == serial("workflow=trials", "seed=range(200)", "trying.pause_s=0")
