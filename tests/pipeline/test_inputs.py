"""Files that a person brings count by their bytes."""

import os

import pandas as pd
import pytest

from pipeline.errors import InputError
from pipeline.inputs import read_json
from tests.conftest import Command
from tests.pipeline.conftest import CONFIG, refusal


@pytest.fixture
def scales(tmp_path):
    """The command with the workflow that weighs files, and a folder with two of them."""
    folder = tmp_path / "goods"
    folder.mkdir()
    (folder / "a.txt").write_text("aaa")
    (folder / "b.txt").write_text("b")
    return Command(tmp_path / "outputs", *CONFIG, "workflow=scales"), folder


def test_bytes_alone_make_a_stage_stale_and_the_plan_says_of_which_file(scales, tmp_path):
    command, folder = scales
    other = tmp_path / "other.txt"
    other.write_text("oo")
    arguments = f"weighing.what={folder}", f"weighing.others=[{other}]"

    def plan():
        return command(*arguments, "plan=true").stdout

    assert command(*arguments).returncode == 0
    assert pd.read_parquet(command.runs[0] / "tables/weights.parquet")["bytes"].tolist() == [3, 1, 2]
    os.utime(folder / "a.txt", (0, 0))
    (folder / ".hidden").write_text("x")
    assert "weighing  fresh" in plan()
    assert "weighs 2 files" in plan()
    (folder / "c.txt").write_text("c")
    assert "input weighing.what/c.txt is new" in plan()
    (folder / "c.txt").unlink()
    other.write_text("OO")
    assert "input weighing.others.0/other.txt changed" in plan()
    other.write_text("oo")
    (folder / "a.txt").write_text("AAA")
    assert "input weighing.what/a.txt changed" in plan()
    assert command(*arguments).returncode == 0
    assert len(command.runs) == 2
    (folder / "a.txt").write_text("aaa")
    assert "everything is fresh" in plan()
    (folder / "b.txt").unlink()
    assert "input weighing.what/b.txt is no longer there" in plan()


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
    assert told in refusal(command, f"weighing.what={what.format(folder)}")


def test_refuses_what_is_no_json_with_its_line(tmp_path):
    (tmp_path / "x.json").write_text('{\n"a": 1,\n')
    with pytest.raises(InputError, match=r"x\.json: expected JSON, got .* in line"):
        read_json(tmp_path / "x.json")
