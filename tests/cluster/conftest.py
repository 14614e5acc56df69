"""The emulated cluster, brought up once, and sweeps of the toy workflows on it."""

import os
import platform
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from tests.cluster.emulated import NODES, Cluster, ask, wait_until
from tests.conftest import Command
from tests.faults import ledger_of, tables_of
from tests.pipeline.conftest import CONFIG

SLURM = ("hydra/launcher=slurm", "hydra.launcher.mem_gb=1", "hydra.launcher.timeout_min=10")


class Sweep(Command):
    """The command with a sweep of a toy workflow; each seed that is tried is noted when it begins and ends."""

    def __init__(self, folder, log, *fixed):
        super().__init__(folder / "outputs", *CONFIG, "-m", "sweep=s", "figures=[]", *fixed)
        self.anew = True
        self.log = log
        self.environment |= {"TOY_LOG": str(log)}

    @property
    def folder(self):
        return self.outputs / "sweeps" / "s"

    @property
    def jobs(self):
        """The folder of each job that was begun, by name."""
        found = [each for each in self.folder.iterdir() if each.is_dir() and not each.name.startswith(".")]
        return {each.name: each for each in found}

    @property
    def tables(self):
        return {name: tables_of(folder) for name, folder in self.jobs.items()}

    @property
    def statuses(self):
        return Counter(pd.read_parquet(self.folder / "sweep.parquet")["status"])

    @property
    def hosts(self):
        """The node on which each job was done."""
        return {name: ledger_of(folder)["machine"]["host"] for name, folder in self.jobs.items()}

    def count(self, word):
        """Return how often each seed was begun or ended."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return Counter(int(line.split()[1]) for line in lines if line.startswith(word))

    def count_runs(self, stage):
        """Return how often a stage was computed, in all jobs together."""
        logs = [(folder / "log.txt").read_text() for folder in self.jobs.values()]
        return sum(log.count(f" {stage}: run, ") for log in logs)

    def find_repeated(self, stage):
        """Return the jobs that computed a stage again when it was done; one killed before it could say so is spared."""
        logs = {name: (folder / "log.txt").read_text() for name, folder in self.jobs.items()}
        ended = {name: re.search(f" {stage}: (done in|fresh)", log) for name, log in logs.items()}
        return [name for name, log in logs.items() if f" {stage}: run, " in log[ended[name].end() :]]


@pytest.fixture(scope="session")
def cluster(tmp_path_factory):
    if shutil.which("slurmctld") is None or shutil.which("bindfs") is None or os.geteuid() != 0:
        pytest.skip("needs root and Debian's packages; type: sh tests/cluster/install.sh")
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        made.start()
        yield made
    finally:
        made.stop()


@pytest.fixture
def lab(cluster):
    """The cluster with both nodes idle and an empty queue, as it is left."""
    yield cluster
    ask("scancel", "--user=root")
    for name in NODES:
        if name not in cluster.nodes:
            cluster.start_node(name)
        if cluster.states()[name] != "idle":
            subprocess.run(["scontrol", "update", f"nodename={name}", "state=resume"], capture_output=True)
    wait_until(lambda: cluster.states() == dict.fromkeys(NODES, "idle"), "idle nodes", within_s=120)


@pytest.fixture
def sweep(lab, request, tmp_path):
    """Return a sweep of a workflow on the cluster, its outputs in the shared folder."""
    return lambda *fixed: Sweep(lab.shared / request.node.name, tmp_path / "log.txt", *SLURM, *fixed)


@pytest.fixture
def serial(tmp_path):
    """Return the tables of a sweep whose jobs follow each other on this machine."""

    def run(*arguments):
        made = Sweep(tmp_path / "serial", tmp_path / "serial.txt", "hydra.launcher.n_jobs=1", *arguments)
        made.anew = False
        assert made().returncode == 0
        assert set(made.hosts.values()) == {platform.node()}
        return made.tables

    return run


def queue():
    """Return Slurm's jobs that wait or run: their name, state and node."""
    lines = ask("squeue", "--noheader", "--array", "--format=%i %T %N").splitlines()
    return [tuple(f"{line} -".split()[:3]) for line in lines]


def find_processes(text):
    """Return the processes of this machine, on whatever node, whose command line has a text, with their parents'."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            line = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if text in line:
            found[int(path.name)] = parent
    return found


def find_jobs():
    """Return the processes in which jobs are computed on nodes: each is forked off one that Slurm began."""
    found = find_processes("submitit.core._submit")
    return [each for each, parent in found.items() if parent in found]
