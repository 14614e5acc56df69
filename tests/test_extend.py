"""An effect and a plant of one's own, one file each, as docs/extend.md says: the page is typed letter by letter."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "extend.md").read_text()
FILES = re.findall(r"^`([\w/.]+)`\n\n```\w+\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
TYPED = re.findall(r"^\$ (.*)\n((?:(?!\$ |```).*\n)*)", PAGE, re.MULTILINE)
TAKEN = ("pipeline", "stages", "conf", "docs", "tests")
NUMBER = re.compile(r"-?\d[\d.]*(e-?\d+)?")


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of the project in which the page's files lie where it says."""
    tree = tmp_path_factory.mktemp("project")
    for name in TAKEN:
        shutil.copytree(ROOT / name, tree / name)
    shutil.copy(ROOT / "pyproject.toml", tree)
    for name, text in FILES:
        assert not (tree / name).exists()
        (tree / name).write_text(text)
    row = re.search(r"^```markdown\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[1]
    with (tree / "docs" / "plant.md").open("a") as table:
        table.write(row)
    config = tree / "conf" / "config.yaml"
    config.write_text(config.read_text().replace("figures: [png, pdf]", "figures: []"))
    return tree


def run(tree, line):
    """Type a line as it stands on the page."""
    arguments = [sys.executable if each == "python" else each for each in shlex.split(line)]
    environment = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(tree)}
    return subprocess.run(arguments, cwd=tree, env=environment, capture_output=True, text=True, timeout=300)


def read(text):
    """Return a text as words; numbers differ from one machine to the next."""
    return NUMBER.sub("#", " ".join(text.split()))


def judged(tree):
    return [json.loads(path.read_text()) for path in sorted(tree.glob("outputs/runs/*/verdict.json"))]


def test_the_page_shows_effects_and_plants():
    folders = {name.rpartition("/")[0] for name, _ in FILES}
    assert folders == {"", "stages/science/effects", "stages/science/plant/machines"}
    assert len(TYPED) == 6


@pytest.mark.slow
def test_each_effect_is_named_in_its_plant_and_nothing_is_without_it(tree):
    for script in ("record.py", "tank_record.py"):
        assert run(tree, f"python {script}").returncode == 0
    for line, shown in TYPED:
        done = run(tree, line)
        assert done.returncode == 0, done.stderr + done.stdout
        for told in shown.splitlines():
            assert told == "..." or read(told) in read(done.stdout)
    worn, sound, tank = judged(tree)
    assert [(each["name"], each["site"]) for each in worn["effects"]] == [("seal_friction", "element")]
    assert worn["effects"][0]["parameters"]["share"]["value"] == pytest.approx(0.04, abs=0.002)
    assert worn["gap"]["after"] < 1.15 * worn["gap"]["noise_floor"]
    assert sound["status"] == "no_discrepancy"
    assert "seal_friction" in [each["name"] for each in sound["ranking"]]
    assert [(each["name"], each["site"]) for each in tank["effects"]] == [("low_rim", "buffer")]
    assert tank["gap"]["after"] < 1.15 * tank["gap"]["noise_floor"]
