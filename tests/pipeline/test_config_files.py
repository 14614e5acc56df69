"""Options of config groups that lie in files of one's own."""

import hashlib
import json

import pytest
from omegaconf import OmegaConf

from tests.faults import ledger_of

MORE = "count: 9  # numbers (count)\nlabel: more\nspoil: null\n"


@pytest.fixture
def more(tmp_path):
    """A file that is an option of the group `counting`."""
    path = tmp_path / "many more.yaml"
    path.write_text(MORE)
    return path


def test_a_file_serves_as_an_option_is_noted_with_its_hash_and_counts_by_its_bytes(toy, more):
    result = toy(f"counting={more}")
    assert result.returncode == 0, result.stderr
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


def test_a_file_can_build_on_an_option_and_be_overridden(toy, tmp_path):
    (tmp_path / "on_few.yaml").write_text("defaults:\n  - few\nlabel: mine\n")
    result = toy(f"counting={tmp_path / 'on_few.yaml'}", "counting.count=2")
    assert result.returncode == 0, result.stderr
    counting = OmegaConf.load(toy.runs[0] / "config.yaml").counting
    assert counting == {"count": 2, "label": "mine", "spoil": None}


def test_a_file_says_in_which_package_its_keys_are(toy, tmp_path):
    (tmp_path / "workflow.yaml").write_text("# @package _global_\ndefaults:\n  - toy\nseed: 7\n")
    result = toy(f"workflow={tmp_path / 'workflow.yaml'}")
    assert result.returncode == 0, result.stderr
    assert OmegaConf.load(toy.runs[0] / "config.yaml").seed == 7


@pytest.mark.slow
def test_a_sweep_mixes_files_and_options(toy, more):
    result = toy("--multirun", f"counting={more},few")
    assert result.returncode == 0, result.stderr
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
    result = toy(f"counting={path}")
    assert result.returncode == 2
    assert told in result.stderr
    assert str(path) in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not toy.outputs.exists()


def test_a_plant_in_a_file_is_simulated_as_it_is(pamid, tmp_path):
    path = tmp_path / "amended.yaml"
    effect = {"name": "transport_delay", "muscles": None, "delay_s": 0.01}
    path.write_text("defaults:\n  - nominal\neffects:\n  - " + json.dumps(effect) + "\n")
    plan = pamid("budget=tiny", f"plant={path}", "plan=true")
    assert plan.returncode == 0, plan.stderr
    assert f"plant={path}" in plan.stdout
    path.write_text(path.read_text().replace("delay_s", "delay"))
    refused = pamid("budget=tiny", f"plant={path}", "plan=true")
    assert refused.returncode == 2
    assert "effect transport_delay has no parameter 'delay'" in refused.stderr
    assert f"(read from {path})" in refused.stderr
