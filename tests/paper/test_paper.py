"""The paper's study in its tiny budget: everything is there, on any number of workers; one analysis reruns alone."""

import json

import pandas as pd
import pytest

from tests.conftest import Command
from tests.faults import tables_of

pytestmark = pytest.mark.slow

ANALYSES = {"baselines", "learned_models", "utility_check", "time_shift", "hyperprior_sensitivity", "sparse_comparison"}
SPREAD = {"active_loop", "comparison", "utility_check", "sparse_comparison"}
"""Stages whose work several processes may share; jobs of the others are sent, as if to some, in their own tests."""
FIGURES = """
selected_interactions learning_curve learning_curve_muscles learning_curves_baselines baseline_errors
participants time_shift hyperprior_sensitivity frequent_references force_surfaces reliability utility_agreement
sparse_curve protocol
"""


STUDY = ("experiment=paper", "budget=tiny")


@pytest.fixture(scope="session")
def finished(make_once):
    """One finished run, made once for all: the command, what it printed, and its folder."""

    def run(folder):
        result = Command(folder / "outputs", *STUDY)()
        assert (result.returncode, result.stderr) == (0, "")
        (folder / "printed.txt").write_text(result.stdout)

    place = make_once("paper run", run)
    command = Command(place / "outputs", *STUDY)
    return command, (place / "printed.txt").read_text(), command.runs[0]


def records_of(run):
    return json.loads((run / "run.json").read_text())["stages"]


def test_every_figure_and_table_is_there(finished):
    _, _, run = finished
    assert ANALYSES | {"claims"} <= set(records_of(run))
    assert {path.stem for path in (run / "figures").glob("*.png")} == set(FIGURES.split())
    page = (run / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(FIGURES.split())
    assert "the error falls on a real exoskeleton" in page


def test_claims_are_printed_whole_and_follow_from_what_was_measured(finished):
    _, printed, run = finished
    claims = pd.read_parquet(run / "tables/claims.parquet")
    assert claims["claim"].nunique() == 13
    for name in claims["claim"].unique():
        assert name in printed
    judged = claims.set_index(["claim", "tested_on"])["verdict"]
    assert judged.loc["works_on_real_robot"].to_list() == ["not testable in simulation"]
    assert judged.loc[("error_falls", "bank")] == "not tested"  # one experiment shows nothing
    assert judged.loc["participants_alike"].to_list() == ["not tested"]  # there is one
    assert set(claims["tested_on"]) == {"", "bank", "unseen_bank"}


def test_errors_on_the_unseen_bank_are_its_own(finished):
    _, _, run = finished
    bank, unseen = (pd.read_parquet(run / f"tables/{name}.parquet") for name in ("bank", "unseen_bank"))
    assert set(bank["force_n"]).isdisjoint(unseen.loc[unseen["force_n"] > 0, "force_n"])
    curve = pd.read_parquet(run / "tables/learning_curve.parquet")
    both = curve.pivot_table(index=["arm", "trial", "muscle"], columns="tested_on", values="rmse_n")
    assert (both["bank"] != both["unseen_bank"]).all()


def test_one_analysis_reruns_alone_and_touches_nothing_else(finished, tmp_path):
    command = finished[0].copy(tmp_path / "outputs")
    (run,) = command.runs
    before = tables_of(run)
    result = command("stages=[time_shift]", "time_shift.amplitudes_s=[0.2]", "figures=[]")
    assert result.returncode == 0, result.stderr
    records = records_of(command.runs[-1])
    shift = pd.read_parquet(command.runs[-1] / "tables/shift_curve.parquet")
    assert sorted(shift["amplitude_s"].unique()) == [0.0, 0.2]
    assert {name for name, record in records.items() if record["origin"] != run.name} == {"time_shift"}
    assert tables_of(run) == before


def test_the_number_of_workers_changes_no_byte(finished, tmp_path):
    command = finished[0].copy(tmp_path / "outputs")
    result = command("workers=2", "figures=[]", f"stages=[{','.join(SPREAD)}]")
    assert result.returncode == 0, result.stderr
    first, again = command.runs
    assert {name for name, record in records_of(again).items() if record["origin"] == again.name} >= SPREAD
    assert tables_of(again).items() <= tables_of(first).items()
