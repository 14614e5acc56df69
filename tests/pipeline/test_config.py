"""What a configuration may hold, also in files of one's own, and name; what is refused, and nothing is written then."""

import hashlib
import json
import os
import shlex
import subprocess
import sys

import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from pipeline.command import complete, override, split_command
from pipeline.errors import InputError
from pipeline.inputs import read_json
from tests.conftest import ROOT, Command
from tests.faults import ledger_of
from tests.pipeline.conftest import CONFIG, refusal, success


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["typo=1"], "unknown key 'typo'"),
        (["plam=true"], "did you mean 'plan'?"),
        (["doubling.pauses=1"], "unknown key 'doubling.pauses': did you mean 'pause_s'?"),
        (["doublng.pause_s=1"], "unknown key 'doublng': did you mean 'doubling'?"),
        (
            ["doubling@other=plain"],
            "doubling@other: expected a section that this workflow has, and it has no other of its own",
        ),
        (["counting.cout.low=1"], "unknown key 'counting.cout': did you mean 'count'?"),
        (["+workflow.stage=[adding]"], "unknown key 'workflow.stage': did you mean 'stages'?"),
        (["workflow=toi"], "unknown workflow 'toi': did you mean 'toy'?"),
        (["counting=fewer"], "unknown counting 'fewer': did you mean 'few'?"),
        (["counting.count=abc"], "counting.count: input should be a valid integer, got 'abc'"),
        (["counting.count=2.5"], "counting.count: input should be a valid integer, got 2.5"),
        (["counting.count=???"], "missing value: set it as counting.count=..."),
        (["~doubling.digits"], "missing key 'doubling.digits'"),
        (["doubling.pause_s=nan"], "doubling.pause_s: input should be a finite number, got nan"),
        (["stages=[addin]"], "no stage 'addin' in workflow toy; did you mean 'adding'?"),
        (["workflow.stages=[countin]"], "no stage 'countin' in tests.pipeline.toy; did you mean 'counting'?"),
        (["workflow.stages=[adding,counting]"], "stage adding reads table doubles, which no stage"),
        (["stages=[]"], "stages: expected at least one, or null for all, got []; choose from: counting, doubling"),
        (["workflow.headline=[totl]"], "no stage of workflow toy writes 'totl'; did you mean 'total'?"),
        (["workflow.stages=[]"], "workflow.stages: list should have at least 1 item"),
        (["workflow.stages=[counting]"], "unknown key 'doubling', which no stage of workflow toy reads"),
        (["workflow.package=os"], "workflow.package: expected the dotted name of a Python package, got 'os'"),
        (["outputs="], "outputs: string should have at least 1 character, got ''"),
        (["counting=3"], "counting: expected the name of a file in conf/counting/"),
        (["seed=1,2"], "seed=1,2: several values are a sweep, which is asked for by -m"),
        (["outputs=2026"], "got 2026; quote it twice, as in \"outputs='2026'\""),
        (["seed==1"], "'seed==1' is no override: expected key=value"),
        (["outputs=~/x"], "needs quotes: quote its value twice"),
        (["--foo"], "unrecognized arguments: --foo; python -m pipeline --hydra-help shows the options"),
        (["workflow.package=nowhere"], "workflow.package: expected the dotted name of a Python package, got 'nowhere'"),
        (
            ["+workflow.metrics.m={table:totl,column:total,where:{},but:{},by:mean}"],
            "workflow.metrics.m.table: no stage of tests.pipeline.toy writes 'totl'; did you mean 'total'?",
        ),
        (
            ["+workflow.metrics.m={table:doubles,column:doubel,where:{},but:{},by:mean}"],
            "workflow.metrics.m.column: table doubles has no column 'doubel'; did you mean 'double'?",
        ),
        (
            ["+workflow.curves.c={table:doubles,x:number,y:double,by:[nobody],repeats:[],where:{}}"],
            "workflow.curves.c.by: table doubles has no column 'nobody'",
        ),
    ],
)
def test_refuses_before_anything_is_written(toy, arguments, told):
    assert told in refusal(toy, *arguments)


def test_a_section_of_other_workflows_is_told_with_those(pamid):
    told = refusal(pamid, "workflow=discrepancy", "task=movements", "next_trials=3", "plan=true")
    assert "task: this workflow has none; these have: workflow=identification, identification_with" in told
    told = refusal(pamid, "workflow=discrepancy", "budget=tiny", "plan=true")
    assert "budget=tiny: it chooses a participant, and this workflow has none; leave it out" in told
    told = refusal(pamid, "measured=run.csv", "plan=true")
    assert "measured: this workflow has none; these have: workflow=discrepancy, identification_with_naming" in told


def test_a_key_of_another_option_is_told_with_that_option(pamid):
    line = refusal(pamid, "plant=nominal", "plant.along=s_m", "plan=true")
    assert line.endswith("; it is a key of plant=cylinder or damper or finger or muscle or static_map")


def test_help_that_is_not_read_to_its_end_is_no_failure():
    reader, writer = os.pipe()
    os.close(reader)
    line = [sys.executable, "-m", "pipeline", "--help"]
    result = subprocess.run(line, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60)
    os.close(writer)
    assert (result.returncode, result.stderr) == (0, "")


def test_a_metric_of_a_stage_that_is_left_out_is_left_out_too(toy):
    success(toy, "+workflow.metrics.m={table:tried,column:score,where:{},but:{},by:mean}")
    assert '"metrics": {}' in (toy.runs[0] / "run.json").read_text()


MORE = "count: 9  # numbers (count)\nlabel: more\nspoil: null\n"


@pytest.fixture
def more(tmp_path):
    """A file that is an option of the group `counting`."""
    path = tmp_path / "many more.yaml"
    path.write_text(MORE)
    return path


