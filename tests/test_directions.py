"""The rules of direction: who may import whom, and who may write files."""

import ast
import functools
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
SCIENCE = "stages.science"
ROOMS = {
    "compilation": set(),
    "figures": {"recording"},
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
WRITES_WHERE_ITS_COMMAND_SAYS = "stages/benchmark/blinded_rig/dataset.py"
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


@pytest.mark.parametrize("package", ["pipeline", "stages"])
def test_pipeline_imports_no_stage_no_stage_another_and_nothing_tests(graph, package):
    found = imports_from(graph, package)
    assert not [pair for pair in found if within(pair[1], "tests")]
    assert not [pair for pair in found if package == "pipeline" and within(pair[1], "stages")]
    assert not [pair for pair in found if pair[0] in STAGES and pair[1] in STAGES]


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


@functools.cache
def walk(package):
    """Return the module, by its path, of each node of the syntax trees of a package, and the node."""
    trees = [
        (path.relative_to(ROOT).as_posix(), ast.parse(path.read_text())) for path in (ROOT / package).rglob("*.py")
    ]
    return [(path, node) for path, tree in trees for node in ast.walk(tree)]


def test_files_are_written_by_the_pipeline_alone():
    guilty = []
    for path, node in walk("stages"):
        if path == WRITES_WHERE_ITS_COMMAND_SAYS or not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        given = [*node.args, *(each.value for each in node.keywords)]
        modes = [each.value for each in given if isinstance(each, ast.Constant) and isinstance(each.value, str)]
        opened = name == "open" and any(set(mode) & set("wax+") for mode in modes)
        guilty += [(path, node.lineno, name)] if name in WRITES or opened else []
    assert not guilty


def list_imported(node):
    """Return the dotted names that an import brings in; of anything else none."""
    names = [each.name for each in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
    return [f"{node.module or ''}.{each}" if isinstance(node, ast.ImportFrom) else each for each in names]


def test_matplotlib_is_imported_inside_functions_only():
    modules = [
        (path, each)
        for path, node in walk("stages") + walk("pipeline")
        if isinstance(node, ast.Module)
        for each in node.body
    ]
    assert not [(path, name) for path, node in modules for name in list_imported(node) if name.startswith("matplotlib")]


def test_nothing_private_is_imported():
    found = [(path, name) for path, node in walk("stages") + walk("pipeline") for name in list_imported(node)]
    private = [(path, name) for path, name in found if any(part.startswith("_") for part in name.split("."))]
    assert not [each for each in private if "__future__" not in each[1]]


def test_everything_imports_without_the_extras():
    """A core install has none of their packages: they are imported where they are used."""
    missing = "aiohttp", "cpx_io", "pymodbus", "mcap", "rosbags", "pysindy", "mlflow"
    paths = [
        path.relative_to(ROOT).with_suffix("")
        for room in ("pipeline", "stages")
        for path in (ROOT / room).rglob("*.py")
    ]
    names = sorted({".".join(each.parts).removesuffix(".__init__") for each in paths if each.name != "__main__"})
    code = (
        f"import sys, importlib; sys.modules.update(dict.fromkeys({missing})); [*map(importlib.import_module, {names})]"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr[-2000:]
