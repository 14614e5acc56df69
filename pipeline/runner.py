"""Walks the plan: claims a folder, runs what is not fresh, links what is, and says how to go on.

A study and its stages flow in; out flows a run's folder whose ledger says ``done``, or where and why it stopped. The
ledger is written last at every step, so whatever a killed process leaves behind is found again or ignored.
"""

import errno
import logging
import math
import os
import shutil
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from pipeline.checkout import keep_changes
from pipeline.command import command_line
from pipeline.config import Study, find_target, read_study
from pipeline.context import Context, Record
from pipeline.errors import ConfigError, PipelineError
from pipeline.files import link, link_folder, write_json, write_text
from pipeline.interruption import Interrupted, Watch, watch
from pipeline.ledger import FILE_NAME, Ledger, files_of, now
from pipeline.plan import Ingredients, Step, decide, find_parts, gather, make_plan, parts_folder
from pipeline.report import PAGE_NAME, print_headline, try_report, write_report
from pipeline.runs import Claim, claim, list_ledgers, make_exclusively, sweeps_folder
from pipeline.stage import Stage, list_tables
from pipeline.sweeps.launch import name_job
from pipeline.table import measure_file, read_frame
from pipeline.terminal import complain, open_console, say
from pipeline.tracking.follower import following
from pipeline.workers import Workers, count_cores

