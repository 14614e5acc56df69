"""Dates and times of day as loggers write them, told as seconds from the first.

Values of a column flow in; seconds flow out, or None where they are no dates. Which of two numbers is the day is told
by the sign between them, by a number above 12, or by AM and PM; where it matters and nothing tells, it is asked for.
"""

import pandas as pd

DAY_S = 86400.0
ISO = r"\d{4}-\d{2}-\d{2}"
CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2}(?:[.,]\d+)?))?(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
DAY = r"(?P<first>\d{1,2})(?P<sign>[./-])(?P<other>\d{1,2})(?P=sign)(?P<year>\d{4})"
YEAR_FIRST = r"(?P<before>\d{4})[./-](?P<month>\d{1,2})[./-](?P<day>\d{1,2})"
DATE = rf"^(?:{DAY}|{YEAR_FIRST})(?:,? +{CLOCK})?$"
TIME_OF_DAY = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?(?: ?[AaPp]\.?[Mm]\.?)?| ?[AaPp]\.?[Mm]\.?)"
"""Without AM or PM, two numbers alone may be minutes and seconds."""


def read_dates(values: pd.Series) -> pd.Series | None:
    """Return seconds from the first of dates, or of times of day; None where the values are neither.

    A `ValueError` tells that day and month may be either way round, and time would differ.
    """
    if values.dtype.kind in "mM":
        return _count(values)
    known = values.dropna()
    if values.dtype.kind in "fiub" or known.empty:
        return None
    text = known.astype(str).str.strip()
    read = _read_iso(text)
    read = _read_clock(text) if read is None else read
    read = _read_written(text) if read is None else read
    return None if read is None else _count(read).reindex(values.index)


def is_dates(values: pd.Series) -> bool:
    """Return whether values are dates or times of day, in whatever order."""
    try:
        return read_dates(values) is not None
    except ValueError:
        return True


def _count(moments: pd.Series) -> pd.Series:
    known = moments.dropna()
    return (moments - (known if len(known) else moments).iloc[0]).dt.total_seconds()


def _read_iso(text: pd.Series) -> pd.Series | None:
    if not text.str.match(ISO).all():
        return None
    read = pd.to_datetime(text.str.replace(",", "."), format="ISO8601", errors="coerce", utc=True)
    return None if read.isna().any() else read


def _read_clock(text: pd.Series) -> pd.Series | None:
    """Return times of day; one half a day or more before the one above it is of the next day."""
    if not text.str.fullmatch(TIME_OF_DAY).all():
        return None
    told = _since_midnight(text.str.extract(f"^{CLOCK}$"))
    return told + pd.to_timedelta((told.diff().dt.total_seconds() < -0.5 * DAY_S).cumsum(), unit="D")


def _read_written(text: pd.Series) -> pd.Series | None:
    found = text.str.extract(DATE)
    if (found["first"].isna() & found["before"].isna()).any():
        return None
    clock = _since_midnight(found)
    if found["first"].isna().all():
        return _place(found["before"], found["month"], found["day"], clock)
    day_first = _place(found["year"], found["other"], found["first"], clock)
    if day_first is not None and (found["sign"] == ".").all():
        return day_first
    month_first = _place(found["year"], found["first"], found["other"], clock)
    month_first = None if (found["sign"] == ".").any() else month_first
    if day_first is None or month_first is None or found["half"].notna().any():
        return day_first if month_first is None else month_first
    differ = _count(day_first) != _count(month_first)
    if differ.any():
        raise ValueError(
            f"expected dates that tell the day from the month, got {text[differ].iloc[0]!r}; write them as 2026-06-05, "
            "or, the day first, as 05.06.2026; or take no column for time_s and set measurement.rate_hz (Hz)"
        )
    return day_first


def _since_midnight(found: pd.DataFrame) -> pd.Series:
    told = found[["hour", "minute"]].astype(float).fillna(0.0)
    second = found["second"].str.replace(",", ".").astype(float).fillna(0.0)
    half = found["half"].str.lower()
    hour = told["hour"].where(half.isna(), told["hour"] % 12.0 + 12.0 * (half == "p"))
    return pd.to_timedelta(hour * 3600.0 + told["minute"] * 60.0, unit="s") + pd.to_timedelta(second, unit="s")


def _place(year: pd.Series, month: pd.Series, day: pd.Series, clock: pd.Series) -> pd.Series | None:
    """Return moments; None where a month or day does not exist."""
    dates = pd.to_datetime(year + "-" + month.str.zfill(2) + "-" + day.str.zfill(2), format="%Y-%m-%d", errors="coerce")
    return None if dates.isna().any() else dates + clock
