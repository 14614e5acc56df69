"""A Parquet artefact with a contract: columns, types, units, ranges and a key.

A frame flows in and a checked file flows out, or the other way round. The contract is declared once, at the top of the
stage that writes the table, and is checked on every write and every read. A file carries the digest of its own bytes,
so that no damage to it goes unnoticed: Parquet itself has no checksum for its footer.
"""

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, TypedDict

import pandas as pd
import pyarrow
import pyarrow.parquet

from pipeline.errors import TableError
from pipeline.files import hash_file, write_atomically
from pipeline.printing import SHOWN, format_chance, show_percent

TEXT = pd.Series(["a"]).dtype
"""What pandas takes for text."""

SEAL = b"SHA-256 of this file with these digits zero: "
NO_DIGITS = b"0" * 64

LONGEST_VALUE = 80
"""Characters of a value in a message."""


class Column(TypedDict):
    """What a table says of one of its columns, in the words of `column`: plain, so that anything may declare one."""

    dtype: type
    description: str
    unit: str
    low: float | None
    high: float | None
    among: list[Any] | None
    nullable: bool
    optional: bool
    percent: bool


def column(
    dtype: type,
    description: str,
    *,
    unit: str = "1",
    low: float | None = None,
    high: float | None = None,
    among: Collection[Any] | None = None,
    nullable: bool = False,
    optional: bool = False,
    percent: bool = False,
) -> Column:
    """Declare one column of a table: of int, float, str or bool, with one line for the report and the Parquet file.

    The unit is ``"1"`` for ratios, counts and names. Values lie in the closed range from `low` to `high`, or `among`
    the only ones allowed; they may be missing where the column is `nullable`. An `optional` column may be absent as a
    whole. A ratio in `percent` is kept as it is and shown in per cent.
    """
    return {
        "dtype": dtype,
        "description": description,
        "unit": unit,
        "low": low,
        "high": high,
        "among": None if among is None else list(among),
        "nullable": nullable,
        "optional": optional,
        "percent": percent,
    }


