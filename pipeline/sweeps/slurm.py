"""The jobs of a sweep on a Slurm cluster: submitted as arrays, watched, collected.

A launch and the overrides of its jobs flow in; an outcome for each flows out. The record of what is computed stays in
the jobs' folders: this module only adds which of Slurm's jobs computes which, in ``slurm.json`` of a launch. Jobs
outlive their launcher, and the next launch of the same sweep waits for those that an earlier one left in the queue.
"""

import importlib.util
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

from pipeline.errors import ConfigError, PipelineError
from pipeline.files import read_mapping, write_atomically, write_json
from pipeline.ledger import Ledger
from pipeline.printing import format_count
from pipeline.runs import is_running
from pipeline.sweeps.job import ELSEWHERE, tell_outcome
from pipeline.sweeps.launch import FOLDER, Launch, Outcome, name_job
from pipeline.terminal import say

PLUGIN = "hydra_plugins.hydra_submitit_launcher"
RECORD = "slurm.json"
LOGS = "slurm"
LOOK_S = 1.0
"""Between two looks which jobs noted an outcome, s."""
ASK_S = 10.0
"""Between two questions to Slurm which jobs it still has, s."""
GENERAL = ("name", "timeout_min", "mem_gb", "cpus_per_task", "gpus_per_node", "tasks_per_node", "nodes")
"""Parameters that submitit has for all clusters alike."""
OF_SUBMITIT = ("submitit_folder", "max_num_timeout", "signal_delay_s", "stderr_to_stdout")
"""Parameters of submitit's own launcher that are decided here."""
MOST_NAMED = 200
"""Jobs of Slurm's that one command line names."""
KILLED = 128 + signal.SIGKILL
REASONS = {
    "TIMEOUT": "reached its time limit of {timeout_min} min; hydra.launcher.timeout_min= sets it",
    "OUT_OF_MEMORY": "needed more than its {mem_gb} GB of memory; hydra.launcher.mem_gb= sets it",
    "NODE_FAIL": "its node failed",
    "CANCELLED": "was cancelled in Slurm's queue",
    "PREEMPTED": "was preempted by another job of the cluster",
    "COMPLETED": "ended without an outcome",
}
"""What Slurm's states of jobs that are no more mean to who set their limits."""


@dataclass(frozen=True)
class Task:
    """A job that Slurm has: the launch that submitted it, and Slurm's name of it, such as ``12_3``."""

    launch: Launch
    name: str


@dataclass(frozen=True)
class OnNode:
    """What a node calls for a job: the launcher as it was pickled, once for all jobs of a launch."""

    path: Path

    def __call__(self, jobs: Sequence[tuple[list[str], int]]) -> None:
        """Run jobs, each of overrides and a number, one after the other; what is raised ends up in Slurm's log."""
        import cloudpickle

        launcher, state = cloudpickle.loads(self.path.read_bytes())
        launch = launcher.task_function.launch
        ending: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, frame: ending.append(number))  # which the job has, too, and heeds
        for overrides, number in jobs:
            if ending:
                return
            job = name_job(overrides)
            earlier = launch.outcome(job)
            if "SLURM_RESTART_COUNT" in os.environ and earlier is not None and earlier.word == "killed":
                launch.forget(job)  # by Slurm, which begins it again
            result = launcher(overrides, "hydra.sweep.dir", number, str(number), state)
            _ = result.return_value  # raises what the job raised


def is_slurm(launcher: Mapping[str, Any]) -> bool:
    """Return whether the configuration of Hydra's launcher names Slurm's."""
    return str(launcher.get("_target_", "")).endswith(".SlurmLauncher")


def check_slurm() -> None:
    """Refuse to go on where jobs cannot be submitted."""
    if importlib.util.find_spec("hydra_plugins") is None or importlib.util.find_spec(PLUGIN) is None:
        raise ConfigError(
            "hydra/launcher=slurm: hydra-submitit-launcher is not installed; type: pip install -e '.[cluster]'"
        )
    if shutil.which("sbatch") is None or shutil.which("srun") is None:
        raise ConfigError(
            "hydra/launcher=slurm: no sbatch here; type the command on a login node of the cluster, or leave "
            "hydra/launcher=slurm out"
        )


