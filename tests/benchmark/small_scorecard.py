"""The small scorecard, which is made once for all tests."""

import pandas as pd
import pytest
import yaml

from tests.conftest import ROOT, Command

SESSIONS = yaml.safe_load((ROOT / "conf" / "blinded_suite" / "small.yaml").read_text())["sessions"]
FEW = ("blinded_suite=small", "rig.trials=12", "inverse_crime_check.effects=[leakage]", "figures=[png]")


def score(folder):
    """Run the small scorecard in a folder; return its tables."""
    command = Command(folder / "outputs")
    result = command("workflow=scorecard", *FEW)
    assert result.returncode == 0, result.stderr
    return read(folder)


def read(folder):
    (run,) = Command(folder / "outputs").runs
    return {path.stem: pd.read_parquet(path) for path in (run / "tables").iterdir()}


@pytest.fixture(scope="session")
def scored(make_once):
    """The tables of the small scorecard."""
    return read(make_once("small scorecard", score))


def describe_scored(tables, name):
    """Return what is said of a session there, as `describe` does of others."""
    said = tables["blind_sessions"].set_index("session").loc[name]
    named = tables["blind_named"].query("session == @name and not suspected").drop_duplicates("name")
    return {
        "status": str(said["status"]),
        "named": {each.name: round(float(each.probability), 2) for each in named.itertuples(index=False)},
        "seen_in": {each.name: str(each.channel) for each in named.itertuples(index=False)},
        "left": {str(said["unexplained_channel"]): str(said["family"])} if said["unknown"] > 0.5 else {},
    }
