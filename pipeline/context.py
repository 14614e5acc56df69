"""What a stage is given beside its config and tables: generators, progress, the record of a long loop, figures, rig.

A stage calls these and nothing else of the pipeline while it runs; whatever it leaves on disk goes through here.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pipeline.errors import TableError, WiringError
from pipeline.files import TEMPORARY_SUFFIX, hash_file, sync_folder, write_atomically, write_json
from pipeline.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

log = logging.getLogger("pamid")


@dataclass
class Record:
    """The record of a long loop: one part per turn, on disk as soon as the turn is over.

    Parameters
    ----------
    folder : Path
        Where the parts lie; its name holds the fingerprint of what made them.
    tables : mapping of str to Table
        Those that the stage writes.
    check : callable
        Raises between two turns if the run is to stop.
    """

    folder: Path
    tables: Mapping[str, Table]
    check: Callable[[], None]
    keys: list[str] = field(default_factory=list)

    def part(self, key: tuple[object, ...], make: Callable[[], Mapping[str, pd.DataFrame]]) -> dict[str, pd.DataFrame]:
        """Return the tables of one turn of the loop: read if an earlier process landed them, else made and landed.

        Parameters
        ----------
        key : tuple
            Names the turn.
        make : callable
            Returns a frame for each table that the stage writes.

        Returns
        -------
        dict of str to DataFrame
            Read back from disk in either case, so that a resumed loop sees what an unbroken one saw.
        """
        name = "~".join(str(each) for each in key)
        self.keys.append(name)
        place = self.folder / name
        if place.is_dir():
            return self._read(place)
        self.check()
        frames = make()
        if set(frames) != set(self.tables):
            raise TableError(f"a part needs tables {', '.join(self.tables)}; got {', '.join(frames)}")
        temporary = self.folder / f".{name}.{os.getpid()}{TEMPORARY_SUFFIX}"
        shutil.rmtree(temporary, ignore_errors=True)
        for table_name, frame in frames.items():
            self.tables[table_name].write(frame, temporary / f"{table_name}.parquet")
        temporary.rename(place)
        sync_folder(self.folder)
        return self._read(place)

    def collect(self) -> dict[str, pd.DataFrame]:
        """Return the whole tables: the parts in the order in which the loop asked for them."""
        parts = [self._read(self.folder / name) for name in self.keys]
        return {name: pd.concat([part[name] for part in parts], ignore_index=True) for name in self.tables}

    def has(self, *key: object) -> bool:
        """Tell whether a turn has landed."""
        return (self.folder / "~".join(str(each) for each in key)).is_dir()

    def _read(self, place: Path) -> dict[str, pd.DataFrame]:
        try:
            return {name: table.read(place / f"{name}.parquet") for name, table in self.tables.items()}
        except TableError as error:
            told = str(error).split("; remove it")[0]
            raise TableError(f"{told}; remove the folder {place}, and this turn of the loop is made again") from None


@dataclass
class Context:
    """Given to every stage as ``ctx``.

    Parameters
    ----------
    stage : str
        Name of the stage.
    folder : Path
        The run's folder.
    seed : int or None
        Root of the stage's generators; None for a stage that declares no seed.
    record : Record
        For long loops.
    console : Console
        Where progress is drawn, if it is a terminal.
    rig : object
        What the stage asked for through a ``_target_`` section, else None.
    """

    stage: str
    folder: Path
    seed: int | None
    record: Record
    console: Console
    rig: Any = None
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    def generator(self, *key: int | str) -> np.random.Generator:
        """Return a generator that depends on the root seed, the stage and the key alone.

        Raises
        ------
        WiringError
            When the stage's config declares no ``seed``.
        """
        if self.seed is None:
            raise WiringError(f"stage {self.stage} draws random numbers: its config must declare a seed")
        spawn_key = (_digest(self.stage), *(each if isinstance(each, int) else _digest(each) for each in key))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=spawn_key))

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[str], None]]:
        """Show how far a loop is; quiet when the output is piped.

        Yields
        ------
        callable
            Call it with a note at the end of each turn.
        """
        if not self.console.is_terminal:
            yield lambda note: log.debug("%s: %s", self.stage, note)
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
                log.debug("%s: %s", self.stage, note)

            yield advance

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Keep a matplotlib figure as PNG and PDF, with the caption that the report prints."""
        for suffix, metadata in ((".png", {"Software": None}), (".pdf", {"CreationDate": None, "Producer": None})):
            path = self.folder / "figures" / f"{name}{suffix}"
            write_atomically(path, partial(figure.savefig, dpi=150, metadata=metadata), final=True)
            self._note(path, kind="figure", caption=caption)
        figure.clear()

    def document(self, name: str, mapping: Mapping[str, Any]) -> None:
        """Keep a mapping as ``documents/NAME.json``."""
        path = self.folder / "documents" / f"{name}.json"
        write_json(path, mapping, final=True)
        self._note(path, kind="document")

    def _note(self, path: Path, **facts: str) -> None:
        name = path.relative_to(self.folder).as_posix()
        self.files[name] = {"sha256": hash_file(path), "bytes": path.stat().st_size, **facts}


def _digest(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
