"""A sweep: many jobs by one command, of which none is lost, none done twice, and all end up in one table.

A command line with several values for some keys flows in. Hydra makes jobs of it, and the launcher that it was told to
use runs them; what is added here is what its multirun lacks: a plan before, a folder for each job named by its
overrides, a table of all jobs after, the reasons of those that failed, the command that finishes the rest, and going on
without a killed worker.
"""

import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from datetime import datetime
from itertools import product
from pathlib import Path
from types import FrameType
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, ValueType
from hydra.core.plugins import Plugins
from hydra.experimental.callback import Callback
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf

from pipeline.command import command_line, read_options, review_line
from pipeline.config import Settings, read_settings
from pipeline.errors import ConfigError
from pipeline.failures import MOST_LISTED, list_reasons
from pipeline.files import CONFIG_FOLDER
from pipeline.interruption import WORDS
from pipeline.lease import name_process
from pipeline.ledger import Ledger
from pipeline.printing import format_count, format_counts
from pipeline.runs import is_running, live_status, sweeps_folder
from pipeline.sweeps.launch import STOPPED_BY_SIGNAL, Launch, name_job, new_launch_name
from pipeline.sweeps.slurm import check_slurm, is_slurm, run_on_slurm
from pipeline.terminal import complain, say
from pipeline.tracking.destination import check_mlflow
from pipeline.tracking.follower import following

MULTIRUN = ("-m", "--multirun")
NO_PROGRESS = 3
"""Deaths of workers in a row, between which no job ended, after which a launch gives up."""
LOOK_S = 0.5
"""Between two looks whether another process is done with a job, s."""
BEGINNING = ("not begun", "failed", "killed", "interrupted", "paused")
"""States of jobs that a launch runs."""


def name_sweep(arguments: Sequence[str]) -> list[str]:
    """Return the command line with a name for its sweep: the present time where none was typed."""
    if any(each.startswith("sweep=") for each in arguments):
        return list(arguments)
    return [*arguments, f"sweep={datetime.now():%Y-%m-%d_%H-%M-%S}"]


def run_sweep(
    overrides: Sequence[str], typed: Sequence[str], search_path: str | None, files: Mapping[str, dict[str, str]]
) -> int:
    """Plan a sweep, launch it, and tell what came of it.

    The overrides are for Hydra to read, `typed` is the command line with the sweep named. The exit code is 0 where
    every job is done, 1 where one is not, 130 or 143 where a signal stopped the launch.
    """
    overrides_typed = read_options(typed).overrides
    if search_path:
        overrides = [*overrides, f"hydra.searchpath=[file://{Path(search_path).resolve()}]"]
    base, lists = _expand(overrides)
    settings = read_settings({name: _plain(base[name]) for name in Settings.model_fields if name in base})
    if settings.sweep is None:
        raise ConfigError("sweep: expected a name, as in sweep=night, got null; leave it out for the time of day")
    name = settings.interface
    if base.get(name) is not None:
        raise ConfigError(f"{name}: expected null in a sweep, whose jobs run at the same time; leave {name}= or -m out")
    folder = sweeps_folder(settings.outputs) / settings.sweep
    jobs = tuple(map(name_job, lists))
    twice = [name for name, count in Counter(jobs).items() if count > 1]
    if twice:
        raise ConfigError(
            f"sweep: {len(jobs)} jobs but '{twice[0]}' more than once; vary keys that change what a job computes"
        )
    for line in describe_plan(folder, dict(zip(jobs, lists, strict=True)), settings.on_finished):
        say(line)
    if settings.plan:
        say(f"to run it: {command_line([each for each in typed if not each.startswith('plan=')])}")
        return 0
    if is_slurm(base.hydra.launcher):
        check_slurm()
    if settings.tracking:
        check_mlflow()
    launch = Launch(
        folder,
        new_launch_name(),
        name_process(),
        jobs,
        settings.on_failure,
        settings.on_finished,
        files,
        tuple(each for each in typed if each not in overrides_typed and each not in MULTIRUN),
    )
    lease = launch.lease
    try:
        launch.folder.mkdir(parents=True)
        lease.take()
        launch.begin(command_line(list(typed)), typed, lists)
    except OSError as error:
        raise ConfigError(
            f"cannot write to {folder} ({error.strerror}); free the folder, or choose another with sweep=NAME or "
            "outputs=PATH"
        ) from None
    try:
        with following(settings.outputs, settings.tracking) as follow:
            follow(folder)
            with _stopping(launch) as stopped:
                _supervise(launch, lambda: _launch(launch, base, lists), stopped)
            return _print_end(launch, list(typed), stopped)
    finally:
        lease.release()