@dataclass(frozen=True)
class Table:
    """The contract of one table: the name of its file and of the parameter by which stages read it, what a row is.

    The columns are in the order of the file. The values of the `key` columns together name a row once, where there are
    such columns. Of a headline table the `brief` columns are shown, or all where there are none; of its rows those that
    have the value of the `main` column, if one does, and of those in which the `minor` column is below a limit only how
    many there are. A table of sentences, in one column, has a role: it
    tells what was found, what to do next, or what to bear in mind.
    """

    name: str
    title: str
    columns: Mapping[str, Column]
    key: tuple[str, ...] = ()
    brief: tuple[str, ...] = ()
    main: tuple[str, str] | None = None
    minor: tuple[str, float] | None = None
    role: Literal["data", "finding", "advice", "remark"] = "data"

    @cached_property
    def schema(self) -> Any:
        """The pandera schema that `check` applies to what does not surely keep the contract."""
        import pandera.pandas as pa

        def declare(each: Column) -> pa.Column:
            limits = ((pa.Check.ge, each["low"]), (pa.Check.le, each["high"]), (pa.Check.isin, each["among"]))
            checks = [check(limit) for check, limit in limits if limit is not None]
            return pa.Column(each["dtype"], checks, nullable=each["nullable"], required=not each["optional"])

        return pa.DataFrameSchema(
            {name: declare(each) for name, each in self.columns.items()}, strict=True, ordered=True
        )

    @property
    def lows(self) -> dict[str, float]:
        """The least value that columns can have, where they have one, in the unit in which `show` shows them."""
        lows = {name: each["low"] for name, each in self.columns.items() if each["low"] is not None}
        return {name: 100.0 * low if self.columns[name]["percent"] else low for name, low in lows.items()}

    @cached_property
    def empty(self) -> bytes:
        """The file that holds no row."""
        return self.encode(pd.DataFrame(columns=[name for name, each in self.columns.items() if not each["optional"]]))

    def check(self, frame: pd.DataFrame, where: str) -> pd.DataFrame:
        """Return `frame` if it keeps the contract.

        A TableError names `where` it was found (file or stage), the column, what was expected and the first offending
        rows.
        """
        names = [str(name) for name in frame.columns]
        missing = [name for name, each in self.columns.items() if not each["optional"] and name not in frame.columns]
        surplus = [str(name) for name in frame.columns if name not in self.columns]
        repeated = sorted({name for name in names if names.count(name) > 1} - set(surplus))
        parts = [
            f"{problem} {', '.join(found)}"
            for problem, found in (("lacks", missing), ("has unknown", surplus), ("repeats", repeated))
            if found
        ]
        present = {name: each for name, each in self.columns.items() if name in names}
        if not parts and names != list(present):
            parts = [f"has columns {', '.join(names)} in this order"]
        if parts:
            raise TableError(
                f"table {self.name} ({where}) {' and '.join(parts)}; expected columns {', '.join(self.columns)}"
            )
        frame = frame.reset_index(drop=True)
        checked = frame
        if frame.empty:
            checked = frame.astype({name: _dtype(each) for name, each in present.items()})
        elif not all(_obeys(frame[name], each) for name, each in present.items()):
            from pandera.errors import SchemaErrors  # slow to import, and most frames surely keep their contract

            try:
                checked = self.schema.validate(frame, lazy=True)
            except SchemaErrors as errors:
                raise TableError(f"table {self.name} ({where}): {_describe(errors.failure_cases)}") from None
        for name in [each for each, dtype in checked.dtypes.items() if dtype.kind == "O" and dtype != TEXT]:
            try:
                checked = checked.assign(**{str(name): checked[name].astype(TEXT)})
            except UnicodeEncodeError as error:
                raise TableError(f"table {self.name} ({where}): column {name}: expected text, got {error}") from None
        if self.key and checked.duplicated(list(self.key)).any():
            row = int(checked.duplicated(list(self.key)).to_numpy().argmax())
            values = ", ".join(f"{name} {_show(checked[name].iloc[row])}" for name in self.key)
            raise TableError(f"table {self.name} ({where}): row {row} repeats the key ({values})")
        return checked

    def select(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the columns of a frame that the contract has, in its order."""
        return frame[[name for name in self.columns if name in frame.columns]]

    def write(self, frame: pd.DataFrame, path: Path) -> None:
        """Check `frame` and write it to `path` atomically; when it is refused, `path` is as it was."""
        content = self.encode(frame)
        write_atomically(path, lambda temporary: temporary.write_bytes(content), final=True)

    def encode(self, frame: pd.DataFrame) -> bytes:
        """Check `frame` and return the file that holds it."""
        checked = self.check(frame, "on write")
        arrow = pyarrow.Table.from_pandas(checked, preserve_index=False)
        fields = []
        for field in arrow.schema:
            each = self.columns[field.name]
            shown = {SHOWN: "%"} if each["percent"] else {}
            fields.append(field.with_metadata({"unit": each["unit"], "description": each["description"], **shown}))
        metadata = {**(arrow.schema.metadata or {}), b"title": self.title.encode()}
        return _seal(arrow.cast(pyarrow.schema(fields, metadata=metadata)))

    def read(self, path: Path) -> pd.DataFrame:
        """Read `path` and check it."""
        return self.check(read_frame(path), str(path))

    def show(self, frame: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
        """Return a frame as it is to be read, and the units of its columns.

        Ratios are in per cent where that is declared, those from 0 to 1 as far as they can be told.
        """
        shown = [(name, each) for name, each in self.columns.items() if name in frame.columns]
        units = {name: "%" if each["percent"] else each["unit"] for name, each in shown}
        told = {
            name: frame[name].map(partial(format_chance, is_probability="probability" in name + each["description"]))
            for name, each in shown
            if each["dtype"] is float and (each["low"], each["high"], units[name]) == (0, 1, "1")
        }
        return show_percent(frame, units).assign(**told), units


TITLES = {"remark": "What to bear in mind", "finding": "What was found", "advice": "What to do next"}
"""Of what tables of sentences say, by their role, in the order in which a terminal shows it."""


def sentences(name: str, role: Literal["finding", "advice", "remark"]) -> Table:
    """Declare a table of sentences."""
    return Table(name, TITLES[role], {"sentence": column(str, "in words")}, role=role)


def read_frame(path: Path, sealed: bool = False) -> pd.DataFrame:
    """Read a Parquet file that may have no contract here, or is refused with a TableError.

    Damage is certain to be seen in what `Table.write` wrote; `sealed` says that it must be such a file.
    """
    try:
        content = path.read_bytes()
        problem = "" if _is_whole(content, sealed) else "its bytes are not those that were written"
        if not problem:
            frame: pd.DataFrame = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content)).read().to_pandas()
            return frame
    except PermissionError:
        raise TableError(f"{path} cannot be read (permission denied); let yourself read it and run again") from None
    except FileNotFoundError:
        raise TableError(f"{path} is absent; remove it and run again to have it remade") from None
    except Exception as error:  # whatever PyArrow makes of a foreign file's damaged footer: KeyError, TypeError, ...
        problem = _show(error)
    raise TableError(f"{path} is not a whole Parquet file ({problem}); remove it and run again to have it remade")


def _seal(arrow: pyarrow.Table) -> bytes:
    """Return a Parquet file that says its own digest."""
    stream = pyarrow.BufferOutputStream()
    with pyarrow.parquet.ParquetWriter(stream, arrow.schema, compression="zstd") as writer:
        writer.write_table(arrow)
        writer.add_key_value_metadata({b"seal": SEAL + NO_DIGITS})
    content = stream.getvalue().to_pybytes()
    before, seal, after = content.rpartition(SEAL)
    digits = hashlib.sha256(content).hexdigest().encode()
    return bytes(before + seal + digits + after[len(digits) :])


def _is_whole(content: bytes, sealed: bool) -> bool:
    """Return whether a file's bytes have the digest that they say, or say none and need not."""
    before, seal, after = content.rpartition(SEAL)
    digits, rest = after[: len(NO_DIGITS)], after[len(NO_DIGITS) :]
    if not seal:
        return not sealed
    return hashlib.sha256(before + seal + NO_DIGITS + rest).hexdigest().encode() == digits


def measure_file(path: Path) -> dict[str, Any]:
    """Return hash, row count and size of a table's file, as the ledger keeps them."""
    return {
        "sha256": hash_file(path),
        "rows": pyarrow.parquet.read_metadata(path).num_rows,
        "bytes": path.stat().st_size,
    }


def _dtype(declared: Column) -> Any:
    """Return what pandas calls the type of a column."""
    return TEXT if declared["dtype"] is str else declared["dtype"]


def _obeys(values: pd.Series, declared: Column) -> bool:
    """Return whether a column surely keeps its declaration, sooner than pandera, which says how it does not."""
    present: Any = values.array
    missing = present.isna()
    if values.dtype != _dtype(declared) or (missing.any() and not declared["nullable"]):
        return False
    present = present[~missing] if missing.any() else present
    low, high, among = declared["low"], declared["high"], declared["among"]
    return bool(
        not len(present)
        or (
            (low is None or present.min() >= low)
            and (high is None or present.max() <= high)
            and (among is None or set(present.unique()) <= {*among})
        )
    )


def _describe(failures: pd.DataFrame) -> str:
    first = failures.iloc[0]
    same = failures[(failures["column"] == first["column"]) & (failures["check"] == first["check"])]
    rows = [str(index) for index in same["index"].dropna().astype(int).head(3)]
    where = f" in row{'s' * (len(rows) > 1)} {', '.join(rows)}" if rows else ""
    more = f" and {len(same) - len(rows)} more" if rows and len(same) > len(rows) else ""
    check = "no missing value" if first["check"] == "not_nullable" else first["check"]
    return f"column {first['column']}: expected {check}, got {_show(first['failure_case'])}{where}{more}"


def _show(value: object) -> str:
    """Return a value in few characters of one line."""
    text = str(value)
    if not text.isprintable():
        text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
