"""The rules of direction: who may import whom."""

import ast
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
STAGES = sorted(path.stem for path in (ROOT / "stages").glob("*.py") if path.stem != "__init__")
READS_THE_PATH_ITS_CONFIGURATION_NAMES = {
    *((f"stages.recording.files.{name}", "pathlib") for name in ("foreign", "delimited", "matlab", "bags")),
    ("stages.recording.files.foreign", "pyarrow"),
    ("stages.recording.files.bags", "os"),
    ("stages.rig.operator", "pathlib"),
    ("stages.rig.replay", "pathlib"),
    ("stages.rig.replay", "pipeline.inputs"),
}
TAKES_RECORDINGS_FOR_TRIALS = ("stages.rig.replay", "stages.rig.placement")
WORKFLOWS = {"benchmark"}
SCIENCE = sorted({path.parent.name for path in (ROOT / "stages").glob("*/__init__.py")} - WORKFLOWS)


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("pipeline", "stages", include_external_packages=True, cache_dir=None)


def imports_from(graph, package):
    modules = {package} | graph.find_descendants(package)
    return {(module, found) for module in modules for found in graph.find_modules_directly_imported_by(module)}


def within(module, package):
    return module == package or module.startswith(f"{package}.")


def test_there_is_something_to_check(graph):
    assert {"bank", "active_loop", "comparison"} <= set(STAGES)
    assert {"gp", "parametric", "plant", "rig", "signals"} <= set(SCIENCE)
    assert ("stages.bank", "stages.rig.contract") in imports_from(graph, "stages")


def test_pipeline_imports_no_stage(graph):
    assert not [pair for pair in imports_from(graph, "pipeline") if within(pair[1], "stages")]


def test_no_stage_imports_another(graph):
    stages = {f"stages.{name}" for name in STAGES}
    assert not [pair for pair in imports_from(graph, "stages") if pair[0] in stages and pair[1] in stages]


def test_nothing_imports_tests(graph):
    found = imports_from(graph, "stages") | imports_from(graph, "pipeline")
    assert not [pair for pair in found if within(pair[1], "tests")]


@pytest.mark.parametrize("folder", SCIENCE)
def test_science_knows_neither_pipeline_nor_configuration_nor_files(graph, folder):
    forbidden = (
        "pipeline",
        "hydra",
        "omegaconf",
        "pyarrow",
        "pathlib",
        "os",
        "shutil",
        *(f"stages.{s}" for s in STAGES),
    )
    found = imports_from(graph, f"stages.{folder}")
    guilty = {pair for pair in found for name in forbidden if within(pair[1], name)}
    assert guilty <= READS_THE_PATH_ITS_CONFIGURATION_NAMES


def test_science_flows_one_way(graph):
    allowed = {
        "gp": set(),
        "signals": set(),
        "parametric": set(),
        "statistics": set(),
        "figures": set(),
        "compilation": set(),
        "plant": {"signals"},
        "rig": {"plant", "signals"},
        "identification": {"gp", "signals"},
        "recording": {"plant", "signals"},
    }
    for folder, known in allowed.items():
        others = [f"stages.{each}" for each in SCIENCE if each != folder and each not in known]
        found = {
            (module, found)
            for module, found in imports_from(graph, f"stages.{folder}")
            if not (module in TAKES_RECORDINGS_FOR_TRIALS and within(found, "stages.recording"))
        }
        assert not [pair for pair in found for other in others if within(pair[1], other)], folder


def test_what_searches_and_the_blinded_rig_share_no_code(graph):
    rig = "stages.benchmark.blinded_rig"
    found = imports_from(graph, "stages") | imports_from(graph, "pipeline")
    ours = {pair for pair in found if within(pair[1], "stages") or within(pair[1], "pipeline")}
    assert not [pair for pair in ours if within(pair[0], rig) != within(pair[1], rig)]


def test_matplotlib_is_imported_inside_functions_only():
    guilty = []
    for path in [*(ROOT / "stages").rglob("*.py"), *(ROOT / "pipeline").rglob("*.py")]:
        for node in ast.parse(path.read_text()).body:
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            guilty += [(path.name, name) for name in names if name.startswith("matplotlib")]
    assert not guilty
