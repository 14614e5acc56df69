"""What a turn measures outlives the turn that does not land."""

import multiprocessing
import os
import time

import numpy as np
import pandas as pd
import pytest

from pipeline.context import Record
from pipeline.journal import Journal, keep_interrupted, read_journal
from pipeline.table import Table, column

TABLE = Table("made", "A number", {"number": column(int, "a number")})


def rows(first, count=10):
    return {"time_s": np.arange(first, first + count) / 100.0, "muscle": np.array(["pam1"] * count)}


def make_record(folder):
    return Record(folder / "run" / "parts" / "loop-0123", {"made": TABLE}, lambda: None)


def interrupted(folder):
    return sorted((folder / "run" / "interrupted").glob("*"))


def made():
    return {"made": pd.DataFrame({"number": [1]})}


def assert_even(frame):
    assert frame["time_s"].tolist() == pytest.approx(np.arange(len(frame)) / 100.0)


def test_a_turn_that_lands_or_measured_nothing_leaves_no_journal(tmp_path):
    record = make_record(tmp_path)
    record.part((1,), lambda: record.watch((1,))(rows(0)) or made())
    with pytest.raises(ZeroDivisionError):
        record.part((2,), lambda: 1 / 0)
    assert not (tmp_path / "run" / "interrupted").exists()


def test_the_journal_goes_when_the_part_is_on_disk(tmp_path, monkeypatch):
    record, synced, sync = make_record(tmp_path), [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (synced.append(os.fstat(handle).st_ino), sync(handle)))
    monkeypatch.setattr(Journal, "discard", lambda _: synced.append("gone"))
    record.part((1,), lambda: record.watch((1,))(rows(0)) or made())
    assert synced.index("gone") > synced.index(record.folder.stat().st_ino)


@pytest.mark.parametrize("error", [ValueError("pam1 at 900 kPa\nmore"), KeyboardInterrupt("Ctrl-C")])
def test_a_turn_that_fails_leaves_its_rows_with_the_reason(tmp_path, error):
    record = make_record(tmp_path)

    def make():
        watch = record.watch(("p1", 2))
        watch(rows(0))
        watch(rows(10))
        raise error

    with pytest.raises(type(error)) as caught:
        record.part(("p1", 2), make)
    (kept,) = interrupted(tmp_path)
    assert kept.name == "loop~p1~2~1.parquet"
    assert str(kept) in caught.value.__notes__[0]
    frame = pd.read_parquet(kept)
    assert len(frame) == 20
    assert_even(frame)
    assert set(frame["stopped_by"]) == {str(error).split("\n")[0]}
    with pytest.raises(type(error)):
        record.part(("p1", 2), make)
    assert [each.name for each in interrupted(tmp_path)] == ["loop~p1~2~1.parquet", "loop~p1~2~2.parquet"]


def make_turns(folder, there):
    """Measure in one turn of a loop until the process is killed."""
    record = make_record(folder)

    def make():
        for turn in range(1000):
            record.watch((1,))(rows(10 * turn))
            if turn == 20:
                there.set()
            time.sleep(0.01)

    record.part((1,), make)


def test_a_killed_process_leaves_what_it_handed_over(tmp_path):
    processes = multiprocessing.get_context("fork")
    there = processes.Event()
    process = processes.Process(target=make_turns, args=(tmp_path, there))
    process.start()
    assert there.wait(60)
    time.sleep(0.1)
    process.kill()
    process.join()
    (left,) = interrupted(tmp_path)
    assert left.suffix == ".arrows"
    assert len(read_journal(left)) >= 200
    make_record(tmp_path).part((1,), made)
    (kept,) = interrupted(tmp_path)
    frame = pd.read_parquet(kept)
    assert_even(frame)
    assert len(frame) >= 200
    assert set(frame["stopped_by"]) == {"the process ended"}


@pytest.mark.parametrize("cut", [1, 40, 300])
def test_a_journal_that_is_cut_is_read_up_to_its_last_whole_batch(tmp_path, cut):
    journal = Journal(tmp_path / "one.arrows")
    for turn in range(5):
        journal(rows(10 * turn))
    journal.close()
    journal.path.write_bytes(journal.path.read_bytes()[:-cut])
    frame = read_journal(journal.path)
    assert len(frame) in (40, 50)
    assert_even(frame)


def test_what_is_no_journal_is_none(tmp_path):
    path = tmp_path / "one.arrows"
    path.write_bytes(b"not a stream")
    assert keep_interrupted(path, "why") is None
    assert not path.exists()
