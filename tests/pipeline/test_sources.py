"""Freshness by module: what a stage's code is, and what an edit makes stale."""

import cProfile
from pathlib import Path

import pytest

from pipeline import sources
from pipeline.config import read_study
from pipeline.files import hash_file
from pipeline.plan import gather
from pipeline.sources import hash_sources
from tests.composing import compose_values
from tests.conftest import ROOT
from tests.measured_data import write_dataset
from tests.science.discrepancy.sessions import record_session
from tests.studies import run_stage

MAIN = ()
PAPER = ("experiment=paper",)
HIDDEN = ("experiment=hidden_effect",)
GAP = ("workflow=discrepancy", f"measured={Path(__file__)}")
SILVERBOX = (*GAP, "plant=silverbox", "measurement=silverbox")
SEARCHING = {"locate_gap", "name_effect", "amend_model", "explain_remainder", "verify_gap", "propose_trial"}
KEEPING = "/stages/science/compilation/"
"""What keeps compiled functions changes no result."""
DRIVING = {"bank", "unseen_bank", "hardware", "active_loop", "sparse_loop"}


def list_stale(monkeypatch, file, overrides):
    """Return the stages of a study whose fingerprint an edit of a file changes."""
    study, stages = read_study(compose_values(*overrides))
    before = {each.name: gather(study, each, {}).fingerprint for each in stages}
    assert (ROOT / file).is_file()
    with monkeypatch.context() as patched:
        patched.setattr(sources, "hash_file", lambda path: "edited" if path == ROOT / file else hash_file(path))
        return {each.name for each in stages if gather(study, each, {}).fingerprint != before[each.name]}


@pytest.mark.parametrize(
    ("file", "overrides", "stale"),
    [
        ("stages/science/recording/files/delimited.py", HIDDEN, {"measurement"}),
        ("stages/science/recording/files/delimited.py", PAPER, set()),
        ("stages/science/recording/dates.py", MAIN, set()),
        ("stages/science/effects/hysteresis.py", PAPER, DRIVING),
        ("stages/science/effects/hysteresis.py", (*PAPER, "plant=nominal"), set()),
        ("stages/science/effects/cable_slack.py", PAPER, set()),
        ("stages/science/effects/cable_slack.py", HIDDEN, SEARCHING | {"further_trials"}),
        ("stages/science/plant/machines/second_order.py", PAPER, set()),
        ("stages/science/plant/machines/second_order.py", SILVERBOX, SEARCHING),
        ("stages/science/plant/machines/second_order.py", GAP, set()),
        ("stages/science/operator_ui/pages/style.css", (*PAPER, "operator_ui=pages"), set()),
        ("stages/science/operator_ui/pages/server.py", (*PAPER, "operator_ui=pages"), set()),
        ("stages/science/rig/sim.py", PAPER, DRIVING),
        ("stages/benchmark/blinded_rig/kernels.py", HIDDEN, {"blinded_session", "further_trials", "unblinding"}),
        ("stages/science/figures/learning_curves.py", MAIN, {"comparison", "participant_differences"}),
        ("stages/identification/hyperprior.py", PAPER, {"hyperprior"}),
        ("pipeline/runner.py", PAPER, set()),
    ],
)
def test_an_edit_makes_those_stages_stale_that_use_the_file(monkeypatch, file, overrides, stale):
    assert list_stale(monkeypatch, file, overrides) == stale


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [("budget=tiny",), ("workflow=discrepancy", "measured={}")], ids=["main", "gap"])
def test_no_stage_runs_code_that_does_not_count(tmp_path, overrides):
    write_dataset(tmp_path / "session", *record_session())
    study, stages = read_study(compose_values(*(each.format(tmp_path / "session") for each in overrides)))
    tables = {}
    ran = {}
    for stage in stages:
        with cProfile.Profile(builtins=False) as profile:
            tables |= run_stage(study, stage, tmp_path, tables)
        ran[stage.name] = {each.code.co_filename for each in profile.getstats() if not isinstance(each.code, str)}
    for stage in stages:
        found = {each for each in ran[stage.name] if each.startswith(f"{ROOT}/stages/") and KEEPING not in each}
        counted = {str(ROOT / each) for each in gather(study, stage, {}).code}
        assert f"{ROOT}/{stage.module.replace('.', '/')}.py" in found
        assert found <= counted


def test_relative_imports_count_and_files_of_one_name_are_kept_apart(tmp_path, monkeypatch):
    texts = {
        "bench/__init__.py": "",
        "bench/weighing.py": "from .scale import tare\nfrom . import notes\nfrom ..loads import heavy\n",
        "bench/scale.py": 'def tare():\n    from . import springs\n\n\nTOLD = """\ndef of a text\n"""\n',
        "bench/springs.py": "def pull():\n    return 1\n",
        "bench/notes.py": "",
        "loads/__init__.py": "",
        "loads/heavy.py": "from .more.heavy import load",
        "loads/more/__init__.py": "",
        "loads/more/heavy.py": "load = 1",
    }
    for name, text in texts.items():
        path = tmp_path / "workshop" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "workshop" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    used = {f"workshop/{name}" for name, text in texts.items() if not name.endswith("__init__.py")}
    assert set(hash_sources("workshop", ["workshop.bench.weighing"])) == used
    heavy = {"workshop/loads/heavy.py", "workshop/loads/more/heavy.py"}
    assert set(hash_sources("pipeline", ["workshop.loads.heavy", "workshop.loads.more.heavy"])) == heavy
