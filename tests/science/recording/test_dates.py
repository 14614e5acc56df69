"""Dates as loggers write them: seconds from the first, or a question where the day is not told."""

import pandas as pd
import pytest

from stages.science.recording.dates import read_dates


@pytest.mark.parametrize(
    ("first", "second", "passed"),
    [
        ("2026-05-05T10:00:00", "2026-05-05T10:00:00.25", 0.25),
        ("2026-05-05 10:00:00,5", "2026-05-05 10:00:02,75", 2.25),
        ("2026-05-05T10:00:00+02:00", "2026-05-05T10:00:00Z", 7200.0),
        ("2026/05/05 10:00", "2026/06/05 10:00", 31 * 86400.0),
        ("05.05.2026 10:00:00", "05.06.2026 10:00:01", 31 * 86400.0 + 1.0),
        ("5.5.2026 9:59", "5.5.2026 10:00", 60.0),
        ("05.05.2026, 10:00:00,000", "05.05.2026, 10:00:00,125", 0.125),
        ("5/5/2026 11:59:59 AM", "5/6/2026 12:00:00 PM", 86401.0),
        ("5/5/2026 12:00:00 AM", "5/5/2026 1:00:00 PM", 13 * 3600.0),
        ("12/05/2026 10:00:00", "13/05/2026 10:00:00", 86400.0),
        ("05/12/2026 10:00:00", "05/13/2026 10:00:00", 86400.0),
        ("05-06-2026 10:00:00", "05-06-2026 10:00:03", 3.0),
        ("08:30:00", "08:30:00,5", 0.5),
        ("11:59:59 AM", "12:00:00 PM", 1.0),
        ("23:59:59.5", "00:00:00.25", 0.75),
        ("12:00:01", "12:00:00", -1.0),
    ],
)
def test_dates_are_seconds_from_the_first(first, second, passed):
    assert read_dates(pd.Series([first, second])).tolist() == [0.0, pytest.approx(passed, abs=1e-9)]


def test_a_day_that_may_be_a_month_is_asked_for():
    told = r"tell the day from the month, got '5/6/2026 10:00'; write them as 2026-06-05"
    with pytest.raises(ValueError, match=told):
        read_dates(pd.Series(["5/5/2026 10:00", "5/6/2026 10:00"]))


@pytest.mark.parametrize("text", ["a", "05.13.2026", "31.02.2026", "05.05.26", "10:00", "1.5", "5/5/2026 10:00 h"])
def test_what_is_no_date_is_none(text):
    assert read_dates(pd.Series([text, text])) is None


def test_seconds_count_from_the_first_date_that_is_there_and_gaps_stay():
    days = ["05.05.2026 10:00:00", None, "06.05.2026 10:00:00"]
    for values in (pd.Series([None, *days]), pd.to_datetime(pd.Series([None, *days]), dayfirst=True)):
        read = read_dates(values)
        assert read.isna().tolist() == [True, False, True, False]
        assert read.dropna().tolist() == [0.0, 86400.0]
    assert read_dates(pd.Series(pd.to_datetime([None, None]))).isna().all()
