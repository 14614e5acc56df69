"""Writes files as other people's loggers, oscilloscopes and programs write them, with the truth of each.

Nothing here knows the reader that is tested. Each value of the truth is the number that its written text means.
"""

import argparse
import bz2
import dataclasses
import gzip
import io
import json
import lzma
import zipfile
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import savemat

SEPARATORS = {
    "comma": (",", ".", "csv txt dat"),
    "semi": (";", ".", "csv txt"),
    "semi_de": (";", ",", "csv asc"),
    "tab": ("\t", ".", "tsv txt dat"),
    "tab_de": ("\t", ",", "txt asc tsv"),
    "bar": ("|", ".", "txt csv"),
    "bar_de": ("|", ",", "txt dat"),
    "blank": (" ", ".", "txt dat asc"),
    "blank_de": (" ", ",", "dat txt"),
    "fixed": ("fixed", ".", "dat asc log"),
}
NO_BLANKS = ("comma", "semi", "semi_de", "tab", "tab_de", "bar", "bar_de")
NO_COMMA = NO_BLANKS[1:]
QUANTITIES = (  # English, German, symbol, unit, offset, amplitude, digits
    ("Force", "Kraft", "F", "kN", 0.0, 1.2, 4),
    ("Position", "Weg", "x", "mm", 0.0, 25.0, 3),
    ("Pressure", "Druck", "p1", "bar", 3.5, 2.0, 4),
    ("Supply", "Vordruck", "p2", "kPa", 600.0, 20.0, 2),
    ("Voltage", "Spannung", "U", "V", 0.0, 5.0, 5),
    ("Current", "Strom", "I", "mA", 4.0, 90.0, 2),
    ("Temp", "Temperatur", "T", "°C", 24.0, 6.0, 2),
    ("Torque", "Drehmoment", "M", "Nm", 0.0, 9.0, 4),
    ("Angle", "Winkel", "phi", "deg", 0.0, 60.0, 3),
    ("Speed", "Drehzahl", "n", "1/min", 1500.0, 200.0, 1),
    ("Flow", "Durchfluss", "Q", "l/min", 12.0, 5.0, 2),
    ("Acceleration", "Beschleunigung", "a", "m/s²", 0.0, 3.0, 5),
    ("Gap", "Spalt", "s", "µm", 80.0, 30.0, 1),
    ("Power", "Leistung", "P", "W", 40.0, 30.0, 2),
)
HEADINGS = (
    "{n}",
    "{n} ({u})",
    "{n} [{u}]",
    "{n} / {u}",
    "{n}_{u}",
    "{n} {u}",
    "{n}({u})",
    "{n}[{u}]",
    "{n} in {u}",
    "{n}/{u}",
    "{n} <{u}>",
    "{n}, {u}",
    "{n}-{u}",
    "{n} {{{u}}}",
)
FORMS = {  # as strftime writes it, with three digits for %f; the step in ms
    "iso": ("%Y-%m-%d %H:%M:%S.%f", 250),
    "isoT": ("%Y-%m-%dT%H:%M:%S.%f", 10),
    "isoZ": ("%Y-%m-%dT%H:%M:%SZ", 1000),
    "iso offset": ("%Y-%m-%dT%H:%M:%S.%f+02:00", 100),
    "iso seconds": ("%Y-%m-%d %H:%M:%S", 5000),
    "iso slash": ("%Y/%m/%d %H:%M:%S", 1000),
    "iso minute": ("%Y/%m/%d %H:%M", 60000),
    "iso comma": ("%Y-%m-%d %H:%M:%S,%f", 20),
    "german": ("%d.%m.%Y %H:%M:%S", 1000),
    "german comma": ("%d.%m.%Y %H:%M:%S,%f", 50),
    "german minute": ("%d.%m.%Y %H:%M", 600000),
    "AM PM": ("%-m/%-d/%Y %-I:%M:%S %p", 1000),
    "AM PM ms": ("%-m/%-d/%Y %-I:%M:%S.%f %p", 100),
    "day above 12": ("%d/%m/%Y %H:%M", 600000),
    "US dash": ("%m-%d-%Y %H:%M", 60000),
    "one day": ("%d/%m/%Y %H:%M:%S", 1000),
    "clock": ("%H:%M:%S", 1000),
    "clock ms": ("%H:%M:%S.%f", 20),
    "clock comma": ("%-H:%M:%S,%f", 100),
    "clock AM PM": ("%-I:%M:%S %p", 2000),
    "slash open": ("%d/%m/%Y %H:%M", 3600000),
    "short year": ("%d.%m.%y %H:%M:%S", 1000),
    "month name": ("%d-%b-%Y %H:%M:%S", 1000),
    "date only": ("%Y-%m-%d", 86400000),
    "minutes": ("%M:%S.%f", 500),
    "clock colon": ("%H:%M:%S:%f", 20),
    "clock midnight": ("%H:%M:%S", 60000),
}
MISSING = (
    "NaN",
    "nan",
    "NAN",
    "n/a",
    "N/A",
    "NA",
    "#N/A",
    "NULL",
    "null",
    "None",
    "---",
    "--",
    "-",
    "",
    "#DIV/0!",
    "#NV",
    "#WERT!",
    "#VALUE!",
    "#NUM!",
    "-nan(ind)",
    "1.#QNAN",
    "-1.#IND",
    "<NA>",
    "",
    "",
    "NaN",
)

LABVIEW = (
    "LabVIEW Measurement\t|Writer_Version\t2|Reader_Version\t2|Separator\tTab|Decimal_Separator\t.|Multi_Headings\tNo|"
    "X_Columns\tOne|Time_Pref\tRelative|Date\t2026/06/05|Time\t10:15:00.1234567890|***End_of_Header***\t|\t|"
    "Channels\t2\t\t|Samples\t80\t80\t|Date\t2026/06/05\t2026/06/05\t|Time\t10:15:00.123\t10:15:00.123\t|Y_Unit_Label\t"
    "Volts\tNewtons\t|X_Dimension\tTime\tTime\t|X0\t0.0000E+0\t0.0000E+0\t|Delta_X\t0.010000\t0.010000\t|"
    "***End_of_Header***\t\t\t|X_Value\tVoltage\tForce_0\tComment"
)
WORDS = ("the valve was opened and the pump ran", "until lunch", "then we changed the hoses.", "because of leaks") * 9
START = datetime(2026, 6, 5, 8, 30)
ABOUT = (  # preambles
    ("Device: DAQ-2000 v3.1", "Operator: Müller", "Date: 2026-06-05", "Start time: 10:15:00", "Comment:", ""),
    ("Prüfstand 3", "Datum: 05.06.2026 10:15", "Bearbeiter: J. Weiß", "Kanäle: 4", "Bemerkung: Versuch 12", ""),
    ("[Header]", "Version=1.02", "Serial=SN004711", "Gain=2.5", "[Data]"),
    ("# recorded by logger.py", "# host: bench-2", "# gain 2.0, offset 0.1", "#"),
    ("Test report 17", "", "Specimen A-3, length 120 mm, width 20 mm", "Remarks: second trial after a pause", ""),
)


