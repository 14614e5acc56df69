"""A Parquet artefact with a contract: columns, types, units, ranges and a key.

A frame flows in and a checked file flows out, or the other way round. The contract is declared once, at the top of the
stage that writes the table, and is checked on every write and every read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import pandera.pandas as pa
import pyarrow
import pyarrow.parquet

from pipeline.errors import TableError
from pipeline.files import hash_file, write_atomically


def column(
    dtype: type,
    description: str,
    *,
    unit: str = "1",
    low: float | None = None,
    high: float | None = None,
    among: Iterable[Any] | None = None,
    nullable: bool = False,
) -> pa.Column:
    """Declare one column of a table.

    Parameters
    ----------
    dtype : type
        ``int``, ``float``, ``str`` or ``bool``.
    description : str
        One line for the report and the Parquet file.
    unit : str
        Unit of the values; ``"1"`` for ratios, counts and names.
    low, high : float, optional
        Closed range of the values.
    among : iterable, optional
        The only values allowed.
    nullable : bool
        Whether a value may be missing.
    """
    checks = []
    if low is not None:
        checks.append(pa.Check.ge(low))
    if high is not None:
        checks.append(pa.Check.le(high))
    if among is not None:
        checks.append(pa.Check.isin(list(among)))
    return pa.Column(dtype, checks, nullable=nullable, description=description, metadata={"unit": unit})


@dataclass(frozen=True)
class Table:
    """The contract of one table.

    Parameters
    ----------
    name : str
        Name of the file and of the parameter by which stages read it.
    title : str
        One line: what a row is.
    columns : mapping of str to pandera.Column
        In the order of the file.
    key : tuple of str
        Columns whose values together name a row once; empty for no such promise.
    brief : tuple of str
        Columns that terminal and report show first of a headline table; empty for all.
    """

    name: str
    title: str
    columns: Mapping[str, pa.Column]
    key: tuple[str, ...] = ()
    brief: tuple[str, ...] = ()

    @cached_property
    def schema(self) -> pa.DataFrameSchema:
        """The pandera schema that `check` applies."""
        return pa.DataFrameSchema(dict(self.columns), strict=True, ordered=True)

    def check(self, frame: pd.DataFrame, where: str) -> pd.DataFrame:
        """Return `frame` if it keeps the contract.

        Parameters
        ----------
        frame : DataFrame
            What is about to be written, or was just read.
        where : str
            File or stage, for the message.

        Raises
        ------
        TableError
            Naming the column, what was expected and the first offending rows.
        """
        missing = [name for name in self.columns if name not in frame.columns]
        surplus = [str(name) for name in frame.columns if name not in self.columns]
        if missing or surplus:
            parts = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has unknown {', '.join(surplus)}"] * bool(
                surplus
            )
            raise TableError(
                f"table {self.name} ({where}) {' and '.join(parts)}; expected columns {', '.join(self.columns)}"
            )
        schema = self.schema
        if frame.empty:
            schema = pa.DataFrameSchema(dict(self.columns), coerce=True)
        try:
            checked = schema.validate(frame, lazy=True)
        except pa.errors.SchemaErrors as errors:
            raise TableError(f"table {self.name} ({where}): {_describe(errors.failure_cases)}") from None
        if self.key and frame.duplicated(list(self.key)).any():
            row = int(frame.duplicated(list(self.key)).to_numpy().argmax())
            values = ", ".join(f"{name} {frame[name].iloc[row]}" for name in self.key)
            raise TableError(f"table {self.name} ({where}): row {row} repeats the key ({values})")
        return checked

    def write(self, frame: pd.DataFrame, path: Path) -> None:
        """Check `frame` and write it to `path` atomically.

        Raises
        ------
        TableError
            When the contract is not kept; nothing is written then.
        OSError
            When the disk refuses; `path` is as it was.
        """
        checked = self.check(frame.reset_index(drop=True), "on write")
        arrow = pyarrow.Table.from_pandas(checked, preserve_index=False)
        fields = [
            field.with_metadata(
                {"unit": _unit(self.columns[field.name]), "description": self.columns[field.name].description or ""}
            )
            for field in arrow.schema
        ]
        arrow = arrow.cast(
            pyarrow.schema(fields, metadata={**(arrow.schema.metadata or {}), b"title": self.title.encode()})
        )
        write_atomically(
            path, lambda temporary: pyarrow.parquet.write_table(arrow, temporary, compression="zstd"), final=True
        )

    def read(self, path: Path) -> pd.DataFrame:
        """Read `path` and check it.

        Raises
        ------
        TableError
            When the file is absent, truncated, not Parquet, or does not keep the contract.
        """
        return self.check(read_frame(path), str(path))

    def describe(self) -> list[tuple[str, str, str]]:
        """Return name, unit and description of each column."""
        return [(name, _unit(each), each.description or "") for name, each in self.columns.items()]


def read_frame(path: Path) -> pd.DataFrame:
    """Read a Parquet file that may have no contract here.

    Raises
    ------
    TableError
        When the file is absent, truncated or not Parquet.
    """
    try:
        frame: pd.DataFrame = pyarrow.parquet.read_table(path).to_pandas()
        return frame
    except (OSError, pyarrow.ArrowException) as error:
        problem = "is absent" if not path.exists() else f"is not a whole Parquet file ({str(error).splitlines()[0]})"
        raise TableError(f"{path} {problem}; remove it and run again to have it remade") from None


def measure_file(path: Path) -> dict[str, Any]:
    """Return hash, row count and size of a table's file, as the ledger keeps them."""
    return {
        "sha256": hash_file(path),
        "rows": pyarrow.parquet.read_metadata(path).num_rows,
        "bytes": path.stat().st_size,
    }


def _unit(each: pa.Column) -> str:
    return str((each.metadata or {}).get("unit", "1"))


def _describe(failures: pd.DataFrame) -> str:
    first = failures.iloc[0]
    same = failures[(failures["column"] == first["column"]) & (failures["check"] == first["check"])]
    rows = [str(index) for index in same["index"].dropna().astype(int).head(3)]
    where = f" in row{'s' * (len(rows) > 1)} {', '.join(rows)}" if rows else ""
    more = f" and {len(same) - len(rows)} more" if rows and len(same) > len(rows) else ""
    check = "no missing value" if first["check"] == "not_nullable" else first["check"]
    return f"column {first['column']}: expected {check}, got {first['failure_case']}{where}{more}"
