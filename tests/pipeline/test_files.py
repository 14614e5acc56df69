"""What a crash of the machine leaves: a file's bytes are on the disk before its name is."""

import os
from pathlib import Path

from pipeline.files import write_text


def test_bytes_then_the_name_then_the_folder_reach_the_disk(tmp_path, monkeypatch):
    done, sync, rename = [], os.fsync, Path.replace

    def sync_and_note(handle):
        done.append(os.fstat(handle).st_ino)
        sync(handle)

    def rename_and_note(path, target):
        done.append("named")
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", sync_and_note)
    monkeypatch.setattr(Path, "replace", rename_and_note)
    write_text(tmp_path / "a.txt", "whole")
    assert done == [(tmp_path / "a.txt").stat().st_ino, "named", tmp_path.stat().st_ino]
