"""What a stage is given beside its config and tables: generators, progress, the record of a long loop, figures, device.

A stage calls these and nothing else of the pipeline while it runs; whatever it leaves on disk goes through here.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from pipeline.errors import TableError, WiringError
from pipeline.files import hash_file, write_atomically, write_folder, write_json, write_text
from pipeline.forks import Fork, can_fork, divide
from pipeline.journal import SUFFIX as JOURNAL_SUFFIX
from pipeline.journal import Journal, keep_interrupted
from pipeline.table import Table, read_frame
from pipeline.terminal import open_console
from pipeline.workers import Job, Result, Workers

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

log = logging.getLogger("pamid")

UNDATED: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}
"""Metadata that would differ between two files of the same figure."""
DOTS_PER_INCH = 150


@dataclass
class Record:
    """The record of a long loop: one part per iteration, on disk as soon as it is over.

    It lies in a folder whose name holds the fingerprint of what made the parts, and has the tables that the stage
    writes. Between two iterations, `check` raises if the run is to stop.
    """

    folder: Path
    tables: Mapping[str, Table]
    check: Callable[[], None]
    keys: dict[str, None] = field(default_factory=dict)
    frames: dict[str, dict[str, pd.DataFrame]] = field(default_factory=dict)
    journals: dict[str, Journal] = field(default_factory=dict)

    def watch(self, key: tuple[object, ...]) -> Journal:
        """Return what takes the rows of an iteration while it runs.

        They are kept, with the reason, as ``interrupted/STAGE~PART~1.parquet`` in the run's folder if the part is not
        written, and removed when it is.
        """
        name = self.name(key)
        return self.journals.setdefault(name, Journal(self._journal_path(name)))

    def part(self, key: tuple[object, ...], make: Callable[[], Mapping[str, pd.DataFrame]]) -> dict[str, pd.DataFrame]:
        """Return the tables of one part of the loop: read if an earlier process wrote them, else made and written.

        What `make` returned, a frame for each table that has rows, is read back from disk in either case, so that a
        resumed loop sees what an unbroken one saw.
        """
        name = self.name(key)
        place = self.folder / name
        if place.is_dir():
            self.keys[name] = None
            return self._read(name)
        self.check()
        self._keep_interrupted(name, "the process ended")
        try:
            frames = make()
        except BaseException as error:
            kept = self._keep_interrupted(name, str(error).split("\n")[0] or type(error).__name__)
            if kept is not None:
                error.add_note(f"what was measured until then: {kept}")
            raise
        if not frames or set(frames) - set(self.tables):
            raise TableError(f"a part may have tables {', '.join(self.tables)}; got {', '.join(frames)}")
        contents = {}
        for table in self.tables.values():
            rows = frames.get(table.name)
            contents[f"{table.name}.parquet"] = table.empty if rows is None else table.encode(rows)
        write_folder(place, contents)  # which a worker of an earlier process may have written too
        if name in self.journals:
            self.journals.pop(name).discard()
        self.keys[name] = None
        return self._read(name)

    @staticmethod
    def name(key: tuple[object, ...]) -> str:
        """Return a part's name."""
        return "~".join(str(each) for each in key)

    def holds(self, key: tuple[object, ...]) -> bool:
        """Return whether a part is on disk."""
        return (self.folder / self.name(key)).is_dir()

    def collect(self) -> dict[str, pd.DataFrame]:
        """Return the whole tables: the parts in the order in which the loop asked for them."""
        parts = [self._read(name) for name in self.keys]
        return {name: pd.concat([part[name] for part in parts], ignore_index=True) for name in self.tables}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "check": _go_on, "keys": {}, "frames": {}, "journals": {}}

    def _journal_path(self, name: str) -> Path:
        stage = self.folder.name.rpartition("-")[0] or self.folder.name
        return self.folder.parent.parent / "interrupted" / f"{stage}~{name}{JOURNAL_SUFFIX}"

    def _keep_interrupted(self, name: str, reason: str) -> Path | None:
        """Keep the rows of a part that was not written, in this process or in an earlier one."""
        if name in self.journals:
            self.journals.pop(name).close()
        return keep_interrupted(self._journal_path(name), reason)

    def _read(self, key: str) -> dict[str, pd.DataFrame]:
        if key in self.frames:
            return self.frames[key]
        place = self.folder / key
        try:
            found = {name: read_frame(place / f"{name}.parquet", sealed=True) for name in self.tables}
        except TableError as error:
            told = str(error).split("; remove it")[0]
            raise TableError(f"{told}; remove the folder {place}, and this part of the loop is made again") from None
        return self.frames.setdefault(key, found)