def describe_plan(folder: Path, jobs: Mapping[str, Sequence[str]], on_finished: str) -> Iterator[str]:
    """Yield what a launch of a sweep would do, in lines, from the overrides of its jobs by their folders' names."""
    states = {name: _state(folder / name) for name in jobs}
    counts = Counter(states.values())
    yield f"sweep {folder}: {format_count(len(jobs), 'job')} ({format_counts(counts)})"
    axes: dict[str, dict[str, None]] = {}
    for key, _, value in (each.partition("=") for job in jobs.values() for each in job):
        axes.setdefault(key, {})[value] = None
    for key, values in axes.items():
        if len(values) > 1:
            yield f"  {key}: {', '.join(values)}"
    beginning = (*BEGINNING, "done") if on_finished == "refresh" else BEGINNING
    waiting = [name for name, state in states.items() if state in beginning]
    for name in waiting[:MOST_LISTED]:
        yield f"  run   {name}{'' if states[name] == 'not begun' else f'  ({states[name]} before)'}"
    if len(waiting) > MOST_LISTED:
        yield f"  run   ... and {len(waiting) - MOST_LISTED} more"
    if counts["done"] and on_finished == "keep":
        yield f"  keep  {counts['done']} done before (on_finished=refresh looks whether they are still fresh)"
    if counts["running"]:
        yield f"  wait  for {counts['running']} that another process has at work"


def _expand(overrides: Sequence[str]) -> tuple[DictConfig, list[list[str]]]:
    """Return the configuration of the first job, and the overrides of all jobs, of which each can be composed."""
    parser = OverridesParser.create()
    parsed = parser.parse_overrides(list(overrides))
    task = [each for each in parsed if not each.key_or_group.startswith("hydra")]
    others = [str(each.input_line) for each in parsed if each.key_or_group.startswith("hydra")]
    if any(each.key_or_group == "sweep" and each.is_sweep_override() for each in task):
        raise ConfigError("sweep: expected one name, as all jobs lie in one folder")
    for override in task:
        if override.value_type in (ValueType.INTERVAL_SWEEP, ValueType.GLOB_CHOICE_SWEEP):
            key = override.get_key_element()
            raise ConfigError(f"{key}: expected values, as in {key}=1,2 or '{key}=range(8)', got {override.input_line}")
    lists = _combine(task)
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONFIG_FOLDER), version_base="1.3"):
        base = hydra.compose("config", overrides=[*lists[0], *others], return_hydra_config=True)
        chosen = [f"{key}={value}" for key, value in (base.hydra.sweeper.get("params") or {}).items()]
        if chosen:
            lists = _combine([*parser.parse_overrides(chosen), *task])
            base = hydra.compose("config", overrides=[*lists[0], *others], return_hydra_config=True)
        kinds = {_kind(parser, each): each for each in reversed(lists)}
        for each in [*kinds.values()][-2::-1]:
            hydra.compose("config", overrides=[*each, *others])
    if not str(base.hydra.sweeper["_target_"]).endswith("BasicSweeper"):
        raise ConfigError("hydra/sweeper: expected basic, as a sweep is planned before it runs; leave it out")
    if base.hydra.callbacks:
        raise ConfigError("hydra.callbacks: expected none in a sweep, which calls none; leave them out")
    return base, lists


def _combine(overrides: list[Override]) -> list[list[str]]:
    """Return the overrides of each job."""
    choices: dict[str, list[str]] = {}
    for each in overrides:
        values = each.sweep_string_iterator() if each.is_sweep_override() else [each.get_value_element_as_str()]
        choices[each.get_key_element()] = [f"{each.get_key_element()}={value}" for value in values]
    lists = [list(each) for each in product(*choices.values())]
    if not lists:
        raise ConfigError("sweep: no job, as a key has no value at all; give it some, as in 'seed=range(8)'")
    return lists


