"""The design never sees the bank's force."""

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from pipeline.config import read_settings, validate
from pipeline.context import Context, Record
from pipeline.stage import load_stages, order_stages
from tests.composing import compose_values


@pytest.fixture(scope="module")
def study():
    values = OmegaConf.to_container(compose_values("budget=tiny"), resolve=True)
    settings = read_settings(values)
    stages = order_stages(load_stages("stages", settings.workflow.stages))
    return validate(values, settings, stages), {stage.name: stage for stage in stages}


def run_in_memory(study, stage, folder, tables):
    seed = study.slice(stage).get(stage.name, {}).get("seed", study.settings.seed)
    record = Record(folder / "parts" / stage.name, {table.name: table for table in stage.writes}, lambda: None)
    rig = study.build("rig") if study.target(stage) else None
    context = Context(stage.name, folder, seed, record, Console(quiet=True), rig)
    found = stage.function(cfg=study.config(stage), ctx=context, **{name: tables[name] for name in stage.reads})
    if isinstance(found, pd.DataFrame):
        found = (found,)
    return found if isinstance(found, dict) else dict(zip((each.name for each in stage.writes), found, strict=True))


def run_until_chosen(study, folder, spoil):
    configured, stages = study
    tables = run_in_memory(configured, stages["bank"], folder, {})
    if spoil:
        tables["bank"] = tables["bank"].assign(force_n=np.nan)
    for name in ("subsampling", "hyperprior", "hardware", "active_loop"):
        tables.update(run_in_memory(configured, stages[name], folder, tables))
    return tables


def test_candidates_have_no_force(study, tmp_path):
    tables = run_until_chosen(study, tmp_path, spoil=False)
    for name in ("candidates", "references", "initial_trials"):
        assert not [column for column in tables[name].columns if "force" in column]


def test_picks_are_the_same_with_the_force_of_the_bank_set_to_nan(study, tmp_path):
    with_force = run_until_chosen(study, tmp_path / "with", spoil=False)
    without = run_until_chosen(study, tmp_path / "without", spoil=True)
    assert without["bank"]["force_n"].isna().all()
    pd.testing.assert_frame_equal(without["trials"], with_force["trials"])
    pd.testing.assert_frame_equal(without["points"], with_force["points"])
    pd.testing.assert_frame_equal(without["models"], with_force["models"])