def run_on_slurm(launch: Launch, launcher: Any, lists: Sequence[Sequence[str]]) -> None:
    """Submit the jobs that are to run and that Slurm does not have yet; return when all have ended.

    The `launcher` is Hydra's, set up with the function that runs a job.
    """
    begun = {job: Ledger.look(launch.sweep / job) for job in launch.jobs if launch.outcome(job) is None}
    queued = _find_queued(launch, begun)
    if queued:
        say(f"  wait  for {format_count(len(queued), 'job')} that an earlier launch left in Slurm's queue")
    new: list[int] = []
    for number, job in enumerate(launch.jobs):
        ledger = begun.get(job)
        if job not in begun or job in queued:
            continue
        if ledger is not None and ledger.status == "done" and launch.on_finished == "keep":
            _end(launch, job, Outcome("kept"))
        elif ledger is not None and is_running(ledger):
            _end(launch, job, ELSEWHERE)
        else:
            new.append(number)
    params = {name: each for name, each in launcher.params.items() if name not in OF_SUBMITIT}
    per_task, per_array = int(params.pop("jobs_per_task", 1)), int(params.pop("array_size", 1000))
    packs = [new[start : start + per_task] for start in range(0, len(new), per_task)]
    for start in range(0, len(packs), per_array):
        if launch.stop is None:
            queued |= _submit(launch, launcher, params, lists, packs[start : start + per_array])
    _watch(launch, queued, params)


def _find_queued(launch: Launch, jobs: Iterable[str]) -> dict[str, Task]:
    """Return which of the jobs Slurm still has from an earlier launch that was not asked to stop."""
    names = sorted(each.parent.name for each in (launch.sweep / FOLDER).glob(f"*/{RECORD}"))
    others = [each for name in names if (each := replace(launch, name=name)).stop is None]
    submitted = {job: Task(each, name) for each in others for job, name in read_mapping(each.folder / RECORD).items()}
    if not submitted:
        return {}
    present = _list_queue()
    if present is None:
        raise PipelineError("squeue does not answer, and an earlier launch may have jobs in Slurm's queue; try again")
    wanted = set(jobs)
    return {
        job: task
        for job, task in submitted.items()
        if job in wanted and task.name in present and task.launch.outcome(job) is None
    }


def _submit(
    launch: Launch,
    launcher: Any,
    params: Mapping[str, Any],
    lists: Sequence[Sequence[str]],
    packs: Sequence[Sequence[int]],
) -> dict[str, Task]:
    """Submit packs of jobs, by their numbers, as one array; return Slurm's names of them."""
    import cloudpickle
    import submitit
    from hydra.core.singleton import Singleton
    from submitit.core.utils import FailedJobError, FailedSubmissionError

    folder = launch.folder / LOGS
    path = folder / "launcher.pkl"
    pickled = cloudpickle.dumps((launcher, Singleton.get_state()))
    write_atomically(path, lambda temporary: temporary.write_bytes(pickled))
    try:
        executor = submitit.AutoExecutor(folder, cluster="slurm", slurm_max_num_timeout=0)
        executor.update_parameters(**{name if name in GENERAL else f"slurm_{name}": params[name] for name in params})
        executor.update_parameters(slurm_signal_delay_s=0)  # no word before the time limit: SIGTERM comes at it
        with redirect_stderr(StringIO()):  # sbatch's words are those of the error
            jobs = [[(list(lists[each]), each) for each in pack] for pack in packs]
            made = executor.map_array(OnNode(path.absolute()), jobs)
    except (FailedJobError, FailedSubmissionError, subprocess.CalledProcessError) as error:
        lines = [each for each in str(error).splitlines() if each.strip()]
        told = next((each for each in lines if "error:" in each), lines[-1] if lines else type(error).__name__)
        raise PipelineError(f"Slurm takes no jobs: {told.strip()}") from None
    except (ValueError, TypeError) as error:
        raise ConfigError(f"hydra.launcher: {str(error).splitlines()[0]}") from None
    tasks = {
        launch.jobs[each]: Task(launch, str(task.job_id))
        for pack, task in zip(packs, made, strict=True)
        for each in pack
    }
    named = {job: task.name for job, task in tasks.items()}
    write_json(launch.folder / RECORD, {**read_mapping(launch.folder / RECORD), **named})
    array = next(iter(named.values())).partition("_")[0]
    say(f"  submitted {format_count(len(tasks), 'job')}; to watch them, type: squeue -j {array}")
    return tasks


