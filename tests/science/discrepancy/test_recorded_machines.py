"""Records of machines that others measured, by a column map alone: what is named, and what it leaves where not fitted.

Tanks of Schoukens and Noel, a joint of Wang and Realmuto, a drive of Janot, Gautier and Brunot, a belt of Wigren and
Schoukens: data of theirs, which are not part of this project.
"""

import functools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.fitted_channel import prepare
from stages.science.discrepancy.search import search
from stages.science.plant.machine import read_machine
from tests.composing import compose_values
from tests.science.discrepancy.searches import DISCREPANCY, SETTINGS, look, run_records
from tests.science.discrepancy.simulated_records import build_records, tabulate

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
TANKS = DATA / "cascaded_tanks" / "cascaded_tanks.parquet"
JOINT = DATA / "pam_antagonistic_ucr" / "pam_antagonistic_ucr.parquet"
DRIVE = DATA / "emps" / "emps.parquet"
BELT = DATA / "coupled_drives" / "ced_prbs_1p0V.parquet"
MAPS = {
    TANKS: ["+columns.pump_v=u", "+columns.level_v=y", "plant=cascaded_tanks"],
    JOINT: [
        "+columns.force_n=force_N",
        "+columns.position_m=x_m",
        "plant=static_map",
        "plant.along=force_n",
        "plant.output=position_m",
        "plant.constants.stiffness.of=[force_n]",
        "parts.last_share=0.4",
        "measurement.blocks=20",
    ],
    DRIVE: ["+columns.force_n=force", "+columns.position_m=qm", "plant=servo_drive"],
    BELT: [
        "columns.time_s=time_s",
        "+columns.drive_v=motor_voltage_V",
        "+columns.speed_v=pulley_speed_sensor_V",
        "plant=belt_drive",
        "plant.output=speed_v",
        "parts.last_share=0.4",
    ],
}
PUBLISHED_MASS = 95.1  # Janot, Gautier and Brunot 2019
PARTS = ["parts.fitted=[est]", "parts.verification=[val]"]

pytestmark = pytest.mark.skipif(not DATA.exists(), reason=f"recorded data of others are needed at {DATA}")


def run(pamid, path, *more):
    """Return names with probabilities, status, and RMSE over deviation before and after where not fitted."""
    verdict = run_records(pamid, path, *MAPS[path], *more)[1]
    table = pd.read_parquet(pamid.runs[0] / "tables" / "verification.parquet")
    opened = table[(table["part"] == "verification") & (table["label"] != "noise floor")]["gap_over_std"]
    return {each["name"]: each["probability"] for each in verdict["effects"]}, verdict["status"], opened.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "parts", "told", "before", "after"),
    [
        (TANKS, PARTS, {"saturation", "overflow"}, 0.3, 0.175),
        (JOINT, [], {"hysteresis"}, 0.3, 0.099),
        (DRIVE, PARTS, {"coulomb_friction", "viscous_friction"}, 1.0, 0.09),
    ],
    ids=["tanks are full and run over", "a joint sticks where the force turns", "a drive rubs"],
)
def test_what_a_machine_does_is_named_and_taken_away(path, parts, told, before, after, pamid):
    names, status, left = run(pamid, path, *parts)
    assert (status, set(names)) == ("named", told)
    assert left[0] > before
    assert left[-1] < after
    values = pd.read_parquet(pamid.runs[0] / "tables" / "amended_values.parquet").set_index("parameter")["value"]
    assert path != DRIVE or values["mass"] == pytest.approx(PUBLISHED_MASS, rel=0.1)


@pytest.mark.slow
def test_a_counter_that_does_not_see_which_way_a_pulley_turns(pamid):
    names, status, left = run(pamid, BELT)
    assert (status, set(names)) == ("named", {"sign_blind_sensor"})
    assert left[0] > 1.0
    assert left[-1] < 0.25


@pytest.mark.slow
def test_without_hysteresis_no_other_name_is_sure(pamid):
    names, _, _ = run(pamid, JOINT, "discrepancy.search.left_out=[hysteresis,coulomb_friction]")
    assert max(names.values(), default=0.0) < 0.8


@functools.cache
def fit_textbook(path):
    """Return a recording's machine, and its textbook as it is fitted to what there is for it."""
    told = compose_values("workflow=discrepancy", "measurement=records", *MAPS[path])
    frame = pd.read_parquet(path)
    frame = frame[frame["part"] == "est"] if "part" in frame else frame
    signals = {name: frame[column].to_numpy(float) for name, column in told.columns.items() if column is not None}
    plant = read_machine(OmegaConf.to_container(told.plant))
    return plant, prepare(build_records(*tabulate(signals, float(np.median(np.diff(frame["t"])))), plant))


@pytest.mark.slow
@pytest.mark.parametrize(("left_out", "said"), [(["overflow"], ["saturation"]), (["saturation", "overflow"], [])])
def test_without_its_effects_a_gap_of_the_tanks_has_no_other_name(left_out, said, generator):
    found = search([fit_textbook(TANKS)[1]], SETTINGS.model_copy(update={"left_out": left_out}), generator)
    assert [each.name for each in found.named] == said
    assert said or decide(found, DISCREPANCY, generator).unknown > 0.5
    (state,) = found.outputs
    left = np.sqrt(state.current.raw.sum() / state.samples.sum())
    assert left > 0.25 * state.output.measured[state.output.present].std()


@pytest.mark.slow
@pytest.mark.parametrize("path", [TANKS, JOINT, DRIVE], ids=["tanks", "joint", "drive"])
def test_nothing_is_named_in_what_the_fitted_textbook_simulates(path):
    plant, state = fit_textbook(path)
    output, nominal = state.output, state.nominal.fit
    refined = output.plant.refine({name: values[:, None] for name, values in output.records[0].items()}, output.step_s)
    constants = nominal.model.name_values(nominal.values)[0]
    clean = output.plant.simulate(refined, output.step_s, np.zeros(1), constants, (), output.begun[0])[:, 0]
    noise = 0.01 * clean.std() * np.random.default_rng(0).standard_normal(len(clean))
    copied = {**output.records[0], output.plant.output: clean + noise}
    assert look(build_records(*tabulate(copied, step_s=output.step_s), plant))[1] == []