@dataclass
class Truth:
    """What a file holds: the numbers by the file's own headings, and what is left out of the rows of data.

    For "either", `columns` are those of a sensible reading, and empty if that is open. A reader may give more columns:
    those whose name or meaning is open are left out. `dropped` counts lines from 1 and leaves out empty lines; `single`
    are single numbers of a .mat file; with `pandas`, bare pandas reads the file back, for a check of this truth.
    Until the file is written, `file` is its suffix and `data` its content.
    """

    file: str
    kind: str = ""
    must: str = ""
    columns: dict = field(default_factory=dict)
    dropped: list = field(default_factory=list)
    single: dict = field(default_factory=dict)
    pandas: dict = field(default_factory=dict)
    data: bytes = b""


@dataclass
class Column:
    """A column: texts with a decimal point (None is missing) and what they mean (None: text or open)."""

    name: str
    unit: str
    cells: list
    meant: np.ndarray | None
    number: bool = True
    form: str = ""


@dataclass
class Dialect:
    """How a program writes a table of text."""

    sep: str
    decimal: str
    suffix: str
    encoding: str = "utf-8"
    newline: str = "\n"
    quote: str = ""  # "", "text" or "all"
    missing: str = "NaN"
    pad: str = ""  # blanks after (or around) a separator
    packed: str = ""

    def cell(self, text, number):
        """The text of a cell."""
        if text is None:
            text = self.missing
        elif number:
            text = text.replace(".", self.decimal)
        marked = self.sep in text or self.quote == "all" or (self.quote == "text" and not number)
        return f'"{text}"' if marked else text

    def line(self, texts, numbers=()):
        """A line of cells."""
        numbers = numbers or [False] * len(texts)
        cells = [self.cell(text, number) for text, number in zip(texts, numbers, strict=False)]
        if self.sep == "fixed":
            return "".join(f" {cell:>15}" for cell in cells)
        return (self.pad[1:] + self.sep + self.pad[:1]).join(cells)


def dialect(rng, only=tuple(SEPARATORS), **changes):
    """A dialect, with one of the separators `only`."""
    only = (only,) if isinstance(only, str) else only
    sep, decimal, suffixes = SEPARATORS[only[rng.integers(len(only))]]
    made = Dialect(sep, decimal, rng.choice(suffixes.split()))
    made.encoding = ("utf-8", "utf-8", "utf-8-sig", "latin-1")[rng.integers(4)]
    made.newline = ("\n", "\r\n")[rng.integers(2)]
    return dataclasses.replace(made, **changes)


def numbers(name, unit, data, digits=0, form="f"):
    """A column of numbers, meaning what is written."""
    cells = [f"{value:.{digits}{form}}" for value in data]
    return Column(name, unit, cells, np.array(cells, dtype=float))


def shape(rng, rows):
    """A signal of about unit size: waves, steps, a walk or a decay, with noise."""
    t, kind = np.linspace(0, 1, rows), rng.integers(4)
    y = (
        lambda: np.sin(2 * np.pi * rng.uniform(1.5, 9) * t + rng.uniform(0, 6)),
        lambda: rng.uniform(-1, 1, 12)[np.minimum((t * 12).astype(int), 11)],
        lambda: np.cumsum(rng.normal(size=rows)) / np.sqrt(rows),
        lambda: np.exp(-3 * t) * np.cos(2 * np.pi * 7 * t),
    )[kind]()
    return y + 0.02 * rng.normal(size=rows)


def signals(rng, rows, count, language=0):
    """Columns of `count` different quantities, named in English (0), German (1) or by symbols (2)."""
    picked = [QUANTITIES[pick] for pick in rng.permutation(len(QUANTITIES))[:count]]
    return [numbers(one[language], one[3], one[4] + one[5] * shape(rng, rows), one[6]) for one in picked]


