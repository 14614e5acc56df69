"""A study whose trials are those of an earlier one: the same tables, and files that count in freshness."""

import pandas as pd
import pytest

from pipeline.plan import gather
from tests.studies import read_stages, run_stage

STAGES = ["bank", "subsampling", "hardware", "protocol"]
ORDER = ["bank", "subsampling", "protocol", "hardware"]
SMALL = ["+protocol=default", "protocol.experiments=2", "bank.trajectories=3", "exoskeleton.trial_s=1"]
TABLES = {"free": "bank", "tracked": "hardware_recordings", "passive": "protocol_recordings"}


def run(folder, *overrides):
    study, stages = read_stages(STAGES, *SMALL, *overrides)
    tables = {}
    for name in ORDER:
        tables.update(run_stage(study, stages[name], folder, tables))
    return tables


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Tables of a simulated study, and the overrides that replay it."""
    folder = tmp_path_factory.mktemp("recorded")
    tables = run(folder)
    paths = {kind: folder / f"{name}.parquet" for kind, name in TABLES.items()}
    for kind, path in paths.items():
        tables[TABLES[kind]].to_parquet(path)
    return tables, ["rig=replay", *(f"rig.recordings.{kind}={path}" for kind, path in paths.items())]


@pytest.mark.parametrize(
    "chosen",
    [
        ["rig.match=command"],
        ["rig.match={free: order, tracked: order, passive: order}", "bank.seed=99"],  # so that other ones are asked for
    ],
)
def test_a_study_is_replayed_from_its_own_tables(recorded, tmp_path, chosen):
    told, overrides = recorded
    found = run(tmp_path, *overrides, *chosen)
    for name in TABLES.values():
        pd.testing.assert_frame_equal(found[name], told[name])
    executed_by = told["executed_by"].assign(rig="ReplayRig", real=True)
    pd.testing.assert_frame_equal(found["executed_by"], executed_by)


def test_the_bytes_of_recordings_count_in_freshness(recorded, tmp_path):
    told, overrides = recorded
    path = tmp_path / "movements.parquet"
    told["bank"].to_parquet(path)
    study, stages = read_stages(STAGES, *SMALL, *overrides, f"rig.recordings.free=[{path}]")
    before = gather(study, stages["bank"], {})
    told["bank"].iloc[:-1].to_parquet(path)
    after = gather(study, stages["bank"], {})
    key = "rig.recordings.free.0/movements.parquet"
    assert before.inputs[key] != after.inputs[key]
    assert before.measured
