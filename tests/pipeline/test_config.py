"""What is refused, with which words, and that nothing is written then."""

import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["typo=1"], "unknown key 'typo'"),
        (["plam=true"], "did you mean 'plan'?"),
        (["doubling.pauses=1"], "unknown key 'doubling.pauses': did you mean 'pause_s'?"),
        (["doublng.pause_s=1"], "unknown key 'doublng': did you mean 'doubling'?"),
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
        (["workflow.package=os"], "expected a Python package, got the module 'os'"),
        (["outputs="], "outputs: string should have at least 1 character, got ''"),
        (["counting=3"], "counting: expected the name of a file in conf/counting/"),
        (["seed==1"], "'seed==1' is no override: expected key=value"),
        (["outputs=~/x"], "needs quotes: quote its value twice"),
        (["--foo"], "unrecognized arguments: --foo; python -m pipeline --hydra-help shows the options"),
        (["workflow.package=nowhere"], "no Python package 'nowhere'"),
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
    result = toy(*arguments)
    assert result.returncode == 2
    assert told in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not toy.outputs.exists()


def test_a_key_of_another_option_is_told_with_that_option(pamid):
    result = pamid("plant=nominal", "plant.along=s_m", "plan=true")
    assert result.returncode == 2
    assert result.stderr.strip().endswith("; it is a key of plant=static_map")


def test_help_that_is_not_read_to_its_end_is_no_failure():
    reader, writer = os.pipe()
    os.close(reader)
    line = [sys.executable, "-m", "pipeline", "--help"]
    result = subprocess.run(line, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60)
    os.close(writer)
    assert (result.returncode, result.stderr) == (0, "")


def test_a_metric_of_a_stage_that_is_left_out_is_left_out_too(toy):
    result = toy("+workflow.metrics.m={table:tried,column:score,where:{},but:{},by:mean}")
    assert result.returncode == 0, result.stderr
    assert '"metrics": {}' in (toy.runs[0] / "run.json").read_text()
