"""Models on the amended plant, on designed trials of the tiny budget; what the search may read; the whole workflow."""

import json
from dataclasses import fields

import numpy as np
import pandas as pd
import pytest
import yaml

from stages.discrepancy.amend_model import AMENDED_VALUES
from stages.discrepancy.explain_remainder import LEARNED_MAPS
from stages.identification.grey_box import grey_box, judge_coverage
from stages.science.discrepancy.dataset import build_dataset
from stages.science.discrepancy.parts import list_parts
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import describe_muscles
from stages.science.statistics.intervals import Coverage
from tests.studies import assert_refused, read_stages, run_stage

CHAIN = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop"]
SEARCH = ["measurement", "locate_gap", "name_effect", "explain_remainder", "amend_model", "verify_gap", "propose_trial"]
STAGES = [*CHAIN, "discrimination_trials", *SEARCH, "grey_box"]
NAMING = ("workflow=identification_with_naming",)
SMALL = ("subsampling.experiments=1", "active_loop.controls=[random]", "active_loop.trials=2", "rig.lead_in_s=0.0")
"""Without a lead-in friction begins at rest, as in a simulation of the recording; else its first state is not known."""
RATES = ["nominal_plant", "amended_plant", "gaussian_process", "grey_box"]


def read(*overrides):
    return read_stages(STAGES, *NAMING, *SMALL, *overrides)


