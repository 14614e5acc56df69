"""A Slurm cluster on one machine, from Debian's packages: two nodes, accounting, and a file system that they share.

Each node has its own processes, host name and mounts, so that nothing of one is seen from the other but files; they
reach these through a mount each, over which locks do not carry. The second node's clock is five minutes ahead for what
runs on it. All state lies in one folder. As root, ``python -m tests.cluster.emulated FOLDER`` brings it up
until Ctrl-C.
"""

import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

NODES = ("n1", "n2")
DATABASE_PORT, ACCOUNTING_PORT, CONTROL_PORT, NODE_PORT = 13306, 16819, 16817, 17001
SOCKET = "/run/mysqld/mysqld.sock"
AHEAD_S = 300
SLURM_CONF = """
ClusterName=lab
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
SlurmctldPort={control}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/log/slurmctld.log
SlurmdLogFile={folder}/log/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
TaskProlog={folder}/etc/task_prolog
MpiDefault=none
ReturnToService=2
SlurmdTimeout=15
SlurmctldTimeout=30
InactiveLimit=0
KillWait=5
MinJobAge=300
SchedulerType=sched/backfill
SchedulerParameters=sched_interval=5,bf_interval=5
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobAcctGatherType=jobacct_gather/linux
AccountingStorageType=accounting_storage/slurmdbd
AccountingStorageHost=localhost
AccountingStoragePort={accounting}
NodeName=n[1-2] NodeHostname={host} NodeAddr=127.0.0.1 Port=[{node}-{last}] CPUs=2 RealMemory=4000 State=UNKNOWN
PartitionName=main Nodes=n[1-2] Default=YES MaxTime=INFINITE State=UP
"""
ACCOUNTING_CONF = """
AuthType=auth/munge
DbdHost=localhost
DbdPort={accounting}
SlurmUser=root
LogFile={folder}/log/slurmdbd.log
PidFile={folder}/slurmdbd.pid
StorageType=accounting_storage/mysql
StorageHost=127.0.0.1
StoragePort={database}
StorageUser=slurm
StoragePass=slurm
StorageLoc=slurm_acct_db
"""
TASK_PROLOG = """#!/bin/sh
test "$SLURMD_NODENAME" = n2 || exit 0
echo export LD_PRELOAD={library}
echo export FAKETIME=+{ahead}s NO_FAKE_STAT=1 FAKETIME_DONT_FAKE_MONOTONIC=1
"""
NODE = """
hostname {name}
umount -l {shared}
bindfs {options} {disk} {shared}
slurmd -D -N {name} -f {conf}
"""
MOUNT = "-o attr_timeout=0,entry_timeout=0,negative_timeout=0"


