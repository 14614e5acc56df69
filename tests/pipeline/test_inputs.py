"""Files that a person brings count by their bytes."""

import os

import pandas as pd
import pytest

from pipeline.errors import InputError
from pipeline.inputs import read_json
from tests.conftest import Command


@pytest.fixture
def scales(tmp_path):
    """The command with the workflow that weighs files, and a folder with two of them."""
    folder = tmp_path / "goods"
    folder.mkdir()
    (folder / "a.txt").write_text("aaa")
    (folder / "b.txt").write_text("b")
    return Command(tmp_path / "outputs", "--config-dir", "tests/pipeline/conf", "workflow=scales"), folder


def test_changed_bytes_at_the_same_path_rerun_the_stage_and_the_plan_says_which(scales):
    command, folder = scales
    what = f"weighing.what={folder}"
    assert command(what).returncode == 0
    assert pd.read_parquet(command.runs[0] / "tables/weights.parquet")["bytes"].tolist() == [3, 1]
    plan = command(what, "plan=true").stdout
    assert "weighing  fresh" in plan
    assert "weighs 2 files" in plan
    (folder / "a.txt").write_text("AAA")
    assert "input weighing.what/a.txt changed" in command(what, "plan=true").stdout
    assert command(what).returncode == 0
    assert len(command.runs) == 2
    (folder / "a.txt").write_text("aaa")
    assert "everything is fresh" in command(what, "plan=true").stdout


def test_touched_and_hidden_files_make_nothing_stale_but_new_and_lost_ones_do(scales):
    command, folder = scales
    what = f"weighing.what={folder}"
    command(what)
    os.utime(folder / "a.txt", (0, 0))
    (folder / ".hidden").write_text("x")
    assert "weighing  fresh" in command(what, "plan=true").stdout
    (folder / "c.txt").write_text("c")
    assert "input weighing.what/c.txt is new" in command(what, "plan=true").stdout
    (folder / "c.txt").unlink()
    (folder / "b.txt").unlink()
    assert "input weighing.what/b.txt is no longer there" in command(what, "plan=true").stdout


def test_files_in_lists_count_too(scales):
    command, folder = scales
    arguments = f"weighing.what={folder}", f"weighing.others=[{folder / 'a.txt'}]"
    command(*arguments)
    (folder / "a.txt").write_text("other")
    assert "input weighing.others.0/a.txt changed" in command(*arguments, "plan=true").stdout


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("nowhere", "weighing.what: expected the path of a file or folder, got 'nowhere', which is not in "),
        ("{}/empty", "weighing.what: expected files in the folder '"),
        ("''", "weighing.what: string should have at least 1 character"),
        ("7", "weighing.what: input should be a valid string, got 7"),
    ],
)
def test_refuses_a_path_without_files_before_anything_is_written(scales, what, told):
    command, folder = scales
    (folder / "empty").mkdir()
    result = command(f"weighing.what={what.format(folder)}")
    assert result.returncode == 2
    assert told in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not command.outputs.exists()


def test_refuses_what_is_no_json_with_its_line(tmp_path):
    (tmp_path / "x.json").write_text('{\n"a": 1,\n')
    with pytest.raises(InputError, match=r"x\.json: expected JSON, got .* in line"):
        read_json(tmp_path / "x.json")
