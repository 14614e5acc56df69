"""One job of a sweep, as Hydra's launcher calls it: a run in a folder of its own, in a process of its own.

A composed configuration flows in; a run's folder, and an outcome for the launch, flow out. Whatever becomes of a job, a
mistake in its configuration, an exception, a kill by the system, the launcher sees a job that ended.
"""

import os
import signal
import threading
from contextlib import suppress
from dataclasses import dataclass

from omegaconf import DictConfig

from pipeline.checkout import keep_changes, look_at_checkout
from pipeline.config import Study, read_study
from pipeline.errors import PipelineError, TakenError
from pipeline.ledger import Ledger
from pipeline.page import read_templates
from pipeline.plan import make_plan
from pipeline.report import try_report
from pipeline.runner import Runner
from pipeline.runs import claim, is_running, list_ledgers
from pipeline.stage import Stage, list_tables
from pipeline.sweeps.launch import STOPPED_BY_FAILURE, STOPPED_BY_SIGNAL, Launch, Outcome, is_meaningful, name_job
from pipeline.sweeps.subprocess_job import Ending, end_with_parent, run_in_subprocess
from pipeline.terminal import complain, open_console

TAKEN = 75
"""Exit code of a job's process that found another process to have begun the job meanwhile."""
ELSEWHERE = Outcome("elsewhere", told="another process has it at work")
COLOURS = {"done": "green", "kept": "green", "failed": "red", "killed": "red", "paused": "yellow"}


@dataclass(frozen=True)
class JobTask:
    """What Hydra's launcher calls for each job of a launch.

    Of a job that is `watched`, a cluster tells the launcher why it ended, or begins it again.
    """

    launch: Launch
    watched: bool = False

    def __call__(self, composed: DictConfig) -> int:
        """Run the job that was composed, unless there is nothing to do; return its exit code."""
        from hydra.core.hydra_config import HydraConfig

        if not self.launch.is_own and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the launch says when to stop
            end_with_parent(os.getpid())
        config = HydraConfig.get()
        overrides = [str(each) for each in config.overrides.task]
        job = name_job(overrides)
        if self.launch.outcome(job) is not None or self.launch.stop is not None:
            return 0
        given = [self.launch.files[each] for each in config.runtime.choices.values() if each in self.launch.files]
        try:
            outcome = self._run_if_needed(composed, job, self._list_arguments(overrides), given)
            if self.watched and outcome.word == "interrupted" and self.launch.stop is None:
                return outcome.code
            self.launch.note(job, outcome)
        except (PipelineError, OSError) as error:  # such as a full disk; the others may still find room
            outcome = Outcome("failed", 1, told=str(error))
        tell_outcome(self.launch, job, outcome)
        return outcome.code

    def _run_if_needed(
        self, composed: DictConfig, job: str, arguments: list[str], given: list[dict[str, str]]
    ) -> Outcome:
        folder = self.launch.sweep / job
        try:
            study, stages = read_study(composed)
        except Exception as error:  # of one job, whose others go on
            told = str(error) if isinstance(error, PipelineError) else f"{type(error).__name__}: {error}"
            why = told.splitlines()[0]
            with claim(folder.parents[2], "", arguments, folder) as held:
                keep_changes(folder, held.ledger.facts)
                held.ledger.end("failed", {"stage": "configuration", "message": why})
            return Outcome("failed", 2, told=why)
        before = Ledger.read(folder)
        if before is not None and is_running(before):
            return ELSEWHERE
        if before is not None and before.status == "done" and self.launch.on_finished == "keep":
            same = before.facts["identity"] == study.identity
            return Outcome("kept", told="" if same else "with another configuration; on_finished=refresh runs it again")
        _warm_up(study, stages)
        console = open_console(quiet=True)
        runner = Runner(study, stages, arguments, console, given, folder, workers=1)  # the sweep spreads jobs
        ending = run_in_subprocess(lambda: _run(runner), lambda: self.launch.stop == STOPPED_BY_SIGNAL)
        if ending.code == TAKEN:
            return ELSEWHERE
        ended = Ledger.read(folder)
        outcome = self._describe(ended, ending)
        if ended is not None and ended.status == "killed":
            try_report(ended, study, stages)
        return outcome

    def _describe(self, ledger: Ledger | None, ending: Ending) -> Outcome:
        """Return what became of a job that was run; note in its ledger what it could not note itself."""
        if ending.signal is not None:
            why = f"killed by {signal.Signals(ending.signal).name} after {ending.seconds:.1f} s"
            if ending.signal == signal.SIGKILL:
                why += f", perhaps for want of memory (it held {ending.peak_memory_mb:.0f} MB)"
            if ledger is not None and ledger.status == "running":
                stage = next((name for name, each in ledger.records.items() if each["status"] == "running"), "-")
                ledger.facts.update(peak_memory_mb=ending.peak_memory_mb)
                ledger.end("killed", {"stage": stage, "message": why})
            return Outcome("killed", ending.code, ending.seconds, why)
        error = ledger.facts["error"] if ledger is not None else None
        if ending.code == 0:
            return Outcome("done", 0, ending.seconds)
        lines = ending.output.strip().splitlines()
        why = f"{error['stage']}: {error['message']}" if error else (lines[-1] if lines else "no reason was given")
        word = ledger.status if ledger is not None and error else "failed"
        return Outcome(word, ending.code, ending.seconds, why)

    def _list_arguments(self, overrides: list[str]) -> list[str]:
        """Return what to type to run a job by itself."""
        files = {option: facts["file"] for option, facts in self.launch.files.items()}
        telling = (each.partition("=") for each in overrides if is_meaningful(each))
        typed = [f"{key}={files.get(value, value)}" for key, _, value in telling]
        others = [each for each in overrides if each.partition("=")[0] in ("outputs", "figures")]
        return [*self.launch.options, f"sweep={self.launch.sweep.name}", *typed, *others]


def tell_outcome(launch: Launch, job: str, outcome: Outcome) -> None:
    """Print the line of a job that ended; ask the others to stop if it failed and they are to."""
    from rich.markup import escape

    number = launch.jobs.index(job) + 1 if job in launch.jobs else 0
    width = len(str(len(launch.jobs)))
    colour = COLOURS.get(outcome.word, "dim")
    took = f"{outcome.seconds:7.1f} s" if outcome.seconds else " " * 9
    line = f"  {number:>{width}}/{len(launch.jobs)}  [{colour}]{outcome.word:<11}[/]{took}  "
    open_console().print(line + escape(f"{job}  {outcome.told}".rstrip()), soft_wrap=True, highlight=False)
    if outcome.code and outcome.word != "interrupted" and launch.on_failure == "stop" and launch.stop is None:
        launch.ask_to_stop(STOPPED_BY_FAILURE)


def _run(runner: Runner) -> int:
    try:
        return runner.run()
    except TakenError:
        return TAKEN
    except PipelineError as error:
        complain(str(error))
        return 2


def _warm_up(study: Study, stages: list[Stage]) -> None:
    """Do once in this process what each job would do again: ledgers, sources, templates and git are then read.

    Contracts are then in pandera's form, too.
    """
    with suppress(PipelineError):  # which the job itself will tell
        make_plan(study, stages, list_ledgers(study.settings.outputs))
    for table in list_tables(stages).values():
        _ = table.schema
    read_templates()
    look_at_checkout()