def tabulate_amendment(study, effects):
    """Return what the search writes where it adds these effects of the muscles and changes no constant."""
    machine = Exoskeleton.model_validate(study.slice(grey_box)["exoskeleton"])
    rows = [
        (entry.effect.name, entry.form, muscle, name, value)
        for entry in effects
        for muscle in (machine.muscle_names if entry.muscles is None else entry.muscles)
        for name, value in entry.parameters.items()
    ]
    values = pd.DataFrame(rows, columns=["effect", "form", "muscle", "parameter", "value"])
    return {
        "amended_values": values.assign(channel="force_n").reindex(columns=list(AMENDED_VALUES.columns)),
        "learned_maps": pd.DataFrame(columns=list(LEARNED_MAPS.columns)),
        "channels": pd.DataFrame({"channel": [], "muscle": [], "white": []}),
        "measured_muscles": describe_muscles(machine),
        "discrimination_values": None,
    }


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The study, its stages, and the tables of designed trials of a rich rig, without a search of them."""
    study, stages = read()
    folder = tmp_path_factory.mktemp("designed")
    tables = {}
    for name in CHAIN:
        tables.update(run_stage(study, stages[name], folder, tables))
    return study, stages, tables


@pytest.fixture(scope="module")
def unchanged(designed, tmp_path_factory):
    """What the stage makes of a search that found nothing."""
    study, stages, tables = designed
    given = {**tables, **tabulate_amendment(study, [])}
    return run_stage(study, stages["grey_box"], tmp_path_factory.mktemp("unchanged"), given)


def average(found):
    return found["grey_box_summary"].query("muscle == 'mean'").set_index("tested_on")


def test_a_search_that_finds_nothing_leaves_the_nominal_plant(unchanged, designed):
    summary = unchanged["grey_box_summary"]
    assert list(summary["tested_on"].unique()) == ["task", "bank"]
    pd.testing.assert_series_equal(summary["amended_plant"], summary["nominal_plant"], check_names=False)
    assert (summary["points"] == 50).all()
    assert (unchanged["grey_box_coverage"]["width_factor"] == 1.0).all()  # two trials are too few to scale intervals by
    errors = unchanged["grey_box_errors"].set_index(["tested_on", "muscle", "rung"])["error_rate"]
    for row in summary.to_dict("records"):
        assert [row[name] for name in RATES] == pytest.approx(
            [errors[row["tested_on"], row["muscle"], n] for n in RATES]
        )


def test_effects_that_are_the_rigs_leave_little_and_the_noise_is_covered(designed, unchanged, tmp_path):
    study, stages, tables = designed
    rig = study.build("rig")
    true = [each for each in rig.plant.effects if each.effect.site != "joint"]
    first = tabulate_amendment(study, true[:1])["amended_values"].assign(trial=1)
    given = {**tables, **tabulate_amendment(study, true), "discrimination_values": first}
    found = run_stage(study, stages["grey_box"], tmp_path, given)
    before, after = average(unchanged), average(found)
    assert (after["amended_plant"] < 0.1 * before["amended_plant"]).all()
    assert (after["grey_box"] < 0.25 * before["gaussian_process"]).all()
    assert (after["grey_box_covered"] > 0.9).all()
    assert after["gaussian_process"].equals(before["gaussian_process"])
    steps = found["error_by_step"].set_index("step")
    assert list(steps["executed"]) == [0, 4, 4, 5, 5]
    one, all_of_them = steps.loc["amended plant before further trial 1"], steps.loc["amended plant"]
    for name in ("task", "bank"):
        assert all_of_them[name] == pytest.approx(after.loc[name, "amended_plant"])
        assert all_of_them[name] < one[name] < before.loc[name, "nominal_plant"]
    verdicts = found["grey_box_coverage"].query("rung == 'grey_box'").groupby("tested_on")["verdict"].unique()
    assert [list(verdicts[name]) for name in ("task", "bank")] == [["undecided"], ["too wide"]]


@pytest.mark.parametrize(
    ("blocks", "share", "low", "high", "verdict"),
    [
        (40, 0.94, 0.92, 0.96, "as said"),
        (40, 0.90, 0.87, 0.93, "too narrow"),
        (40, 0.98, 0.97, 0.99, "too wide"),
        (40, 1.0, np.nan, np.nan, "too wide"),
        (4, 1.0, np.nan, np.nan, "undecided"),
        (2, 0.8, 0.1, 0.9, "undecided"),
    ],
)
def test_a_verdict_says_whether_intervals_hold_what_they_say(blocks, share, low, high, verdict):
    assert judge_coverage(Coverage(1000, blocks, share, low, high)) == verdict


def test_no_force_but_that_of_executed_trials_changes_a_model(designed, unchanged, tmp_path):
    study, stages, tables = designed
    doubled = {name: tables[name].assign(force_n=2.0 * tables[name]["force_n"]) for name in ("bank", "task_movements")}
    given = {**tables, **doubled, **tabulate_amendment(study, [])}
    found = run_stage(study, stages["grey_box"], tmp_path, given)
    pd.testing.assert_frame_equal(found["grey_box_models"], unchanged["grey_box_models"], check_exact=True)
    assert (average(found)["grey_box"] > 2.0 * average(unchanged)["grey_box"]).all()


def test_nothing_but_the_rig_reads_what_the_rig_hides(designed, unchanged, tmp_path):
    study, _, tables = designed
    other, stages = read("plant@rig_plant=nominal", "rig_plant.muscles.MAS-40.braid_angle_deg=26.0")
    told = {name for name, stage in stages.items() if other.slice(stage) != study.slice(stage)}
    assert told == {"bank", "task", "hardware", "active_loop", "discrimination_trials"}
    for name in (*SEARCH, "grey_box"):
        assert not {"rig", "rig_plant"} & set(study.slice(stages[name]))
    found = run_stage(other, stages["grey_box"], tmp_path, {**tables, **tabulate_amendment(other, [])})
    for name, frame in unchanged.items():
        pd.testing.assert_frame_equal(found[name], frame, check_exact=True)


def test_the_search_reads_the_initial_trials_then_those_of_the_designs_arm(designed, tmp_path):
    study, stages, tables = designed
    found = run_stage(study, stages["measurement"], tmp_path, {**tables, "discrimination_recordings": None})
    measured = found["measured"]
    assert found["measured_session"]["source"].item() == "hardware and active_loop"
    arms = tables["active_recordings"]["arm"].unique()
    assert list(arms) == ["integrated_variance", "random"]
    own = tables["active_recordings"].query("arm == @arms[0]")
    expected = pd.concat([tables["hardware_recordings"], own])
    for name in ("force_n", "pressure_kpa", "contraction"):
        np.testing.assert_array_equal(measured[name], expected[name])
    assert list(measured["trial"].unique()) == [0, 1, 2, 3]


def test_the_search_begins_from_the_plants_own_constants(designed, tmp_path):
    study, stages, tables = designed
    found = run_stage(study, stages["measurement"], tmp_path, {**tables, "discrimination_recordings": None})
    measured = MeasuredTables(*(found[each.name] for each in fields(MeasuredTables)))
    cfg = study.config(stages["locate_gap"])
    parts = list_parts(measured.measured_trials, cfg.parts, cfg.discrepancy.verification_share)
    for output in build_dataset(cfg.plant, measured, parts, cfg.discrepancy).outputs:
        model = cfg.plant.find_model(output.element, "MAS-40" if output.element in ("pam1", "pam3") else "MAS-10")
        starts = {each.name: each.prior_mean for each in output.constants}
        assert starts == {name: getattr(model, name) for name in starts}


@pytest.mark.parametrize("overrides", [("plant=rich",), ("plant=rich", "rig=sim", "plant@rig_plant=nominal")])
def test_a_plant_with_the_effects_of_the_simulated_rig_is_refused(overrides):
    told = "plant: expected what is known of the machine before the search, got the effects that the simulated rig has"
    assert_refused(STAGES, told, *NAMING, *SMALL, *overrides)


@pytest.mark.slow
def test_one_command_designs_names_and_models_what_is_left(pamid):
    result = pamid(*NAMING, "budget=tiny", "active_loop.trials=5")
    assert result.returncode == 0, result.stderr
    (run,) = pamid.runs
    for told in ("Error rate of each rung", "What was found", "What to do next"):
        assert told in result.stdout
    assert (run / "figures/grey_box.png").is_file()
    summary = pd.read_parquet(run / "tables/grey_box_summary.parquet").query("muscle == 'mean'")
    assert (summary["amended_plant"] < summary["nominal_plant"]).all()
    final = pd.read_parquet(run / "tables/final_errors.parquet").query("muscle == 'mean'").set_index("tested_on")
    np.testing.assert_allclose(summary["gaussian_process"], final.loc[summary["tested_on"], "after"], rtol=1e-9)
    coverage = pd.read_parquet(run / "tables/grey_box_coverage.parquet")
    factors = coverage.groupby(["muscle", "rung"])["width_factor"].unique()
    assert all(len(each) == 1 and each[0] >= 1.0 for each in factors)
    assert any(each[0] > 1.0 for each in factors)
    verdict = json.loads((run / "verdict.json").read_text())
    amended = yaml.safe_load((run / "documents/amended.yaml").read_text())
    assert {each["name"] for each in verdict["effects"]} == {each["name"] for each in amended["effects"]}