log = logging.getLogger("pamid")

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""What the system says when the disk takes no more."""


@dataclass
class Runner:
    """One run of a workflow.

    The stages are all of the workflow, in the order of the data; the arguments are the overrides as typed, for the
    command that resumes; `given` are files that gave options of config groups, for the ledger. A job of a sweep must
    have its `place`; another run gets a folder of its own. The `workers` count where the configuration leaves them
    open. `follow` is called with the run's folder once it is known.
    """

    study: Study
    stages: Sequence[Stage]
    arguments: list[str]
    console: Console
    given: Sequence[dict[str, str]] = ()
    place: Path | None = None
    workers: int | None = None
    follow: Callable[[Path], None] = lambda folder: None
    _opened: ExitStack = field(default_factory=ExitStack, init=False)

    @cached_property
    def _pool(self) -> Workers:
        workers = Workers(self.study.settings.workers or self.workers or count_cores())
        self._opened.callback(workers.close)
        return workers

    @cached_property
    def _connection(self) -> Any:
        """What devices are connected to, the same for all stages of a run.

        An interface has ``open()``, a context of it and of lines that say how to use it.
        """
        interface = self.study.build(self.study.settings.interface)
        connection, greeting = self._opened.enter_context(interface.open())
        for line in greeting:
            self._say(line)
        return connection

    @property
    def outputs(self) -> str:
        """The outputs folder."""
        return self.study.settings.outputs

    @property
    def identity(self) -> str:
        """By which an unfinished run of the same is found again."""
        return self.study.identity

    def show_plan(self) -> None:
        """Print what would run and why; write nothing."""
        steps = self._plan()
        for step in steps:
            self._print_step(step)
        for stage in [step.stage for step in steps]:
            for line in stage.preview(self.study.config(stage)) if stage.preview else []:
                self._say(f"  {line}")
        if all(step.action in ("fresh", "kept") for step in steps):
            self._say("everything is fresh: nothing would run")
        else:
            self._say(f"to run it: {command_line([each for each in self.arguments if not each.startswith('plan=')])}")

    def run(self) -> int:
        """Run the workflow, unless a PipelineError says that the run cannot begin.

        The exit code is 0 done, 1 a stage failed, 3 paused for a person, 130 Ctrl-C, 143 SIGTERM.
        """
        steps = self._plan()
        if finished := self._finished_run(steps):
            self.follow(finished.folder)
            for step in steps:
                self._print_step(step)
            self._finish(finished, "everything is fresh: nothing to run")
            return 0
        with watch() as signals, claim(self.outputs, self.identity, self.arguments, self.place) as held, self._opened:
            try:
                with _log_file(held.ledger.folder):
                    return self._run_claimed(held, [step.stage for step in steps], signals)
            except OSError as error:
                return self._refuse(held.ledger, error)

    def _run_claimed(self, held: Claim, stages: Sequence[Stage], signals: Watch) -> int:
        ledger, stage = held.ledger, stages[0]
        known = [each.name for each in self.stages]
        ledger.facts["stages"] = {name: record for name, record in ledger.records.items() if name in known}
        try:
            if self.given:
                ledger.facts["given"] = list(self.given)
            ledger.save()  # by which the folder is found again if nothing else finds room
            keep_changes(ledger.folder, ledger.facts)
            ledger.save()
            (ledger.folder / PAGE_NAME).unlink(missing_ok=True)
            write_text(ledger.folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(self.study.values)))
            self.follow(ledger.folder)
            self._say(f"{'resuming' if held.resumed else 'run'} {ledger.folder}")
            log.info("%s: %s", "resumed" if held.resumed else "begun", command_line(self.arguments))
            for each in self.given:
                log.info("%s is %s (SHA-256 %s)", each["group"], each["file"], each["sha256"])
            for stage in stages:
                self._process_stage(stage, ledger, signals)
                signals.check()
            ledger.facts["metrics"] = _read_metrics(ledger, self.study, self.stages)
            write_report(ledger, self.study, self.stages, "done")
            self._clear_parts(ledger)
            self._conclude(ledger)
            ledger.end("done")
        except (Exception, Interrupted) as error:
            signals.stopping = True
            return self._stop(ledger, stage, error, signals)
        self._finish(ledger, "done")
        return 0

    def _stop(self, ledger: Ledger, stage: Stage, error: Exception | Interrupted, signals: Watch) -> int:
        """Note why a run stops, say how it goes on, and return the exit code; an OSError of its folder is raised."""
        asks = getattr(error, "asks", None)
        notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
        if signals.number is not None:
            stop = Interrupted(signals.number)
            return self._end(ledger, stage, "interrupted", stop.code, f"{stop}{notes}", "to continue")
        if isinstance(error, PipelineError):
            return self._end(ledger, stage, "failed", 1, f"{error}{notes}", "when that is mended")
        if asks is not None:
            if not asks:
                return self._end(ledger, stage, "paused", 3, str(error), "to continue")
            path = ledger.folder / "documents" / "asks.json"
            write_json(path, asks)
            return self._end(ledger, stage, "paused", 3, f"{error} (what to execute: {path})", "when that is done")
        if isinstance(error, OSError) and (error.errno in NO_ROOM or _file_within(ledger.folder, error)):
            raise error
        log.error("%s failed", stage.name, exc_info=error)
        message = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(": ") + notes
        message += f" (traceback: {ledger.folder / 'log.txt'})"
        return self._end(ledger, stage, "failed", 1, message, "when that is mended")

    def _process_stage(self, stage: Stage, ledger: Ledger, signals: Watch) -> None:
        read = [(each.name, table.name) for each in self.stages for table in each.writes if table.name in stage.reads]
        inputs = {table: ledger.records[name]["tables"][table]["sha256"] for name, table in read}
        ingredients = gather(self.study, stage, inputs)
        step = self._decide(stage, ingredients, ledger)
        if step.source is None:
            wait = Step(stage, "wait", "another run is making it")
            fingerprint = ingredients.fingerprint
            with make_exclusively(self.outputs, fingerprint, signals.check, lambda: self._print_step(wait)):
                step = self._decide(stage, ingredients, ledger)  # another run may have made it meanwhile
                if step.source is None:
                    self._run_stage(stage, ledger, ingredients, step.reason, signals)
                    return
        if step.source.folder != ledger.folder:
            record = step.source.records[stage.name]
            try:
                for file in files_of(record):
                    link(step.source.folder / file, ledger.folder / file)
            except FileNotFoundError:
                if (step.source.folder / FILE_NAME).exists():
                    raise
                self._process_stage(stage, ledger, signals)  # that run was removed meanwhile
                return
            ledger.records[stage.name] = record
            ledger.save()
        self._print_step(step)
        log.info("%s: %s, %s", stage.name, step.action, step.reason)

    def _plan(self) -> list[Step]:
        if self.study.has_interface:
            self.study.build(self.study.settings.interface)
            self._check_interface()
        return make_plan(self.study, self.stages, list_ledgers(self.outputs))

    def _check_interface(self) -> None:
        """Refuse an interface where no device of the workflow can be connected to it."""
        devices = [self.study.slice(each)[name] for each in self.stages if (name := self.study.target(each))]
        if not any(hasattr(find_target(each["_target_"]), "connect_interface") for each in devices):
            name = self.study.settings.interface
            raise ConfigError(
                f"{name}: expected null, as workflow {self.study.settings.workflow.name} has no device that can be "
                f"connected to it; leave {name}= out"
            )

    def _decide(self, stage: Stage, ingredients: Ingredients, ledger: Ledger) -> Step:
        """Say whether a stage must run now that its inputs are there; one asked for by name runs once."""
        if stage.name in (self.study.settings.stages or []):
            step = decide(stage, ingredients, [ledger])
            return step if step.source else Step(stage, "run", "asked for by name")
        others = [each for each in list_ledgers(self.outputs) if each.folder != ledger.folder]
        return decide(stage, ingredients, [ledger, *others])

    def _conclude(self, ledger: Ledger) -> None:
        """Note what is to be noted once every stage is done."""

    def _run_stage(self, stage: Stage, ledger: Ledger, ingredients: Ingredients, reason: str, signals: Watch) -> None:
        record: dict[str, Any] = {
            "status": "running",
            "fingerprint": ingredients.fingerprint,
            "parts": ingredients.parts_fingerprint,
            "origin": ledger.name,
            "reason": reason,
            "started": now(),
            "config": ingredients.config,
            "inputs": ingredients.inputs,
            "code": ingredients.code,
            "libraries": ingredients.libraries,
            "measured": ingredients.measured,
            "tables": {},
            "files": {},
        }
        self._take_over_parts(stage, ledger, ingredients)
        ledger.records[stage.name] = record
        ledger.save()
        log.info("%s: run, %s", stage.name, reason)
        start = time.monotonic()
        context = self._context(stage, ledger, ingredients, signals)
        tables = ledger.folder / "tables"
        written = list_tables(self.stages)
        frames = {name: written[name].read(tables / f"{name}.parquet") for name in stage.reads}
        with self._show_work(stage, context):
            made = stage.function(cfg=self.study.config(stage), ctx=context, **frames)
            context.finish()
        made = (made,) if isinstance(made, pd.DataFrame) else made
        names = [table.name for table in stage.writes]
        results = made if isinstance(made, dict) else dict(zip(names, made, strict=True))
        for table in stage.writes:
            path = tables / f"{table.name}.parquet"
            table.write(results[table.name], path)
            record["tables"][table.name] = {**measure_file(path), "low": table.lows}
        seconds = time.monotonic() - start
        record.update(status="done", files=context.files, ended=now(), seconds=round(seconds, 3))
        ledger.save()
        log.info("%s: done in %.1f s", stage.name, seconds)
        self._print_step(Step(stage, "ran", f"{seconds:.1f} s  [dim]({reason})[/dim]"))

    @contextmanager
    def _show_work(self, stage: Stage, context: Context) -> Iterator[None]:
        """Say on a terminal what a stage does, and of one without a device how long it has worked and took before."""
        if not self.console.is_terminal:
            yield
            return
        told = f"  [dim]{stage.name}  {stage.summary}[/dim]"
        self.console.print(told, highlight=False, overflow="ellipsis", no_wrap=True)
        if context.device is not None:
            yield
            return
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        records = (found for each in list_ledgers(self.outputs) if (found := each.finished(stage.name)))
        took_s = next((each["seconds"] for each in records if "seconds" in each), None)
        before = "" if took_s is None else f"of some {took_s:.0f} s, as last time"
        columns = (TextColumn(" "), SpinnerColumn(), TimeElapsedColumn(), TextColumn(before))
        with Progress(*columns, console=self.console, transient=True) as shown:
            shown.add_task(stage.name, total=None)
            yield

    def _context(self, stage: Stage, ledger: Ledger, ingredients: Ingredients, signals: Watch) -> Context:
        values = ingredients.config
        own = values.get(stage.name)
        seed = own["seed"] if isinstance(own, dict) and "seed" in own else values.get("seed")
        parts = parts_folder(ledger, stage, ingredients.parts_fingerprint)
        record = Record(parts, {table.name: table for table in stage.writes}, signals.check)
        section = self.study.target(stage)
        device: Any = self.study.build(section) if section else None
        interactive = device is not None and self.study.has_interface
        if interactive:
            device.connect_interface(self._connection)
        return Context(
            stage.name,
            ledger.folder,
            seed,
            record,
            self.console,
            device,
            interactive,
            self._pool,
            self.study.settings.figures,
            stage.stream,
        )

    def _clear_parts(self, ledger: Ledger) -> None:
        """Remove the parts of loops, but for those of measured ones that may be lengthened."""
        kept = {
            parts_folder(ledger, each, record["parts"])
            for each in self.stages
            if each.extent and (record := ledger.records.get(each.name, {})).get("measured") and "parts" in record
        }
        for folder in {*(ledger.folder / "parts").glob("*")} - kept:
            shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):
            (ledger.folder / "parts").rmdir()

    def _take_over_parts(self, stage: Stage, ledger: Ledger, ingredients: Ingredients) -> None:
        """Take over the parts that another run left of the same loop, or this one under another fingerprint."""
        place = parts_folder(ledger, stage, ingredients.parts_fingerprint)
        anew = stage.name in (self.study.settings.stages or [])
        ledgers = [] if place.exists() else [ledger, *list_ledgers(self.outputs)]
        if found := find_parts(stage, ingredients, ledgers, anew):
            left, folder = found
            link_folder(folder, place)
            log.info("%s: goes on with parts of %s", stage.name, left.name)

    def _finished_run(self, steps: Sequence[Step]) -> Ledger | None:
        if not all(step.action in ("fresh", "kept") for step in steps):
            return None
        found = [Ledger.read(self.place)] if self.place else list_ledgers(self.outputs)
        newest = next((each for each in found if each and each.facts["identity"] == self.study.identity), None)
        if newest is None or newest.status != "done":
            return None
        made = [(step.stage, newest.finished(step.stage.name)) for step in steps]
        fresh = all(
            record and decide(stage, gather(self.study, stage, record["inputs"]), [newest]).source
            for stage, record in made
        )
        return newest if fresh else None

    def _finish(self, ledger: Ledger, word: str) -> None:
        if not self.console.quiet:
            print_headline(ledger, self.study, self.stages, self.console)
        page = ledger.folder / PAGE_NAME
        try:
            if not (page.is_file() and page.read_bytes().rstrip().endswith(b"</html>")):
                write_report(ledger, self.study, self.stages)
        except OSError as error:
            complain(f"cannot write {page}: {error.strerror}; the tables are there; make it writable, then run again")
        self._say(f"{word}: {ledger.folder}")
        self._say(f"report: {page}")

    def _end(self, ledger: Ledger, stage: Stage, status: str, code: int, message: str, when: str) -> int:
        record = ledger.records.get(stage.name)
        if record and record["status"] == "running":
            record["status"] = status
        log.error("%s %s: %s", stage.name, status, message)
        ledger.end(status, {"stage": stage.name, "message": message})
        complain(f"{stage.name} {status}: {message}; {when}, type: {command_line(self.arguments)}")
        page = try_report(ledger, self.study, self.stages) if status != "interrupted" else None
        if page is not None:
            self._say(f"report: {page}")
        return code

    def _refuse(self, ledger: Ledger, error: OSError) -> int:
        where = _file_within(ledger.folder, error) or ledger.folder
        remedy = "make room" if error.errno in NO_ROOM else "make it writable or move it away"
        reason = f"cannot write to {where}: {os.strerror(error.errno or errno.EIO)}"
        complain(f"{reason}; what was finished is kept; {remedy}, then type: {command_line(self.arguments)}")
        at_work = [record for record in ledger.records.items() if record[1]["status"] == "running"]
        for _, record in at_work:
            record["status"] = "failed"
        with suppress(OSError):  # the reason is short, and may find room where a table did not
            ledger.end("failed", {"stage": at_work[-1][0] if at_work else "-", "message": reason})
        return 1

    def _print_step(self, step: Step) -> None:
        width = max(len(each.name) for each in self.stages)
        colour = {"fresh": "green", "kept": "green", "ran": "cyan", "run": "cyan", "wait": "yellow"}[step.action]
        line = f"  {step.stage.name:<{width}}  [{colour}]{step.action:<5}[/]  {step.reason}"
        self.console.print(line, soft_wrap=True, highlight=False)

    def _say(self, text: str) -> None:
        say(text, self.console)


def run_study(
    composed: DictConfig, arguments: list[str], given: Sequence[dict[str, str]], overrides: Sequence[str]
) -> int:
    """Validate a composed configuration, then plan or run it; return the exit code, as `Runner.run` does.

    Arguments and given files are as of `Runner`; the overrides are those by which a job of a sweep has its name.
    """
    study, stages = read_study(composed)
    sweep = study.settings.sweep
    place = sweeps_folder(study.settings.outputs) / sweep / name_job(overrides) if sweep else None
    runner = Runner(study, stages, arguments, open_console(), given, place)
    if study.settings.plan:
        runner.show_plan()
        return 0
    with following(runner.outputs, study.settings.tracking) as runner.follow:
        return runner.run()


def _read_metrics(ledger: Ledger, study: Study, stages: Sequence[Stage]) -> dict[str, dict[str, Any]]:
    """Return ``value`` (or None), ``title``, ``unit``, ``percent``, ``low`` of each metric whose table the run has."""
    contracts = list_tables(each for each in stages if ledger.finished(each.name))
    found = {}
    for name, metric in study.settings.workflow.metrics.items():
        if metric.table not in contracts:
            continue
        frame = read_frame(ledger.folder / "tables" / f"{metric.table}.parquet")
        for wanted, rules in ((True, metric.where), (False, metric.but)):
            for column, value in rules.items():
                frame = frame[frame[column].isin(value if isinstance(value, list) else [value]) == wanted]
        declared, low = contracts[metric.table].columns[metric.column], contracts[metric.table].lows.get(metric.column)
        said = {"title": metric.title or None, "percent": declared["percent"] or None, "low": low}
        found[name] = {
            "value": _reduce(frame[metric.column].dropna(), metric.by),
            "unit": declared["unit"],
            **{key: value for key, value in said.items() if value is not None},
        }
    return found


def _reduce(values: pd.Series, by: str) -> float | str | None:
    """Return one value of many, None where there is none that JSON can hold."""
    if values.empty:
        return None
    if by in ("first", "last") or not pd.api.types.is_numeric_dtype(values):
        found = values.iloc[-1 if by == "last" else 0]
    else:
        found = values.agg(by)
    if isinstance(found, str):
        return found
    return float(found) if math.isfinite(found) else None


def _file_within(folder: Path, error: OSError) -> Path | None:
    file = error.filename2 or error.filename
    if not isinstance(file, str | Path) or not Path(file).absolute().is_relative_to(folder.absolute()):
        return None
    return Path(file)


@contextmanager
def _log_file(folder: Path) -> Iterator[None]:
    handler = logging.FileHandler(folder / "log.txt", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.setLevel(logging.DEBUG)
    log.propagate = False
    log.addHandler(handler)
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(handler)
    warnings.simplefilter("default")
    logging.raiseExceptions = False
    try:
        yield
    finally:
        logging.captureWarnings(False)
        logging.getLogger("py.warnings").removeHandler(handler)
        log.removeHandler(handler)
        with suppress(OSError):
            handler.close()