@dataclass
class Context:
    """Given to every stage, by its name, as ``ctx``, with the run's folder and the record for long loops.

    The seed is None for a stage that declares none. The device is what the stage asked for through a ``_target_``
    section, else None; it is `interactive` where people follow it through an interface. Progress is drawn on the
    console if it is a terminal, loops are spread over the worker processes, and figures are kept in the formats
    (png, pdf, svg). A copy in another process draws the same random numbers and writes parts to the same record; it
    shows nothing.
    """

    stage: str
    folder: Path
    seed: int | None
    record: Record
    console: Console
    device: Any = None
    interactive: bool = False
    workers: Workers = field(default_factory=partial(Workers, 1))
    formats: Sequence[str] = ("png",)
    stream: str | None = None
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    drawings: list[tuple[list[Path], str, Callable[[], None], Fork | None]] = field(default_factory=list)

    def generator(self, *key: int | str) -> np.random.Generator:
        """Return a generator that depends on the root seed, the stage's stream and the key alone."""
        if self.stream is None:
            raise WiringError(f'stage {self.stage} draws random numbers: declare @stage(..., stream="{self.stage}")')
        if self.seed is None:
            raise WiringError(f"stage {self.stage} draws random numbers: its config must declare a seed")
        spawn_key = (_digest(self.stream), *(each if isinstance(each, int) else _digest(each) for each in key))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=spawn_key))

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[str], None]]:
        """Yield what takes a note at the end of each iteration of a loop, to show how far it is on a terminal."""
        done = count(1)

        def keep(note: str) -> None:
            log.debug("%s: %s %d of %d%s", self.stage, description, next(done), total, f": {note}" if note else "")

        if not self.console.is_terminal or self.interactive:
            yield keep
            return
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("  {task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.fields[note]}"),
        )
        with Progress(*columns, console=self.console, transient=True) as bar:
            task = bar.add_task(description, total=total, note="")

            def advance(note: str) -> None:
                bar.update(task, advance=1, note=note)
                keep(note)

            yield advance

    def spread(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """Yield ``function(job)`` for each job, in order, computed in other processes where there are workers.

        Function, jobs (this context may be part of them) and results can be pickled, and no job needs another's result.
        On a real device, and where people follow it, the jobs are done one after the other, here.
        """
        yield from (Workers(1) if self._is_alone else self.workers).spread(function, jobs, self.record.check)

    @property
    def _is_alone(self) -> bool:
        """Whether nothing may disturb a real device, or people who follow one."""
        return getattr(self.device, "real", False) or self.interactive

    def divide(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], kept: Iterable[object] = ()
    ) -> list[Result]:
        """Return ``function(job)`` for each job, in order, computed in copies of this process where there are workers.

        Nothing is pickled but the results, less the objects `kept` that they hold; for the rest it is as `spread`.
        """
        with self.progress("parts", len(jobs)) if len(jobs) > 1 else nullcontext(lambda note: None) as advance:
            begun = 0

            def begin(place: int) -> None:
                nonlocal begun
                self.record.check()
                while begun < place:  # forks take jobs in between
                    advance("")
                    begun += 1

            return divide(function, jobs, 1 if self._is_alone else self.workers.count, kept, begin)

    def gather(
        self, description: str, function: Callable[..., Iterable[Result]], jobs: Mapping[str, tuple[Any, ...]]
    ) -> list[Result]:
        """Return what ``function(*job)`` gives for each job, one after the other, spread as by `spread`.

        Each job is named by the note that is shown when it is done.
        """
        gathered: list[Result] = []
        with self.progress(description, len(jobs)) as advance:
            for note, found in zip(jobs, self.spread(partial(_call, function), list(jobs.values())), strict=True):
                gathered += found
                advance(note)
        return gathered

    def land(
        self, description: str, function: Callable[..., Iterable[str]], jobs: Mapping[str, tuple[Any, ...]]
    ) -> dict[str, pd.DataFrame]:
        """Return the whole tables of a loop: ``function(*job)`` writes parts of its record and returns their names."""
        self.record.keys.update(dict.fromkeys(self.gather(description, function, jobs)))
        return self.record.collect()

    def land_each(
        self, description: str, make: Callable[..., Mapping[str, pd.DataFrame]], jobs: Mapping[str, tuple[Any, ...]]
    ) -> dict[str, pd.DataFrame]:
        """Return the whole tables of a loop in which each job makes one part, ``make(*job)``, named by its note."""
        named = {note: (note, *job) for note, job in jobs.items()}
        return self.land(description, partial(_land, self.record, make), named)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "console": None, "workers": Workers(1), "drawings": []}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, console=open_console(quiet=True))

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Keep a matplotlib figure, with the caption that the report prints beside the PNG.

        It is drawn in a copy of this process while the stage goes on, where a worker is free; see `finish`.
        """
        paths = [self.folder / "figures" / f"{name}.{suffix}" for suffix in self.formats]
        draw = partial(_draw, figure, paths)
        self.files.update({path.relative_to(self.folder).as_posix(): {} for path in paths})  # in the order of calls
        at_work = sum(fork.is_at_work() for *_, fork in self.drawings if fork)
        free = not self._is_alone and can_fork() and at_work < self.workers.count > 1
        fork = Fork(draw) if free and paths else draw()
        self.drawings.append((paths, caption, draw, fork))

    def finish(self) -> None:
        """Wait for all figures, and note what they are."""
        for paths, caption, draw, fork in self.drawings:
            if fork:
                try:
                    fork.finish()
                except EOFError:
                    draw()
            for path in paths:
                self._note(path, kind="figure", caption=caption)
        self.drawings.clear()

    def document(
        self,
        name: str,
        mapping: Mapping[str, Any],
        form: Literal["json", "yaml"] = "json",
        comments: Sequence[str] = (),
    ) -> None:
        """Keep a mapping as ``documents/NAME.json``, or as YAML, which a configuration can be read from.

        YAML begins with the comments, such as the package that its keys belong to.
        """
        if form == "json":
            self._keep(f"documents/{name}.json", write_json, mapping)
        else:
            from omegaconf import OmegaConf

            text = OmegaConf.to_yaml(OmegaConf.create(dict(mapping)))
            self._keep(f"documents/{name}.yaml", write_text, "".join(f"# {line}\n" for line in comments) + text)

    def source(self, name: str, text: str) -> None:
        """Keep a Python file as ``documents/NAME.py``."""
        self._keep(f"documents/{name}.py", write_text, text)

    def verdict(self, mapping: Mapping[str, Any]) -> None:
        """Keep what a workflow came to as ``verdict.json``, beside the run's tables."""
        self._keep("verdict.json", write_json, mapping)

    def _keep(self, name: str, write: Callable[..., None], content: Any) -> None:
        write(self.folder / name, content, final=True)
        self._note(self.folder / name, kind="document")

    def _note(self, path: Path, **facts: str) -> None:
        name = path.relative_to(self.folder).as_posix()
        self.files[name] = {"sha256": hash_file(path), "bytes": path.stat().st_size, **facts}


def _draw(figure: Figure, paths: Sequence[Path]) -> None:
    from matplotlib.backend_bases import get_registered_canvas_class  # slow to import

    figure.set_dpi(DOTS_PER_INCH)
    layout = figure.get_layout_engine()
    if layout is not None and paths:
        layout.execute(figure)
        figure.set_layout_engine("none")  # every format has this layout
    for path in paths:
        suffix = path.suffix[1:]
        figure.set_dpi(DOTS_PER_INCH)  # which a format may have changed
        draw = getattr(get_registered_canvas_class(suffix)(figure), f"print_{suffix}")  # savefig draws twice
        write_atomically(path, partial(draw, metadata=UNDATED[suffix]), final=True)
    figure.clear()


def _call(function: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    return function(*job)


def _land(record: Record, make: Callable[..., Mapping[str, pd.DataFrame]], name: str, *job: Any) -> list[str]:
    record.part((name,), partial(make, *job))
    return [name]


def _digest(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")


def _go_on() -> None:
    """Stop nothing: the process that started this one stops it."""