def _kind(parser: OverridesParser, overrides: Sequence[str]) -> tuple[tuple[str, Any], ...]:
    """Return what decides whether a job can be composed: the options that it chooses, not its numbers."""
    parsed = [(each.get_key_element(), each.value()) for each in parser.parse_overrides(list(overrides))]
    return tuple((key, value if isinstance(value, str) else type(value).__name__) for key, value in parsed)


def _plain(value: Any) -> Any:
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def _state(folder: Path) -> str:
    ledger = Ledger.look(folder)
    return "not begun" if ledger is None else live_status(ledger)


def _supervise(launch: Launch, run: Callable[[], None], stopped: list[int]) -> None:
    """Have Hydra run the jobs, again where a worker's death took the others with it, or another process had some."""
    deaths = 0
    while True:
        ended = launch.ended
        try:
            run()
        except BrokenProcessPool:
            deaths = deaths + 1 if launch.ended == ended else 1
            if stopped or deaths == NO_PROGRESS:
                return
            say("  a worker process was killed; its jobs begin again, and the sweep goes on")
            continue
        elsewhere = [job for job in launch.jobs if (found := launch.outcome(job)) and found.word == "elsewhere"]
        if not elsewhere or stopped or launch.stop:
            return
        while not stopped and any(is_running(Ledger(launch.sweep / job)) for job in elsewhere):
            time.sleep(LOOK_S)
        for job in elsewhere:
            launch.forget(job)


def _launch(launch: Launch, base: DictConfig, lists: Sequence[Sequence[str]]) -> None:
    """Hand the jobs to the launcher that the configuration of the first one names, as a sweeper of Hydra does."""
    from pipeline.sweeps.job import JobTask

    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONFIG_FOLDER), version_base="1.3"):
        context = HydraContext(GlobalHydra.instance().config_loader(), Callback())  # type: ignore[arg-type]
        on_slurm = is_slurm(base.hydra.launcher)
        launcher = Plugins.instance().instantiate_launcher(context, JobTask(launch, watched=on_slurm), base)
        if on_slurm:
            run_on_slurm(launch, launcher, lists)
            return
        for result in launcher.launch(lists, initial_job_idx=0):
            _ = result.return_value  # raises what a job raised


@contextmanager
def _stopping(launch: Launch) -> Iterator[list[int]]:
    """Let a first signal ask the jobs to end, and a second one end this process at once, its workers with it."""
    stopped: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if stopped:
            os._exit(128 + number)
        stopped.append(number)
        launch.ask_to_stop(STOPPED_BY_SIGNAL)
        say(f"{WORDS[signal.Signals(number)]}: the jobs at work stop at a safe point; once more stops at once")

    before = {number: signal.signal(number, note) for number in WORDS}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print_end(launch: Launch, typed: list[str], stopped: list[int]) -> int:
    from pipeline.sweeps.sweep_table import collect_sweep, write_frame

    states = {job: _state(launch.sweep / job) for job in launch.jobs}
    try:
        path = write_frame(launch.sweep, *collect_sweep(launch.sweep))
        say(f"{format_counts(Counter(states.values()))}: {path}")
        say(f"page: {review_line(str(launch.sweep.parent.parent), 'sweep', launch.sweep.name)}")
    except OSError as error:
        where = error.filename or launch.sweep
        complain(f"cannot write {where}: {error.strerror}; the jobs' own folders are as they are")
    failed = {job: state for job, state in states.items() if state in ("failed", "killed", "paused")}
    for line in list_reasons(launch.sweep, failed):
        complain(line)
    unfinished = sum(state != "done" for state in states.values())
    if unfinished:
        when = "to continue" if stopped else "when that is mended"
        complain(f"{unfinished} of {len(states)} jobs are not done; {when}, type: {command_line(typed)}")
    if stopped:
        return 128 + stopped[0]
    return 1 if unfinished else 0
