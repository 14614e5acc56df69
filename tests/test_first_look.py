"""The notebook for a first look, executed on a run without its last trials: it asks for the one that followed."""

import shutil
from pathlib import Path

import nbformat
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from nbclient import NotebookClient

from tests.conftest import ROOT

NOTEBOOK = ROOT / "docs" / "first_look.ipynb"


def copy_but_last_trial(run: Path, folder: Path) -> dict:
    """Copy a run's ledger, configuration and tables as they were before the last trials; return the design's last."""
    (folder / "tables").mkdir(parents=True)
    for name in ("run.json", "config.yaml"):
        shutil.copy(run / name, folder)
    for path in (run / "tables").iterdir():
        table = pq.read_table(path)
        if path.stem in ("trials", "points", "models"):
            table = table.filter(pc.less(table["trial"], pc.max(table["trial"])))
        pq.write_table(table, folder / "tables" / path.name)
    trials = pq.read_table(run / "tables" / "trials.parquet").to_pandas()
    return trials[trials["arm"] == trials["arm"].iloc[0]].iloc[-1].to_dict()


def show(cell) -> dict:
    """Return what a cell shows, by type."""
    (shown,) = [each for each in cell.outputs if each.output_type in ("execute_result", "display_data")]
    return shown["data"]


def test_the_notebook_asks_for_the_trial_that_the_run_executed_next(shared_run, tmp_path, monkeypatch):
    monkeypatch.delenv("MPLBACKEND", raising=False)  # which a command in this process has set
    last = copy_but_last_trial(shared_run.runs[0], tmp_path / "outputs" / "runs" / "first")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    (tmp_path / "docs").mkdir()
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path / "docs")}}).execute()
    _, tables, curve, asked, drawn = [each for each in notebook.cells if each.cell_type == "code"]
    assert "learning_curve" in show(tables)["text/plain"]
    assert show(asked)["text/plain"] == str(last["trajectory"])
    assert all("image/png" in show(each) for each in (curve, drawn))


@pytest.mark.parametrize("path", sorted((ROOT / "docs").glob("*.ipynb")), ids=lambda path: path.name)
def test_notebooks_are_stored_without_output(path):
    cells = [each for each in nbformat.read(path, as_version=4).cells if each.cell_type == "code"]
    assert all(each.outputs == [] and each.execution_count is None for each in cells)
