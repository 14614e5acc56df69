"""The design never sees the bank's force."""

import numpy as np
import pandas as pd

from tests.studies import read_stages, run_stage

UNTIL_CHOSEN = ["subsampling", "hyperprior", "hardware", "active_loop"]


def read(run, table):
    return pd.read_parquet(run / "tables" / f"{table}.parquet")


def test_picks_are_the_same_with_the_force_of_the_bank_set_to_nan(shared_run, tmp_path):
    (run,) = shared_run.runs
    study, stages = read_stages(["bank", *UNTIL_CHOSEN])
    tables = {"bank": read(run, "bank").assign(force_n=np.nan)}
    for name in UNTIL_CHOSEN:
        tables.update(run_stage(study, stages[name], tmp_path, tables))
    assert tables["bank"]["force_n"].isna().all()
    for name in ("trials", "points", "models"):
        pd.testing.assert_frame_equal(tables[name], read(run, name), check_exact=True)