def test_a_file_serves_as_an_option_is_noted_with_its_hash_and_counts_by_its_bytes(toy, more):
    success(toy, f"counting={more}")
    (run,) = toy.runs
    assert OmegaConf.load(run / "config.yaml").counting.count == 9
    ledger = ledger_of(run)
    digest = hashlib.sha256(MORE.encode()).hexdigest()
    assert ledger["given"] == [{"group": "counting", "file": str(more), "sha256": digest}]
    assert f"counting is {more} (SHA-256 {digest})" in (run / "log.txt").read_text()
    assert f"'counting={more}'" in ledger["command"]
    assert "everything is fresh" in toy(f"counting={more}", "plan=true").stdout
    more.write_text(MORE.replace("9", "10"))
    assert "config changed (counting.count 9 -> 10)" in toy(f"counting={more}", "plan=true").stdout


def test_a_file_can_build_on_an_option_be_overridden_and_say_in_which_package_its_keys_are(toy, tmp_path):
    few, workflow = tmp_path / "on_few.yaml", tmp_path / "workflow.yaml"
    few.write_text("defaults:\n  - few\nlabel: mine\n")
    workflow.write_text("# @package _global_\ndefaults:\n  - toy\nseed: 7\n")
    success(toy, f"counting={few}", "counting.count=2", f"workflow={workflow}")
    config = OmegaConf.load(toy.runs[0] / "config.yaml")
    assert config.counting == {"count": 2, "label": "mine", "spoil": None}
    assert config.seed == 7


@pytest.mark.slow
def test_a_sweep_mixes_files_and_options(toy, more):
    success(toy, "--multirun", f"counting={more},few")
    jobs = sorted((toy.outputs / "sweeps").glob("*/counting=*"))
    found = [(OmegaConf.load(job / "config.yaml").counting.count, "given" in ledger_of(job)) for job in jobs]
    assert found == [(6, False), (9, True)]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "no such file in "),
        ("", "expected YAML with keys of counting, got none"),
        ("- 1\n- 2\n", "expected YAML with keys of counting, got none"),
        ("words\n", "expected YAML with keys of counting, got none"),
        ("count: [1\n", "expected YAML, got expected ',' or ']'"),
        ("count: 1\ncount: 2\n", "expected YAML, got found duplicate key count in line 2"),
        (MORE + "cout: 3\n", "unknown key 'counting.cout': did you mean 'count'? (read from "),
        ("count: 3\n", "missing key 'counting.label'"),
        (MORE.replace("9", "many"), "counting.count: input should be a valid integer, got 'many'"),
    ],
)
def test_refuses_a_wrong_file_in_one_line_before_anything_is_written(toy, tmp_path, text, told):
    path = tmp_path / "mine.yaml"
    if text is not None:
        path.write_text(text)
    line = refusal(toy, f"counting={path}")
    assert told in line
    assert str(path) in line


def test_a_plant_in_a_file_is_simulated_as_it_is(pamid, tmp_path):
    path = tmp_path / "amended.yaml"
    effect = {"name": "transport_delay", "muscles": None, "delay_s": 0.01}
    path.write_text("defaults:\n  - nominal\neffects:\n  - " + json.dumps(effect) + "\n")
    assert f"plant={path}" in success(pamid, "budget=tiny", f"plant={path}", "plan=true")
    path.write_text(path.read_text().replace("delay_s", "delay"))
    line = refusal(pamid, "budget=tiny", f"plant={path}", "plan=true")
    assert "effect transport_delay has no parameter 'delay'" in line
    assert f"(read from {path})" in line


# files that a person brings count by their bytes


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
    page = (command.runs[0] / "report.html").read_text()
    assert "<td>file</td><td></td>" in page  # texts have no unit
    assert "<td>bytes</td><td>B</td>" in page
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


@pytest.mark.parametrize("path", ["/a/b-1.yaml", '/a b/it\'s "so" <x> $HOME/c.yaml', "a=b,c[0]{}"])
def test_an_override_is_read_as_it_was_typed(path):
    (typed,) = shlex.split(override("plant", path))
    (read,) = OverridesParser.create().parse_overrides([typed])
    assert (read.key_or_group, read.value()) == ("plant", path)


@pytest.mark.parametrize(
    ("sentence", "typed", "expected"),
    [
        ("Nothing to do.", "python -m pipeline seed=1", "Nothing to do."),
        ("Go: python -m pipeline a=b", "python -m pipeline", "Go: python -m pipeline a=b"),
        ("Go: python -m pipeline a=b", ".v/bin/python3.11 -m pipeline seed=1", "Go: .v/bin/python3.11 -m pipeline a=b"),
        (
            "Go: python -m pipeline a=FOLDER/b.yaml",
            "python -m pipeline 'outputs=my runs' budget=tiny seed=1",
            f"Go: python -m pipeline 'outputs=my runs' budget=tiny {override('a', 'my runs/1/b.yaml')}",
        ),
        (
            "More: python -m pipeline ARGUMENTS n=20 seed=2",
            "python -m pipeline sweep=s 'u={_target_: f}' n=3 outputs=o plan=true seed=1",
            "More: python -m pipeline 'u={_target_: f}' outputs=o n=20 seed=2",
        ),
        (
            "What lies below is in the file: python -m pipeline ARGUMENTS plant=FOLDER",
            "python -m pipeline plant=x plant.output=y +plant.z.0=1 plants=2",
            f"What lies below is in the file: python -m pipeline plants=2 {override('plant', 'my runs/1')}",
        ),
    ],
)
def test_a_proposed_command_can_be_typed_after_the_run(sentence, typed, expected):
    told = complete(sentence, typed, "my runs/1")
    assert told == expected
    words, command = split_command(told)
    assert told == f"{words} {command}".strip()