def warped(rng, rows, warp):
    """Multiples of the step, with what happens to clocks."""
    ticks = np.arange(rows)
    return {
        None: lambda: ticks,
        "jitter": lambda: ticks + rng.uniform(-0.2, 0.2, rows),
        "gap": lambda: ticks + 40 * (ticks >= rows // 3) + 500 * (ticks >= rows // 2),
        "missing rows": lambda: np.sort(rng.permutation(rows + rows // 10)[:rows]),
        "repeated stamps": lambda: ticks - (ticks % 25 == 24),
        "rounded": lambda: np.round(ticks / 3.0),
    }[warp]()


def clock_column(rng, clock, rows, language, warp):
    """The column of time, by the name of its kind; None for none."""
    ticks = warped(rng, rows, warp)
    if clock in FORMS:
        pattern, step = FORMS[clock]
        names = ("Uhrzeit", "Time") if "clock" in clock else ("Timestamp", "Date/Time", "Datum")
        start = {
            "US dash": datetime(2026, 5, 13, 8, 30),
            "clock AM PM": datetime(2026, 6, 5, 11, 58),
            "minutes": datetime(2026, 6, 5),
            "slash open": datetime(2026, 6, 2),
            "clock midnight": datetime(2026, 6, 5, 23, 40),
            "day above 12": datetime(2026, 6, 13, 8, 30),
        }.get(clock, START)
        offsets = np.rint(ticks * step).astype(int)
        moments = [start + timedelta(milliseconds=int(offset)) for offset in offsets]
        cells = [one.strftime(pattern.replace("%f", f"{one.microsecond // 1000:03d}")) for one in moments]
        values, form = (offsets - offsets[0]) / 1000, pattern.replace("%-", "%")
        return Column(names[rng.integers(len(names))], "", cells, values, number=False, form=form)
    name = (("Time", "time", "t"), ("Zeit", "Zeit", "t"), ("t", "t", "time"))[language][rng.integers(3)]
    exact = 2 if warp == "jitter" else 0
    return {
        "none": lambda: None,
        "ms": lambda: numbers(name, "ms", ticks * (1, 2, 5, 10)[rng.integers(4)], exact),
        "us": lambda: numbers(name, "µs", ticks * (50, 100, 1000)[rng.integers(3)]),
        "min": lambda: numbers(name, "min", ticks * (0.01, 0.05)[rng.integers(2)], 4),
        "epoch": lambda: numbers("epoch", "s", 1780646400 + ticks * 0.02, 2),
        "epoch ms": lambda: numbers("unix_ms", "ms", 1780646400123 + ticks * 20),
        "s": lambda: numbers(
            name,
            "s",
            ticks * (0.001, 0.002, 0.005, 0.01, 0.05, 0.1)[rng.integers(6)],
            6 if exact else (3, 4)[rng.integers(2)],
        ),
    }[clock]()


def render(
    columns,
    written,
    preamble=(),
    header="row",
    below=(),
    space=0,
    between=None,
    repeat=(),
    tail=(),
    broken=False,
    trailing="",
    empty=(),
    checked=True,
    end=True,
):
    """A text file of the columns.

    `preamble` stands above the names, `below` (rows of texts) and `space` empty lines under them; `header` is "row",
    "none" or the mark of a comment; `between` holds lines before a row, `repeat` the rows before which the head comes
    again, `empty` those before which an empty line stands; `tail` ends the file; `broken` cuts the last row; `trailing`
    "rows" or "all" lines end with a separator; `checked`: bare pandas can read it; `end`: the last line ends.
    """
    mark = "" if header in ("row", "none") else header
    extra = {"": ("", ""), "rows": ("", written.sep), "all": (written.sep, written.sep)}[trailing]
    head = [] if header == "none" else [mark + written.line([c.name for c in columns]) + extra[0]]
    head += [mark + written.line(list(texts)) + extra[0] for texts in below]
    lines = [(line, "above") for line in [*preamble, *head, *[""] * space]]
    kinds = [c.number for c in columns]
    for row, texts in enumerate(zip(*[c.cells for c in columns], strict=False)):
        lines += [("", "empty")] * (row in empty)
        lines += [(line, "drop") for line in (head if row in repeat else ())]
        lines += [(line, "drop") for line in (between or {}).get(row, ())]
        lines.append((written.line(texts, kinds) + extra[1], "data"))
    if broken:
        cut = lines.pop()[0]
        lines.append((cut[: cut.rindex(written.sep) - (1 if len(columns) > 2 else 0)], "drop"))
    lines += [(line, "drop" if line else "empty") for line in tail]
    text = written.newline.join(line for line, _ in lines) + written.newline * (end and not broken)
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(written.encoding, b"")
    data = {"": bytes, "gz": packed, "bz2": bz2.compress}[written.packed](mark + text.encode(written.encoding))
    names = [f"column_{i + 1}" if header == "none" else c.name.strip() for i, c in enumerate(columns)]
    stop = -1 if broken else None
    truth = {
        n: np.asarray(c.meant, float)[:stop] for n, c in zip(names, columns, strict=False) if c.meant is not None and n
    }
    how = {
        "sep": {"fixed": r"\s+", " ": r"\s+"}.get(written.sep, written.sep),
        "decimal": written.decimal,
        "encoding": written.encoding.replace("16-le", "16").replace("16-be", "16"),
        "na_values": [written.missing],
        "skiprows": [i for i, (_, role) in enumerate(lines) if role != "data"],
        "names": names,
        "dates": {n: c.form for n, c in zip(names, columns, strict=False) if c.form},
    }
    dropped = [i + 1 for i, (_, role) in enumerate(lines) if role == "drop"]
    return Truth(
        f"{written.suffix}.{written.packed}".strip("."),
        columns=truth,
        dropped=dropped,
        data=data,
        pandas=how if checked else {},
    )


def text(
    rng,
    written=None,
    clock="s",
    rows=None,
    count=None,
    style=None,
    units="",
    third=None,
    missing=None,
    warp=None,
    change=None,
    language=None,
    extra=(),
    **layout,
):
    """A usual table: a clock and some signals; `change(columns, rng)` makes it special, `layout` goes to render."""
    written = written or dialect(rng)
    rows = rows or int(rng.integers(40, 300))
    language = int(rng.integers(3)) if language is None else language
    first = clock_column(rng, clock, rows, language, warp)
    columns = ([first] if first else []) + signals(rng, rows, count or int(rng.integers(2, 5)), language)
    if extra:
        columns.append(Column(extra[0], "", list(rng.choice(extra[1:], rows)), None, number=False))
    if missing is not None:
        written.missing = missing
        for column in columns[bool(first) :]:
            for row in np.flatnonzero(rng.random(rows) < 0.06) if column.number else ():
                column.cells[row], column.meant[row] = None, np.nan
    if change:
        columns = change(columns, rng) or columns
    style = "{n}" if units else (style or HEADINGS[rng.integers(8)])
    for column in columns:
        column.name = style.format(n=column.name, u=column.unit) if column.unit and column.number else column.name
        if written.sep in (" ", "fixed"):
            column.name = column.name.replace(" / ", "/").replace(" ", "_")
    below = [[units.format(c.unit) if c.unit else "-" for c in columns]] if units else []
    below += [[third.format(i) for i in range(len(columns))]] if third else []
    layout.setdefault("below", below)
    layout = {key: made(columns, written, rng) if callable(made) else made for key, made in layout.items()}
    return render(columns, written, **layout)


def statistics(columns, written, rng):
    """Rows of statistics below the table."""
    lines = [] if rng.integers(2) else [""]
    titles = (("Mean", "Min", "Max"), ("Mittelwert", "Minimum", "Maximum"))[rng.integers(2)]
    for title, take in zip(titles, (np.nanmean, np.nanmin, np.nanmax), strict=False):
        texts = [f"{take(c.meant):.4f}" if c.meant is not None else "x" for c in columns[1:]]
        lines.append(written.line([title, *texts], [False, *[True] * len(texts)]))
    return lines


def between(columns, written, rng):
    """Text between the rows."""
    said = ("WARN sensor timeout", "--- marker ---", "# event 3")
    return {int(row): [said[rng.integers(3)]] for row in rng.permutation(np.arange(2, len(columns[0].cells) - 1))[:3]}


def reform(write, keep=1, mark="E"):
    """Signals whose cells are written anew by `write(value, cell, unit)`; `mark` stands for the E of exponents."""

    def change(columns, rng):
        for c in columns[keep:]:
            c.cells = [write(value, cell, c.unit) for value, cell in zip(c.meant, c.cells, strict=False)]
            if "E" in c.cells[0]:
                c.meant, c.cells = np.array(c.cells, dtype=float), [cell.replace("E", mark) for cell in c.cells]

    return change


def thousand(group, point):
    """Large signals with marks between thousands."""

    def change(columns, rng):
        for c in columns[1:]:
            scaled = [f"{v:,.2f}" for v in 40000 * shape(rng, len(c.cells))]
            c.meant, c.number = np.array([float(cell.replace(",", "")) for cell in scaled]), False
            c.cells = [cell.translate({ord(","): group, ord("."): point}) for cell in scaled]

    return change


def special(kind):
    """A change of a table: records in it, other columns, parts or clocks side by side."""

    def change(columns, rng):
        rows, t = len(columns[0].cells), np.arange(len(columns[0].cells)) * 0.01
        if kind in ("run", "sample", "set", "restart"):
            label = np.sort(np.concatenate([np.repeat([0, 1, 2], 6), rng.integers(0, 3, rows - 18)]))
            columns[0] = numbers(columns[0].name, "s", t - np.searchsorted(label, label) * 0.01, 2)
            if kind == "run":
                columns.insert(0, numbers(("run", "record", "Versuch")[rng.integers(3)], "", label + 1))
            elif kind != "restart":
                names = ("A1", "A2", "B1") if kind == "sample" else ("est", "val", "val")
                columns.append(Column(kind, "", [names[i] for i in label], None, number=False))
        elif kind == "constant":
            columns += [numbers("Supply2", "V", np.full(rows, 24.0), 2), numbers("spare", "", np.zeros(rows))]
        elif kind == "index":
            columns.insert(0, numbers("", "", np.arange(rows)))
        elif kind == "fractions":  # as Python's str() writes dates: none at whole seconds
            columns[0].cells = [(cell + "000").removesuffix(".000000") for cell in columns[0].cells]
            columns[0].form = "ISO8601"
        elif kind in ("beside", "clocks"):
            columns = [numbers(name, "", shape(rng, rows), 4) for name in ("uEst", "yEst", "uVal", "yVal")]
            if kind == "clocks":
                columns[0], columns[2] = numbers("t_fast", "", t, 2), numbers("t_slow", "", 2 * t, 2)
            for c in columns[2:]:
                c.cells[rows // 2 :], c.meant[rows // 2 :] = [None] * (rows - rows // 2), np.nan
        elif kind == "whole":
            columns[1:] = [numbers(f"adc{i}", "", 2048 + 900 * shape(rng, rows)) for i in range(3)]
        return columns

    return change


def parquet_file(rng, kind):
    """A .parquet file of one kind."""
    rows = int(rng.integers(60, 400))
    t, u, y, n = np.arange(rows) * 0.01, shape(rng, rows), 20 * shape(rng, rows), np.arange(rows)
    when = pd.Timestamp("2026-06-05 10:00", tz="Europe/Berlin" if kind == "zone" else None)
    when = when + pd.to_timedelta(n * 10, unit="ms")
    holes, table = rng.random(rows) < 0.1, pd.DataFrame({"t": t, "u": u, "y": y})
    table = {
        "units": lambda: table.set_axis(["Time [s]", "Force (kN)", "x / mm"], axis=1),
        "record": lambda: table.assign(run=n * 3 // rows, t=table.groupby(n * 3 // rows).cumcount() * 0.01),
        "integers": lambda: pd.DataFrame(
            {
                "t_ms": n.astype("int32"),
                "adc": (u * 9000).astype("int16"),
                "raw": (y * 900 + 30000).clip(0, 65535).astype("uint16"),
                "n": n,
            }
        ),
        "float32": lambda: table.astype({"u": "float32", "y": "float32"}),
        "missing": lambda: table.assign(u=table["u"].mask(holes)),
        "nullable": lambda: table.assign(n=pd.Series(n, dtype="Int64").mask(holes)),
        "none": lambda: table[:0],
        "one": lambda: table[:1],
    }.get(kind, lambda: table)()
    columns = {name: table[name].to_numpy(dtype=float, na_value=np.nan) for name in table}
    if kind in ("datetime", "zone", "datetime index", "nameless index"):
        table["t"], columns["t"] = when, n * 10 / 1000
    added = {
        "words": ("note", np.where(n % 2, "up", "down")),
        "bool": ("valve", n % 20 < 9),
        "duration": ("t", when - when[0]),
        "lists": ("p", [[1.0, 2.0]] * len(table)),
        "date words": ("t", [str(one) for one in when]),
    }.get(kind)
    if added:
        table[added[0]] = added[1]
    if kind in ("nameless index", "duration", "date words"):
        columns.pop("t")
    if kind.endswith("index"):
        table = table.set_index("t").rename_axis(None if kind == "nameless index" else "t")
    return Truth("parquet", columns=columns, data=table.to_parquet(None, index=kind.endswith("index")))


def mat_file(rng, kind):
    """A .mat file of one kind."""
    rows = int(rng.integers(60, 400)) // 3 * 3
    t, u, y = np.arange(rows) * 0.01, shape(rng, rows), 20 * shape(rng, rows)
    base, short, third = {"t": t, "u": u, "y": y}, rows // 2, rows // 3
    small, single = base | {"u": (u * 9000).astype("int16"), "y": y.astype("float32")}, {"fs": 100.0, "mass": 1.25}
    parts = {"uEst": u, "yEst": y, "uVal": u[:short] + 1, "yVal": y[:short] - 1}
    cells, runs = np.array(["force", "x"], dtype=object), np.empty((1, 3), dtype=[("t", "O"), ("u", "O")])
    for i in range(3):
        runs[0, i] = (t[:third, None], u[third * i : third * (i + 1), None])
    nested = {"out": {"time": t, "signals": {"values": np.column_stack([u, y])}}}
    held, columns = {
        "struct": ({"data": base}, {f"data.{name}": v for name, v in base.items()}),
        "matrix": ({"M": np.column_stack([t, u, y])}, {"M_1": t, "M_2": u, "M_3": y}),
        "structs": ({"runs": runs}, {"runs.t": np.tile(t[:third], 3), "runs.u": u}),
        "single numbers": (base | single, base),
        "integers": (small, {n: v.astype(float) for n, v in small.items()}),
        "text beside": (base | {"info": "bench 3", "names": cells, "none": np.zeros((0, 0))}, base),
        "parts": (parts, parts),
        "complex": ({"f": t, "H": u + 1j * y}, {"f": t}),
        "nested": (nested, {"out.time": t}),
        "wide matrix": ({"M": np.stack([t, u, y])}, {}),
        "cube": ({"M": np.ones((rows, 2, 3)), "t": t}, {"t": t}),
        "logical": (base | {"on": u > 0}, base),
        "only text": ({"info": "nothing here", "c": cells}, {}),
        "only single": (single, {}),
    }.get(kind, (base, base))
    out = io.BytesIO()
    savemat(
        out,
        held,
        oned_as="row" if kind == "row vectors" else "column",
        format="4" if kind == "version 4" else "5",
        do_compression=kind == "compressed",
    )
    top = b"" if kind == "version 4" else b"MATLAB 5.0 MAT-file, Created on: Fri Jun  5 10:00:00 2026".ljust(116)
    return Truth(
        "mat", columns=dict(columns), single=single if "single n" in kind else {}, data=top + out.getvalue()[len(top) :]
    )


def raw(data, suffix="csv"):
    """A file of given lines or bytes."""
    return Truth(suffix, data="\n".join([*data, ""]).encode() if isinstance(data, (list, tuple)) else data)


def lines(write, top=(), suffix="csv", names=("t", "u", "y"), end="\n", encoding="utf-8"):
    """A maker of files whose lines `write(number, t, u, y)` writes; `names` are those of the three (None: open)."""

    def make(rng, i):
        t, u, y = np.arange(80) / 100, np.rint(1e4 * shape(rng, 80)) / 1e4, np.rint(3e4 + 9e3 * shape(rng, 80)) / 1e3
        made = [write(k, *values) for k, values in enumerate(zip(t, u, y, strict=False))]
        data = end.join([*(top.split("|") if isinstance(top, str) else top), *made, ""]).encode(encoding)
        return Truth(
            suffix, columns={name: values for name, values in zip(names, (t, u, y), strict=False) if name}, data=data
        )

    return make


def changed(made, change=bytes, suffix=None, without=()):
    """A file with other bytes or another suffix, and `without` some columns (None: all) in its truth."""
    keep = {} if without is None else {n: v for n, v in made.columns.items() if n not in without}
    return dataclasses.replace(made, data=change(made.data), file=suffix or made.file, columns=keep, pandas={})


def packed(data, ending="gz"):
    """Packed data that does not tell when."""
    out = io.BytesIO()
    if ending == "gz":
        return gzip.compress(data, mtime=0)
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(zipfile.ZipInfo("run.csv"), data)
    return out.getvalue()


def table(only=tuple(SEPARATORS), written=None, without=(), **options):
    """A maker of tables; lists in `only`, `written` (the dialect) and `options` are taken in turn."""

    def make(rng, i):
        dialect_of, how = (
            {key: held[i % len(held)] if isinstance(held, list) else held for key, held in given.items()}
            for given in ({"only": only} | (written or {}), options)
        )
        made = text(rng, dialect(rng, **dialect_of), **how)
        return changed(made, without=without) if without != () else made

    return make


READ = (  # kind, how many, maker of (rng, number)
    ("plain", 20, table(list(SEPARATORS))),
    (
        "encoding",
        10,
        table(NO_BLANKS, {"encoding": ["utf-8-sig", "latin-1", "utf-16-le", "utf-16-be", "cp1252"]}, style="{n} [{u}]"),
    ),
    ("line ends of old Macs", 2, table(NO_BLANKS, {"newline": "\r"})),
    ("quoted", 6, table(NO_BLANKS, {"quote": ["all", "text"]})),
    ("quoted decimal commas", 4, table("comma", {"decimal": ",", "suffix": "csv"})),
    ("separator in names", 3, table("comma", style="{n}, {u}")),
    ("preamble", 12, table(preamble=list(ABOUT))),
    (
        "padded preamble",
        3,
        table(
            NO_BLANKS,
            preamble=lambda c, w, r: [
                w.sep.join([*row, *[""] * (len(c) - 2)]) for row in (("Operator", "Smith"), ("Part", "A-17"), ("", ""))
            ],
        ),
    ),
    (
        "small table above",
        3,
        table(
            preamble=lambda c, w, r: [
                *(w.line(row, (False, True)) for row in (("Input", "Gain"), ("ai0", "1.25"), ("ai1", "0.85"))),
                "",
            ],
            count=3,
        ),
    ),
    ("rate above", 4, table(clock="none", preamble=[("fs: 100",), ("# fs: 250", "# x")], count=3)),
    ("sep line", 3, table(["semi", "semi_de", "comma"], {"suffix": "csv"}, preamble=lambda c, w, r: ["sep=" + w.sep])),
    ("row of units", 9, table(units=["{}", "[{}]", "({})"])),
    ("three rows of names", 6, table(units=["{}", "[{}]"], third=["AI{}", "Dev1/ai{}", "avg"])),
    ("names in a comment", 6, table(header=["# ", "#", "% ", "// ", "! ", "%"])),
    ("names in a comment", 1, table(("comma", "tab", "blank"), header="; ")),
    ("names and units in comments", 3, table(header="# ", units="{}")),
    ("units in headings", 14, table(NO_COMMA, style=list(HEADINGS))),
    ("no names", 7, table(header="none")),
    *[
        ("dates: " + form, 2 if k < 10 else 1, table(NO_COMMA if "," in FORMS[form][0] else NO_BLANKS, clock=form))
        for k, form in enumerate(list(FORMS)[:20])
    ],
    ("dates with few fractions", 2, table(NO_BLANKS, clock="iso", change=special("fractions"))),
    ("seconds of the epoch", 4, table(clock=["epoch", "epoch ms"])),
    ("clock in ms, us or min", 8, table(clock=["ms", "us", "min"])),
    *[
        (warp, 3, table(clock=["s", "ms"], warp=warp))
        for warp in ("gap", "jitter", "missing rows", "repeated stamps", "rounded")
    ],
    ("dates with gaps or repeats", 4, table(NO_BLANKS, clock=["german", "iso"], warp=["gap", "rounded"])),
    ("missing values", 22, table(NO_BLANKS, missing=list(MISSING))),
    ("missing values between blanks", 3, table(("blank", "fixed", "blank_de"), missing=["NaN", "---", "n/a"])),
    ("constant channels", 3, table(change=special("constant"))),
    ("column of words", 4, table(extra=("state", "idle", "run", "hold"))),
    ("sparse events", 3, table(NO_BLANKS, extra=("Event", *[""] * 20, "valve open"))),
    (
        "remarks with separators",
        2,
        table(["comma", "semi_de"], {"quote": "text"}, extra=("remark", "ok, or; so", "so, so; la")),
    ),
    ("switch", 2, table(extra=[("valve", "TRUE", "FALSE"), ("valve", "on", "off")])),
    ("names again", 4, table(repeat=(17, 31), units=["", "[{}]"])),
    ("broken last row", 6, table((*NO_BLANKS, "blank"), broken=True)),
    ("statistics", 5, table(NO_BLANKS, tail=statistics)),
    ("text between rows", 4, table(between=between)),
    ("end marker", 4, table(tail=[("End of measurement",), ("$RT_OFF$",), ("", "Messung beendet"), ("EOF",)])),
    ("empty lines", 4, table(space=[0, 1], empty=[(10, 20), (10, 20), range(1, 400), range(1, 400)], tail=("", ""))),
    ("no last line end", 2, table(end=False)),
    ("trailing separators", 4, table(NO_BLANKS, trailing=["rows", "all"])),
    ("units in cells", 5, table(NO_BLANKS, style="{n}", checked=False, change=reform(lambda v, c, u: f"{c} {u}"))),
    (
        "percent in cells",
        2,
        table(
            NO_BLANKS,
            style="{n}",
            checked=False,
            change=[reform(lambda v, c, u: c + "%"), reform(lambda v, c, u: c + " %")],
        ),
    ),
    ("exponents", 2, table(change=[reform(lambda v, c, u: f"{v:.6E}", mark=mark) for mark in "Ee"])),
    ("exponents with D", 3, table(checked=False, change=reform(lambda v, c, u: f"{v:.6E}", mark="D"))),
    ("plus signs", 2, table(change=reform(lambda v, c, u: c if c[0] == "-" else "+" + c))),
    (
        "bare points",
        2,
        table(NO_COMMA, change=reform(lambda v, c, u: c.replace("0.", ".", 1) if c.startswith(("0.", "-0.")) else c)),
    ),
    (
        "typographic minus",
        2,
        table(NO_BLANKS, {"encoding": "utf-8"}, checked=False, change=reform(lambda v, c, u: c.replace("-", "\u2212"))),
    ),
    (
        "thousands",
        6,
        table(
            ["comma", "semi_de", "semi_de", "semi", "tab_de", "semi_de"],
            {"encoding": "utf-8"},
            checked=False,
            change=[thousand(*marks) for marks in (",.", ".,", "\u00a0,", "'.", "\u202f,", " ,")],
        ),
    ),
    ("packed", 6, table(written={"packed": ["gz", "bz2"]})),
    ("other ending", 4, table(["comma", "tab", "blank", "bar"], {"suffix": ["tsv", "csv", "csv", "log"]})),
    ("capital ending", 2, table(NO_BLANKS, {"suffix": ["CSV", "TXT"]})),
    ("odd file name", 3, table()),
    ("column of runs", 5, table(change=special("run"))),
    ("runs told by words", 2, table(change=special("sample"))),
    ("parts told by words", 3, table(change=special("set"))),
    ("parts side by side", 2, table(NO_BLANKS, {"missing": ["", "NaN"]}, change=special("beside"))),
    ("two clocks", 2, table(NO_BLANKS, {"missing": ""}, change=special("clocks"))),
    ("many columns", 2, table(count=14)),
    ("one column", 2, table(("comma", "tab"), clock="none", count=1, style="{n} [{u}]")),
    ("index without a name", 3, table("comma", {"suffix": "csv"}, change=special("index"))),
    ("whole numbers", 3, table(change=special("whole"))),
    ("blanks around", 4, table(("comma", "semi_de", "bar"), {"pad": [" ", "  "]})),
    ("right aligned", 4, table("fixed", count=3)),
    ("few rows", 2, table(rows=8)),
    (
        "Tektronix",
        2,
        lines(
            lambda k, t, u, y: f"{t:.6E},{u:.5E},{y:.5E}",
            "Model,MSO24|Firmware,1.3||Waveform Type,ANALOG|Horizontal "
            "Units,s|Horizontal Scale,0.08|Sample Interval,0.01|Record Length,80|Zero Index,0||Labels,,|TIME,CH1,CH2",
            names=("TIME", "CH1", "CH2"),
        ),
    ),
    (
        "LeCroy",
        2,
        lines(
            lambda k, t, u, y: f"{t:.6E},{u:.5E}",
            "LECROYWS3024,56231,Waveform|Segments,1,SegmentSize,80|"
            "Segment,TrigTime,TimeSinceSegment1|#1,05-Jun-2026 10:00:00,0|Time,Ampl",
            names=("Time", "Ampl"),
        ),
    ),
    (
        "Keysight",
        2,
        lines(
            lambda k, t, u, y: f"{t:.6E},{u:+.5E},{y:+.5E}", "x-axis,1,2|second,Volt,Volt", names=("x-axis", "1", "2")
        ),
    ),
    (
        "Pico",
        2,
        lines(
            lambda k, t, u, y: f"{t:.8f},{u:.8f},{y:.8f}",
            "Time,Channel A,Channel B|(s),(V),(V)|",
            names=("Time", "Channel A", "Channel B"),
            end="\r\n",
        ),
    ),
    *[
        (
            "LabVIEW",
            2,
            lines(
                lambda k, t, u, y, point=point: (f"{t:.6f}\t{u:.6f}\t{y:.6f}" + "\t" * (point == ",")).replace(
                    ".", point
                ),
                LABVIEW.replace(".", point),
                "lvm",
                ("X_Value", "Voltage", "Force_0"),
                "\r\n",
            ),
        )
        for point in ".,"
    ],
    (
        "Campbell",
        2,
        lines(
            lambda k, t, u, y: f'"{START + timedelta(seconds=t):%Y-%m-%d %H:%M:%S.%f}",{k + 812},{u},{y}',
            '"TOA5","station","CR1000","12345","CR1000.Std.32","CPU:a.CR1","5678","Table1"|"TIMESTAMP","RECORD","Batt_V",'
            '"T_Avg"|"TS","RN","Volts","Deg C"|"","","Smp","Avg"',
            "dat",
            ("TIMESTAMP", "Batt_V", "T_Avg"),
            "\r\n",
        ),
    ),
    (
        "catman",
        2,
        lines(
            lambda k, t, u, y: f"{t:.3f}\t{u:.4f}\t{y:.3f}".replace(".", ","),
            "catman|Kanäle: 3|Messrate:\t100 Hz|T0: "
            "05.06.2026 10:15||Kanal\tAufnehmer\tBereich|MX840A CH1\tU9C\t±1 kN|MX840A CH2\tWA20\t20 mm||Zeit [s]"
            "\tKraft [kN]\tWeg [mm]",
            "asc",
            ("Zeit [s]", "Kraft [kN]", "Weg [mm]"),
            "\r\n",
            "latin-1",
        ),
    ),
    (
        "WinCC",
        2,
        lines(
            lambda k, t, u, y: (
                f'"p_Ist";"{START + timedelta(seconds=k):%d.%m.%Y %H:%M:%S}";' + f"{y};1".replace(".", ",")
            ),
            '"VarName";"TimeString";"VarValue";"Validity"',
            names=(None, None, "VarValue"),
            end="\r\n",
        ),
    ),
    (
        "Arduino",
        3,
        lines(
            lambda k, t, u, y: f"{1203 + 20 * k}\t{u}\t{y}",
            "Booting...|SD card ok|ets Jun  8 2016 00:22||rst:0x1 (POWERON_RESET)|millis\tvolt\ttemp",
            "log",
            (None, "volt", "temp"),
            "\r\n",
        ),
    ),
    (
        "rostopic",
        2,
        lines(
            lambda k, t, u, y: f"{1780646400000000000 + 10000000 * k},{u},{y}",
            "%time,field.x,field.y",
            names=(None, "field.x", "field.y"),
        ),
    ),
    ("many rows", 1, table("comma", rows=200_000, count=2)),
    *[
        ("parquet: " + kind, 1, lambda r, i, kind=kind: parquet_file(r, kind))
        for kind in (
            "plain",
            "units",
            "record",
            "integers",
            "float32",
            "missing",
            "nullable",
            "datetime",
            "zone",
            "t index",
            "datetime index",
            "words",
            "bool",
        )
    ],
    *[
        ("mat: " + kind, 1 + (k < 4), lambda r, i, kind=kind: mat_file(r, kind))
        for k, kind in enumerate(
            (
                "single numbers",
                "struct",
                "matrix",
                "structs",
                "row vectors",
                "version 4",
                "compressed",
                "integers",
                "text beside",
                "parts",
            )
        )
    ],
)
REFUSE = (
    ("empty", 3, lambda r, i: raw((b"", b"\n\r\n\n", b"\xef\xbb\xbf")[i], ("csv", "txt", "csv")[i])),
    (
        "head alone",
        6,
        table(
            rows=20,
            units=["", "[{}]"],
            preamble=[(), *ABOUT],
            change=lambda columns, rng: [Column(c.name, c.unit, [], None) for c in columns],
        ),
    ),
    ("preamble alone", 3, lambda r, i: raw([*ABOUT[i]], "txt")),
    ("rubbish", 6, lambda r, i: raw(r.bytes(3000), ("csv", "dat", "mat", "parquet", "txt", "csv.gz")[i])),
    ("zeros", 2, lambda r, i: raw(bytes(4096), ("csv", "log")[i])),
    ("picture", 1, lambda r, i: raw(b"\x89PNG\r\n\x1a\n" + r.bytes(900), "dat")),
    ("workbook named csv", 1, lambda r, i: raw(packed(r.bytes(2000), "zip"), "csv")),
    ("only words", 5, lambda r, i: raw(WORDS[i:], ("txt", "log", "csv", "dat", "asc")[i])),
    (
        "code, markup or settings",
        6,
        lambda r, i: raw(
            (
                b"import os\n\ndef main(path):\n    return os.stat(path)\n",
                b"<html>\n<body>404 Not Found</body>\n</html>\n",
                b"<?xml version='1.0'?>\n<run>\n  <note>none</note>\n</run>\n",
                b'{\n  "run": "A",\n  "ok": true\n}\n',
                b"[pump]\nname=main\nspeed=high\n[valve]\nmode=auto\n",
                b"key=value\nname=bench\n",
            )[i],
            ("txt", "csv")[i % 2],
        ),
    ),
    ("one sample", 5, table(rows=1, preamble=[(), *ABOUT])),
    ("unequal rows", 3, lines(lambda k, t, u, y: ";".join([f"{u}", f"{y}"] * (1 + (7 * k + k * k // 3) % 11)))),
    ("all missing", 2, lambda r, i: raw(["t;u;y"] + [("NaN;NaN;NaN", ";;")[i]] * 60)),
    ("parquet of no or one row", 3, lambda r, i: parquet_file(r, ("none", "one", "none")[i])),
    ("cut parquet", 1, lambda r, i: changed(parquet_file(r, "plain"), lambda b: b[: len(b) // 2])),
    ("cut mat", 1, lambda r, i: changed(mat_file(r, "matrix"), lambda b: b[: len(b) // 2])),
    ("mat without vectors", 2, lambda r, i: mat_file(r, ("only text", "only single")[i])),
    (
        "mat 7.3",
        1,
        lambda r, i: raw(
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124)
            + b"\x00\x02IM"
            + bytes(384)
            + b"\x89HDF\r\n\x1a\n"
            + r.bytes(2000),
            "mat",
        ),
    ),
    ("packed nothing", 1, lambda r, i: raw(packed(b""), "csv.gz")),
    ("comments alone", 1, lambda r, i: raw(["# " + line for line in WORDS], "dat")),
)
EITHER = (
    (
        "thousands or decimals",
        2,
        lines(lambda k, t, u, y: f"{t:.3f};{k % 9 + 1},{100 + k};{k % 7 + 1},{900 - k}", ["t;u;y"], names=("t",)),
    ),
    (
        "decimal commas between commas",
        2,
        lines(lambda k, t, u, y: f"{t},{u},{y}".replace(".", ","), ["t,u,y"], names=()),
    ),
    *[
        (
            "dates: " + form,
            2,
            table(
                NO_COMMA,
                clock=form,
                without=("Datum", "Timestamp", "Date/Time") if form in ("slash open", "minutes") else (),
            ),
        )
        for form in list(FORMS)[20:]
    ],
    ("time starts again", 3, table(change=special("restart"))),
    ("time runs back", 2, lines(lambda k, t, u, y: f"{9 - t:.2f};{u};{y}", ["t;u;y"], names=(None, "u", "y"))),
    ("other words for missing", 5, table(NO_BLANKS, missing=["?", "OL", "Bad Input", "*", "k.A."])),
    ("infinity, numbers for missing", 3, table(NO_BLANKS, without=None, missing=["inf", "-inf", "-9999"])),
    ("names twice", 2, lines(lambda k, t, u, y: f"{t};{u};{y}", ["t;y;y"], names=("t",))),
    ("numbers as names", 1, lines(lambda k, t, u, y: f"{t};{u};{y}", ["0;1;2"], names=("0", "1", "2"))),
    ("one column of decimal commas", 1, table("semi_de", without=None, clock="none", count=1)),
    ("prefixes in cells", 1, lines(lambda k, t, u, y: f"{t};" + (f"{u} V" if k % 2 else f"{u:.1e} mV"), names=())),
    ("hexadecimal", 1, lines(lambda k, t, u, y: f"{t};0x{k:04X};{y}", ["t;u;y"], names=())),
    ("arrows of a monitor", 1, lines(lambda k, t, u, y: f"10:00:{k % 60:02d}.120 -> {u},{y}", (), "log", names=())),
    ("names in cells", 1, lines(lambda k, t, u, y: f"t:{t},u:{u},y:{y}", suffix="txt")),
    ("lines of a log", 2, lines(lambda k, t, u, y: f"INFO t={t} force {u} N pressure {y} kPa", (), "log", ())),
    ("lines of JSON", 1, lines(lambda k, t, u, y: f'{{"t": {t}, "u": {u}, "y": {y}}}', suffix="txt")),
    ("Markdown", 1, lines(lambda k, t, u, y: f"| {t} | {u} | {y} |", ["| t | u | y |", "|--|--|--|"], suffix="txt")),
    ("preamble beside", 1, lines(lambda k, t, u, y: ("Length,2500" if k == 0 else ",") + f",,{t},{u},", names=())),
    (
        "start and step above",
        1,
        lines(lambda k, t, u, y: f"{k},{u},,", ["X,CH1,Start,Increment", "Sequence,Volt,-6.0e-3,1e-5"], names=()),
    ),
    (
        "segments of LabVIEW",
        2,
        lines(
            lambda k, t, u, y: (
                f"{t:.6f}\t{u:.6f}\t{y:.6f}"
                + ("\n\n" + LABVIEW.split("|\t|")[1].replace("|", "\n") if k in (30, 60) else "")
            ),
            LABVIEW,
            "lvm",
            (),
        ),
    ),
    ("utf-16, not told", 2, lambda r, i: changed(table(NO_BLANKS, {"encoding": "utf-16-le"})(r, i), lambda b: b[2:])),
    ("unknown ending", 1, table(NO_BLANKS, {"suffix": "xyz"})),
    ("packed, not told", 1, lambda r, i: changed(table(written={"packed": "gz"})(r, i), suffix="csv")),
    ("plain, told as packed", 1, lambda r, i: changed(text(r), suffix="csv.gz")),
    ("cut gz", 1, lambda r, i: changed(table(written={"packed": "gz"})(r, i), lambda b: b[:-40], without=None)),
    (
        "other packing",
        2,
        lambda r, i: changed(text(r), (lzma.compress, lambda b: packed(b, "zip"))[i], ("csv.xz", "csv.zip")[i]),
    ),
    ("text named otherwise", 2, lambda r, i: changed(text(r), suffix=("mat", "parquet")[i])),
    ("packed mat", 1, lambda r, i: changed(mat_file(r, "vectors"), packed, "mat.gz")),
    ("zeros at the end", 1, lambda r, i: changed(text(r), lambda b: b + bytes(512))),
    ("comments behind rows", 1, lines(lambda k, t, u, y: f"{t},{u},{y} # ok", ["t,u,y"])),
    ("heading too short", 1, lines(lambda k, t, u, y: f"{k + 1} {t} {u} {y}", ["t u y"], "txt")),
    ("channels in rows", 1, lambda r, i: raw([f"{n};" + ";".join(map(str, r.normal(size=50))) for n in "tuy"])),
    ("formulas", 1, lines(lambda k, t, u, y: f'="{t}";="{u}";="{y}"', ["t;u;y"])),
    *[
        ("parquet: " + kind, 1, lambda r, i, kind=kind: parquet_file(r, kind))
        for kind in ("lists", "duration", "date words", "nameless index")
    ],
    *[
        ("mat: " + kind, 1, lambda r, i, kind=kind: mat_file(r, kind))
        for kind in ("complex", "nested", "wide matrix", "cube", "logical")
    ],
)


def make_files(folder: Path, seed: int) -> list[Truth]:
    """Writes 500 files into the folder (a Path) and returns the list of their truths."""
    folder.mkdir(parents=True, exist_ok=True)
    plan = [
        (kind, must, i, make)
        for must, kinds in (("read", READ), ("refuse", REFUSE), ("either", EITHER))
        for kind, count, make in kinds
        for i in range(count)
    ]
    truths = []
    for number, (kind, must, i, make) in enumerate(plan):
        made = make(np.random.default_rng([seed, number]), i)
        slug = "".join(c if c.isalnum() else "_" for c in kind)
        name = f"{number:03d} Prüfstand (Kopie {i})" if kind == "odd file name" else f"{number:03d}_{slug}"
        (folder / f"{name}.{made.file}").write_bytes(made.data)
        made = Truth(made.file) if must == "refuse" else made
        truths.append(dataclasses.replace(made, file=f"{name}.{made.file}", kind=kind, must=must, data=b""))
    return truths


def write_truth(folder: Path, truths: list[Truth]) -> None:
    """Stores the truth as truth.json and truth.npz (arrays "number of file/number of column") in the folder."""
    listed = [{**vars(one), "columns": list(one.columns), "data": ""} for one in truths]
    (folder / "truth.json").write_text(json.dumps(listed, ensure_ascii=False), encoding="utf-8")
    np.savez_compressed(
        folder / "truth.npz",
        **{f"{i}/{k}": v for i, one in enumerate(truths) for k, v in enumerate(one.columns.values())},
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    write_truth(given.out, make_files(given.out, given.seed))
