"""What an iteration of a long loop measures, on disk while it is being measured.

Rows flow in while it runs; where its part is not written, one Parquet file flows out that holds them and says why. Rows
are written beside the loop, so that no disk makes the loop wait; what was handed over half a second ago outlives a
killed process.
"""

import logging
import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow
import pyarrow.ipc
import pyarrow.parquet
from numpy.typing import NDArray

from pipeline.files import write_atomically

SUFFIX = ".arrows"
"""Of a journal that is being written: an Arrow stream, which can be read up to its last whole batch."""

REASON = "stopped_by"
"""Column that says why the part was not written."""

log = logging.getLogger("pamid")

Rows = Mapping[str, NDArray[Any]]


class Journal:
    """The rows of one iteration, in a stream with `SUFFIX`; nothing is written before the first rows."""

    def __init__(self, path: Path):
        self.path = path
        self._waiting: queue.SimpleQueue[Rows | None] = queue.SimpleQueue()
        self._writer: threading.Thread | None = None
        self._problem: Exception | None = None

    def __call__(self, rows: Rows) -> None:
        """Take rows, the same columns each time; a disk that refuses them stops nothing and is told in the log."""
        if self._writer is None:
            self._writer = threading.Thread(target=self._write, name="journal", daemon=True)
            self._writer.start()
        self._waiting.put(rows)

    def close(self) -> None:
        """Write what waits and let the file go."""
        if self._writer is not None:
            self._waiting.put(None)
            self._writer.join()
            self._writer = None
            if self._problem is not None:
                log.warning("%s: not all that was measured could be written (%s)", self.path, self._problem)

    def discard(self) -> None:
        """Remove the rows: the part holds them."""
        self.close()
        self.path.unlink(missing_ok=True)
        if self.path.parent.is_dir() and not any(self.path.parent.iterdir()):
            self.path.parent.rmdir()

    def _write(self) -> None:
        stream = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("wb", buffering=0) as file:
                while (rows := self._waiting.get()) is not None:
                    batch = pyarrow.RecordBatch.from_pydict(dict(rows))
                    stream = stream or pyarrow.ipc.new_stream(file, batch.schema)
                    stream.write_batch(batch)
                if stream is not None:
                    stream.close()
        except (OSError, pyarrow.ArrowException) as error:
            self._problem = error


def keep_interrupted(path: Path, reason: str) -> Path | None:
    """Make a Parquet file, beside it, of the journal of an iteration whose part was not written.

    The reason stands in the column `REASON`. None is returned where the journal holds nothing.
    """
    rows = read_journal(path) if path.exists() else pd.DataFrame()
    if rows.empty:
        path.unlink(missing_ok=True)
        return None
    taken = {each.name for each in path.parent.glob("*.parquet")}
    names = (f"{path.stem}~{count}.parquet" for count in range(1, len(taken) + 2))
    kept = path.with_name(next(name for name in names if name not in taken))
    table = pyarrow.Table.from_pandas(rows.assign(**{REASON: reason}), preserve_index=False)
    write_atomically(kept, lambda temporary: pyarrow.parquet.write_table(table, temporary), final=True)
    path.unlink()
    return kept


def read_journal(path: Path) -> pd.DataFrame:
    """Return the rows of a journal up to its last whole batch, as a process that was killed may have left it."""
    batches: list[pyarrow.RecordBatch] = []
    try:
        with path.open("rb") as file, pyarrow.ipc.open_stream(file) as stream:
            batches.extend(iter(stream.read_next_batch, None))
    except (StopIteration, OSError, EOFError, pyarrow.ArrowException):
        pass
    frame: pd.DataFrame = pyarrow.Table.from_batches(batches).to_pandas() if batches else pd.DataFrame()
    return frame