def _watch(launch: Launch, queued: dict[str, Task], params: Mapping[str, Any]) -> None:
    """Wait until each job has ended, and tell its outcome."""
    missed: set[str] = set()
    stopped, asked_s = False, time.monotonic()
    while queued:
        for task in {each.launch.name: each for each in queued.values()}.values():
            for job in task.launch.ended & {job for job, each in queued.items() if each.launch == task.launch}:
                if outcome := task.launch.outcome(job):
                    _end(launch, job, outcome)
                    del queued[job]
        if launch.stop is not None and not stopped:
            stopped = True
            _stop(launch, queued)
        if queued and time.monotonic() - asked_s >= ASK_S:
            if (present := _list_queue()) is not None:
                gone = {job for job, task in queued.items() if task.name not in present}
                _tell_gone(launch, {job: queued[job] for job in gone & missed}, params, queued)
                missed = gone
            asked_s = time.monotonic()
        time.sleep(LOOK_S)


def _end(launch: Launch, job: str, outcome: Outcome) -> None:
    launch.note(job, outcome)
    tell_outcome(launch, job, outcome)


def _stop(launch: Launch, queued: Mapping[str, Task]) -> None:
    """Pass on to the jobs that the launch is to stop, and take those that wait out of the queue.

    Jobs that another living launcher submitted are left to it.
    """
    own = [task for task in queued.values() if task.launch == launch or not task.launch.lease.is_held()]
    for other in {task.launch.name: task.launch for task in own if task.launch != launch}.values():
        other.ask_to_stop(launch.stop or "")
    names = sorted({task.name for task in own})
    for start in range(0, len(names), MOST_NAMED):
        _ask("scancel", "--quiet", "--state=PENDING", *names[start : start + MOST_NAMED])


def _tell_gone(launch: Launch, gone: Mapping[str, Task], params: Mapping[str, Any], queued: dict[str, Task]) -> None:
    """Tell of jobs that Slurm no longer has, and that noted no outcome, what Slurm says of them."""
    ended = _list_ended(sorted({task.name for task in gone.values()})) if gone else {}
    for job, task in gone.items():
        ledger = Ledger.read(launch.sweep / job)
        if task.launch.outcome(job) is not None or (ledger is not None and is_running(ledger)):
            continue  # it is told next time
        del queued[job]
        outcome = _describe_gone(ledger, task, ended.get(task.name), params)
        if launch.stop is None or outcome.word == "done":
            _end(launch, job, outcome)


def _describe_gone(
    ledger: Ledger | None, task: Task, said: tuple[str, str] | None, params: Mapping[str, Any]
) -> Outcome:
    if ledger is not None and ledger.status == "done":
        return Outcome("done", 0, ledger.seconds)
    state, node = said or ("", "")
    why = REASONS.get(state, f"ended as {state or 'unknown to its accounting'}").format_map(params)
    where = f" on {node}" if node and node != "None assigned" else ""
    told = f"Slurm's job {task.name}{where} {why}"
    if ledger is None:
        return Outcome("not begun", 1, told=f"{told} ({_last_line(task)})")
    if ledger.status in ("running", "interrupted"):
        stage = next((name for name, each in ledger.records.items() if each["status"] != "done"), "-")
        ledger.facts["seconds"] = ledger.seconds
        ledger.end("killed", {"stage": stage, "message": told})
    return Outcome("killed", KILLED, ledger.seconds, told)


def _last_line(task: Task) -> str:
    """Return the end of what a job printed to Slurm's log, and where that is."""
    path = task.launch.folder / LOGS / f"{task.name}_0_log.err"
    with suppress(OSError):
        if lines := path.read_text(encoding="utf-8", errors="replace").strip().splitlines():
            return f"{lines[-1]}; log: {path}"
    return f"log: {path}"


def _list_queue() -> set[str] | None:
    """Return Slurm's names of this person's jobs that wait or run, or None where Slurm does not answer."""
    answer = _ask("squeue", "--noheader", "--array", "--me", "--format=%i|%F_%K")
    return None if answer is None else {name for line in answer.splitlines() for name in line.split("|")}


def _list_ended(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return state and node of jobs that are no more, as far as Slurm keeps accounts."""
    found: dict[str, tuple[str, str]] = {}
    columns = ("--noheader", "--allocations", "--parsable2", "--format=JobID,State,NodeList")
    for start in range(0, len(names), MOST_NAMED):
        answer = _ask("sacct", *columns, "--jobs", ",".join(names[start : start + MOST_NAMED]))
        for line in (answer or "").splitlines():
            name, state, node = (f"{line}||").split("|")[:3]
            found[name] = state.partition(" ")[0], node
    return found


def _ask(*line: str) -> str | None:
    """Return what one of Slurm's commands printed, None where it failed."""
    try:
        done = subprocess.run(line, capture_output=True, text=True, timeout=60, start_new_session=True)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