class Cluster:
    """The cluster in a folder; `shared` in it is what its machines share, this one, which is the login node, too."""

    def __init__(self, folder):
        self.folder = Path(folder).resolve()
        self.shared = self.folder / "shared"
        self.nodes = {}
        self.database = None
        os.environ["SLURM_CONF"] = self._conf = str(self.folder / "etc" / "slurm.conf")

    def start(self):
        """Bring everything up; return when both nodes are idle."""
        for name in ("etc", "state", "log", "disk", "shared", *(f"spool/{each}" for each in NODES)):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        for each in (self.folder, *self.folder.parents):
            each.chmod(each.stat().st_mode | 0o055)  # the database's user comes by here
        self._write_configuration()
        run("bindfs", *MOUNT.split(), self.folder / "disk", self.shared)
        run("install", "-d", "-o", "munge", "-g", "munge", "-m", "0755", "/run/munge")
        run("runuser", "-u", "munge", "--", "/usr/sbin/munged", "--force")
        self._start_database()
        run("slurmdbd")
        wait_until(lambda: answers("sacctmgr", "-i", "list", "cluster"), "slurmdbd")
        run("sacctmgr", "-i", "add", "cluster", "lab")
        run("slurmctld", "-f", self._conf)
        for each in NODES:
            self.start_node(each)
        wait_until(lambda: self.states() == dict.fromkeys(NODES, "idle"), "the nodes")

    def stop(self):
        """End all that was started."""
        for each in list(self.nodes):
            self.crash(each)
        for name in ("slurmctld", "slurmdbd"):
            end(read_pid(self.folder / f"{name}.pid"))
        if self.database is not None:
            end(self.database.pid)
            self.database.wait()
        end(read_pid("/run/munge/munged.pid"))
        subprocess.run(["umount", "-l", self.shared], check=False)

    def start_node(self, name):
        """Begin a node anew, as a machine that was switched on."""
        values = {"name": name, "shared": self.shared, "disk": self.folder / "disk", "conf": self._conf}
        script = NODE.format(options=MOUNT, **values)
        spaces = ("--pid", "--fork", "--uts", "--mount", "--mount-proc", "--kill-child")
        line = ["unshare", *spaces, "sh", "-c", script]
        with (self.folder / "log" / f"{name}.out").open("ab") as log:
            self.nodes[name] = subprocess.Popen(line, stdout=log, stderr=log, start_new_session=True)

    def crash(self, name):
        """End a node with all that runs on it, at once, as a machine whose power fails."""
        process = self.nodes.pop(name)
        process.kill()
        process.wait()

    def states(self):
        """Return the state of each node."""
        lines = ask("sinfo", "--noheader", "--Node", "--format=%N %T").splitlines()
        return dict(line.split() for line in lines)

    def _write_configuration(self):
        values = {
            "host": platform.node(),
            "folder": self.folder,
            "database": DATABASE_PORT,
            "accounting": ACCOUNTING_PORT,
            "control": CONTROL_PORT,
            "node": NODE_PORT,
            "last": NODE_PORT + len(NODES) - 1,
            "ahead": AHEAD_S,
            "library": next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1")),
        }
        etc = self.folder / "etc"
        for name, text, mode in (
            ("slurm.conf", SLURM_CONF, 0o644),
            ("slurmdbd.conf", ACCOUNTING_CONF, 0o600),
            ("task_prolog", TASK_PROLOG, 0o755),
        ):
            (etc / name).write_text(text.format(**values).lstrip())
            (etc / name).chmod(mode)

    def _start_database(self):
        own = ("--no-defaults", "--user=mysql", f"--datadir={self.folder}/mysql")
        Path(SOCKET).parent.mkdir(exist_ok=True)
        for each in (Path(SOCKET).parent, self.folder / "mysql"):
            each.mkdir(exist_ok=True)
            shutil.chown(each, "mysql", "mysql")
        run("mariadb-install-db", *own, "--auth-root-authentication-method=socket")
        more = ("--bind-address=127.0.0.1", f"--port={DATABASE_PORT}", f"--socket={SOCKET}")
        sizes = ("--innodb-buffer-pool-size=128M", "--innodb-lock-wait-timeout=900")
        with (self.folder / "log" / "mariadb.log").open("ab") as log:
            line = ["mariadbd", *own, *more, *sizes]
            self.database = subprocess.Popen(line, stdout=log, stderr=log, start_new_session=True)
        wait_until(lambda: answers("mariadb", "-S", SOCKET, "-e", "select 1"), "the database")
        for line in (
            "create database if not exists slurm_acct_db",
            "create user if not exists slurm@127.0.0.1 identified by 'slurm'",
            "create user if not exists slurm@localhost identified by 'slurm'",
            "grant all on slurm_acct_db.* to slurm@127.0.0.1",
            "grant all on slurm_acct_db.* to slurm@localhost",
        ):
            run("mariadb", "-S", SOCKET, "-e", line)


def run(*line):
    """Run a command that must end well."""
    done = subprocess.run([str(each) for each in line], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{line}: {done.stdout[-500:]}{done.stderr[-500:]}")


def ask(*line):
    """Return what a command printed."""
    return subprocess.run([str(each) for each in line], capture_output=True, text=True).stdout


def answers(*line):
    """Return whether a command ends well."""
    return subprocess.run(line, capture_output=True).returncode == 0


def read_pid(path):
    """Return the process that a file names, or None."""
    try:
        return int(Path(path).read_text())
    except (OSError, ValueError):
        return None


def end(pid):
    """End a process, and wait until it is gone."""
    if pid is None:
        return
    try:
        os.kill(pid, signal.SIGTERM)
        for _ in range(100):
            os.kill(pid, 0)
            if "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text():
                return
            time.sleep(0.1)
        os.kill(pid, signal.SIGKILL)
    except (ProcessLookupError, FileNotFoundError):
        return


def wait_until(holds, what, within_s=60, look_s=0.3):
    """Wait until a condition holds."""
    deadline = time.monotonic() + within_s
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(what)
        time.sleep(look_s)


if __name__ == "__main__":
    cluster = Cluster(sys.argv[1])
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        cluster.start()
        print(f"export SLURM_CONF={cluster.folder}/etc/slurm.conf; the shared folder is {cluster.shared}", flush=True)
        signal.pause()
    except KeyboardInterrupt:
        pass
    finally:
        cluster.stop()
