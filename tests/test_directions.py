"""The rules of direction: who may import whom, and who may write files."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
SCIENCE = "stages.science"
ROOMS = {
    "compilation": set(),
    "figures": set(),
    "gp": set(),
    "signals": set(),
    "statistics": set(),
    "plant": {"signals"},
    "effects": {"plant", "signals"},
    "rig": {"plant", "signals"},
    "operator_ui": {"plant", "rig", "signals"},
    "muscle_models": {"gp", "signals"},
    "recording": {"plant", "signals"},
    "output_channels": {"plant", "recording", "signals"},
    "discrepancy": {"gp", "output_channels", "plant", "recording", "signals", "statistics"},
    "scorecard": {"discrepancy", "output_channels", "signals", "statistics"},
}
"""Of science, with the rooms that each may import."""
STAGES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "stages").glob("*/*.py")
    if path.stem != "__init__"
}
READS_THE_PATH_ITS_CONFIGURATION_NAMES = {
    *((f"{SCIENCE}.recording.files.{name}", "pathlib") for name in ("readers", "delimited", "matlab", "bags")),
    (f"{SCIENCE}.recording.files.readers", "pyarrow"),
    (f"{SCIENCE}.recording.files.bags", "os"),
    (f"{SCIENCE}.rig.manual", "pathlib"),
    (f"{SCIENCE}.rig.replay", "pathlib"),
    (f"{SCIENCE}.rig.replay", "pipeline.inputs"),
}
KEEPS_COMPILED_FUNCTIONS = {(f"{SCIENCE}.compilation.locators", "os"), (f"{SCIENCE}.compilation.locators", "pathlib")}
TAKES_RECORDINGS_FOR_TRIALS = (f"{SCIENCE}.rig.replay", f"{SCIENCE}.rig.placement")
WRITES_WHERE_ITS_COMMAND_SAYS = ROOT / "stages" / "benchmark" / "blinded_rig" / "dataset.py"
WRITES = {"copy2", "copyfile", "copytree", "dump", "makedirs", "mkdir", "rmdir", "rmtree", "savefig"}
WRITES |= {"savemat", "savez", "symlink_to", "to_csv", "to_parquet", "touch", "unlink", "write_bytes", "write_text"}


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("pipeline", "stages", include_external_packages=True, cache_dir=None)


def imports_from(graph, package):
    modules = {package} | graph.find_descendants(package)
    return {(module, found) for module in modules for found in graph.find_modules_directly_imported_by(module)}


def within(module, package):
    return module == package or module.startswith(f"{package}.")


def test_there_is_something_to_check(graph):
    assert {"stages.identification.bank", "stages.discrepancy.verify_gap", "stages.benchmark.scorecard"} <= STAGES
    assert ("stages.identification.bank", f"{SCIENCE}.rig.contract") in imports_from(graph, "stages")


def test_every_room_of_science_is_bound():
    assert set(ROOMS) == {path.parent.name for path in (ROOT / "stages" / "science").glob("*/__init__.py")}


def test_pipeline_imports_no_stage(graph):
    assert not [pair for pair in imports_from(graph, "pipeline") if within(pair[1], "stages")]


def test_no_stage_imports_another(graph):
    assert not [pair for pair in imports_from(graph, "stages") if pair[0] in STAGES and pair[1] in STAGES]


def test_nothing_imports_tests(graph):
    found = imports_from(graph, "stages") | imports_from(graph, "pipeline")
    assert not [pair for pair in found if within(pair[1], "tests")]


def test_no_modules_import_each_other_in_a_circle(graph):
    modules = [each for each in graph.modules if within(each, "pipeline") or within(each, "stages")]
    TopologicalSorter({each: graph.find_modules_directly_imported_by(each) for each in modules}).prepare()


def test_science_knows_neither_pipeline_nor_stages_nor_configuration_nor_files(graph):
    forbidden = ("pipeline", "hydra", "omegaconf", "pyarrow", "pathlib", "os", "shutil", *STAGES)
    found = imports_from(graph, SCIENCE)
    guilty = {pair for pair in found for name in forbidden if within(pair[1], name)}
    assert guilty <= READS_THE_PATH_ITS_CONFIGURATION_NAMES | KEEPS_COMPILED_FUNCTIONS


@pytest.mark.parametrize("room", ROOMS)
def test_science_flows_one_way(graph, room):
    others = [f"{SCIENCE}.{each}" for each in ROOMS if each != room and each not in ROOMS[room]]
    found = {
        pair
        for pair in imports_from(graph, f"{SCIENCE}.{room}")
        if not (pair[0] in TAKES_RECORDINGS_FOR_TRIALS and within(pair[1], f"{SCIENCE}.recording"))
    }
    assert not [pair for pair in found for other in others if within(pair[1], other)]


def test_what_searches_and_the_blinded_rig_share_no_code(graph):
    rig = "stages.benchmark.blinded_rig"
    found = imports_from(graph, "stages") | imports_from(graph, "pipeline")
    ours = {pair for pair in found if within(pair[1], "stages") or within(pair[1], "pipeline")}
    assert not [pair for pair in ours if within(pair[0], rig) != within(pair[1], rig)]


def test_files_are_written_by_the_pipeline_alone():
    guilty = []
    for path in {*(ROOT / "stages").rglob("*.py")} - {WRITES_WHERE_ITS_COMMAND_SAYS}:
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            given = [*node.args, *(each.value for each in node.keywords)]
            modes = [each.value for each in given if isinstance(each, ast.Constant) and isinstance(each.value, str)]
            opened = name == "open" and any(set(mode) & set("wax+") for mode in modes)
            guilty += [(path.relative_to(ROOT).as_posix(), node.lineno, name)] if name in WRITES or opened else []
    assert not guilty


def test_matplotlib_is_imported_inside_functions_only():
    guilty = []
    for path in [*(ROOT / "stages").rglob("*.py"), *(ROOT / "pipeline").rglob("*.py")]:
        for node in ast.parse(path.read_text()).body:
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            guilty += [(path.name, name) for name in names if name.startswith("matplotlib")]
    assert not guilty


def test_nothing_private_is_imported():
    guilty = []
    for path in [*(ROOT / "stages").rglob("*.py"), *(ROOT / "pipeline").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [each.name for each in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            names = [f"{getattr(node, 'module', None) or ''}.{each}" for each in names]
            private = [each for each in names if any(part.startswith("_") for part in each.split("."))]
            guilty += [(path.relative_to(ROOT).as_posix(), each) for each in private if "__future__" not in each]
    assert not guilty
