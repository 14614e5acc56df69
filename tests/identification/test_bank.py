"""The second bank: of the same kind as the first, none of its movements, and refused in words of its own."""

import numpy as np
import pytest

from stages.science.signals.lead_in import leave_out_lead_in
from tests.studies import assert_refused, read_stages, run_stage

BOTH = ["bank", "unseen_bank"]
MEASURED = ["pressure_kpa", "contraction", "force_n", "joint_angle_rad"]


@pytest.fixture(scope="module")
def banks(tmp_path_factory):
    study, stages = read_stages(BOTH, "+unseen_bank=default")
    folder = tmp_path_factory.mktemp("banks")
    return {name: run_stage(study, stages[name], folder, {})[name] for name in BOTH}


def movements(table, quantity):
    """Return (trajectories, muscles, samples)."""
    wide = table.pivot(index=["trajectory", "muscle"], columns="time_s", values=quantity)
    return wide.to_numpy().reshape(table["trajectory"].nunique(), table["muscle"].nunique(), -1)


def test_has_the_columns_and_the_size_of_the_bank(banks):
    assert list(banks["unseen_bank"].columns) == list(banks["bank"].columns)
    for name in ("trajectory", "muscle", "time_s"):
        np.testing.assert_array_equal(banks["unseen_bank"][name], banks["bank"][name])


@pytest.mark.parametrize("quantity", ["pressure_command_kpa", *MEASURED])
def test_every_movement_differs_from_every_one_of_the_bank(banks, quantity):
    seen, unseen = (movements(banks[name], quantity) for name in BOTH)
    apart = np.abs(unseen[:, None] - seen[None]).max(axis=-1)  # (unseen, seen, muscles)
    assert apart.shape == (8, 8, 4)
    assert (apart > 0.05 * np.ptp(seen, axis=(0, 2))).all()


def test_its_commands_span_the_ranges_of_the_bank(banks):
    command = leave_out_lead_in(banks["unseen_bank"]).groupby("muscle")["pressure_command_kpa"].agg(["min", "max"])
    for muscle, (low, high) in {"pam1": (20, 200), "pam2": (50, 600), "pam3": (20, 150), "pam4": (50, 600)}.items():
        assert low <= command.loc[muscle, "min"] < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < command.loc[muscle, "max"] <= high


def test_same_seed_same_movements_and_another_seed_others(banks, tmp_path):
    for number, (seed, same) in enumerate([(2000, True), (2001, False)]):
        study, stages = read_stages(BOTH, "+unseen_bank=default", f"unseen_bank.seed={seed}")
        again = run_stage(study, stages["unseen_bank"], tmp_path / str(number), {})["unseen_bank"]
        assert again.equals(banks["unseen_bank"]) == same


PRESSURE = (
    "{range_kpa: {pam1: {low: 20.0,high: 300.0},pam2: {low: 50.0,high: 600.0},pam3: {low: 20.0,high: 150.0},"
    "pam4: {low: 50.0,high: 600.0}},hold_s: {low: 0.3,high: 1.2},transition_s: {low: 0.2,high: 0.8},step_share: 0.25}"
)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("unseen_bank.seed=1000", "unseen_bank.seed: expected another seed than bank.seed, as its movements are to be"),
        ("unseen_bank.trajectories=1000000000", "unseen_bank.trajectories: expected at most 12500 movements of 1000"),
        (
            f"unseen_bank.pressure={PRESSURE}",
            "unseen_bank.pressure.range_kpa.pam1.high: expected at most the 250.0 kPa of rig.limits.MAS-40.high_kpa, "
            "got 300.0; lower it",
        ),
    ],
)
def test_refuses(override, told):
    assert_refused(BOTH, told, "+unseen_bank=default", override)


CHANGED = ["bank=natural", "+unseen_bank=default", "bank.trajectories=5", "bank.pressure.step_share=0.5"]


def test_follows_the_bank_where_it_is_not_told_otherwise():
    study, stages = read_stages(BOTH, *CHANGED)
    bank, unseen = study.config(stages["bank"]).bank, study.config(stages["unseen_bank"]).unseen_bank
    assert unseen == bank.model_copy(update={"seed": 2000})
    assert unseen.trajectories == 5
