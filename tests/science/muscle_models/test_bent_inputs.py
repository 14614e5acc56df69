"""What a bent movement would show, against features of that very movement; and a search whose best is known."""

import numpy as np
import pandas as pd
import pytest

from stages.science.muscle_models.bent_inputs import Movement, Search
from stages.science.muscle_models.inputs import FEATURES, InputConstants, ModelSettings
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.bending import Bending
from stages.science.signals.scaling import MODEL_INPUTS, Scaling

RATE_HZ, SAMPLES, PER_RAD = 100.0, 400, {"pam1": -0.12, "pam2": 0.14}
MODEL = ModelSettings(
    inputs=list(FEATURES),
    constants=InputConstants(stop_width=0.015, stop_ratio=3.0, highpass_s=1.0, direction_per_s=0.02),
)
COLUMNS = tuple(each.column for each in MODEL.features)
TIME_S = np.arange(SAMPLES) / RATE_HZ


def make_rows(angle, commands):
    frames = [
        pd.DataFrame(
            {
                "trajectory": 0,
                "muscle": muscle,
                "time_s": TIME_S,
                "pressure_command_kpa": command,
                "joint_angle_rad": angle,
                "pressure_kpa": command,
                "contraction": 0.1 + PER_RAD[muscle] * angle,
                "contraction_velocity_per_s": PER_RAD[muscle] * np.gradient(angle, 1.0 / RATE_HZ),
            }
        )
        for muscle, command in commands.items()
    ]
    return MODEL.extend(pd.concat(frames, ignore_index=True), ["trajectory"])


ANGLE = 0.5 + 0.3 * np.sin(3.0 * TIME_S)
COMMANDS = {"pam1": 150.0 + 60.0 * np.cos(2.0 * TIME_S), "pam2": 300.0 + 100.0 * np.sin(1.5 * TIME_S)}
ROWS = make_rows(ANGLE, COMMANDS)
THINNED = ROWS[ROWS.groupby("muscle").cumcount() % 4 == 0]
SCALING = Scaling(COLUMNS, np.arange(10.0), 1.0 + np.arange(10.0), 0.0, 1.0)


@pytest.mark.parametrize("muscle", list(PER_RAD))
def test_inputs_are_those_of_the_bent_movement(muscle):
    change, command = 0.2 * np.cos(1.3 * TIME_S) + 0.1 * TIME_S, COMMANDS[muscle] + 30.0 * np.sin(TIME_S)
    rows = ROWS[ROWS["muscle"] == muscle]
    signals = {name: rows[name].to_numpy() for name in COLUMNS}
    movement = Movement(PER_RAD[muscle], COMMANDS[muscle], signals, 1, 1.0 / RATE_HZ, SCALING, MODEL)
    bent = make_rows(ANGLE + change, {muscle: command})
    np.testing.assert_allclose(movement.foresee(change, command), SCALING.inputs_of(bent), atol=1e-9)
    np.testing.assert_allclose(movement.foresee(0.0 * change, COMMANDS[muscle]), SCALING.inputs_of(rows), atol=1e-12)
    own = Scaling(COLUMNS[1:2], SCALING.input_centre[1:2], SCALING.input_scale[1:2], 0.0, 1.0)
    alone = Movement(PER_RAD[muscle], COMMANDS[muscle], signals, 1, 1.0 / RATE_HZ, own, MODEL)
    np.testing.assert_allclose(alone.foresee(change, command), own.inputs_of(bent), atol=1e-9)
    fewer = {name: each[::4] for name, each in signals.items()}
    thinned = Movement(PER_RAD[muscle], COMMANDS[muscle], fewer, 4, 4.0 / RATE_HZ, SCALING, MODEL)
    expected = SCALING.restore_inputs(SCALING.inputs_of(bent)[::4])
    found = SCALING.restore_inputs(thinned.foresee(change, command))
    off = np.sqrt(((found - expected) ** 2).mean(axis=0)) / expected.std(axis=0)
    assert off.max() < 0.03


def make_search(weigh):
    references = ROWS[["trajectory", "muscle", "time_s", "pressure_command_kpa", "joint_angle_rad"]]
    wide = references.assign(trajectory=1, pressure_command_kpa=references["pressure_command_kpa"] * 1.5 - 60.0)
    bank = pd.concat([references, wide], ignore_index=True)
    bending = Bending.read(bank, dict.fromkeys(PER_RAD, "EFE"), SAMPLES, 3)
    names, hyperparameters = list(PER_RAD), []
    muscles = MuscleSet(names, hyperparameters, [0, 1], [SCALING, SCALING], [], [])
    return references, Search(bending, PER_RAD, muscles, MODEL, weigh)


def test_pressures_are_bent_towards_what_tells_most_and_by_muscle():
    """A muscle tells most at 40 kPa above its own pressure, the other one anywhere; neither cares for the angle."""
    wanted = (COMMANDS["pam1"] + 40.0 * np.minimum(TIME_S, 1.0))[::4]

    def weigh(place, inputs):
        off = SCALING.restore_inputs(inputs)[:, COLUMNS.index(MODEL_INPUTS[0])] - wanted
        return 0.0 if place else -float(np.mean(off**2))

    rows, search = make_search(weigh)
    found = [search.run(rows, THINNED, 5, 600, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    (changes, gained), (again, _), (other, _) = found
    assert set(changes) == {"pam1"}
    np.testing.assert_array_equal(changes["pam1"], again["pam1"])
    assert (changes["pam1"] != other["pam1"]).any()
    before = weigh(0, SCALING.inputs_of(THINNED[THINNED["muscle"] == "pam1"]))
    bent = search.bending.bend(rows, changes)
    command = bent.loc[bent["muscle"] == "pam1", "pressure_command_kpa"].to_numpy()
    assert gained == pytest.approx(-before - np.mean((command[::4] - wanted) ** 2))
    assert gained > 0.9 * -before


def test_a_reference_is_bent_for_all_muscles_of_its_joint():
    contraction = COLUMNS.index("contraction")

    def weigh(place, inputs):
        moved = SCALING.restore_inputs(inputs)[:, contraction]
        return float(np.std(moved)) * (2.0 if place else 1.0)

    rows, search = make_search(weigh)
    changes, gained = search.run(rows, THINNED, 4, 200, np.random.default_rng(0))
    assert set(changes) == {"EFE"}
    assert gained > 0.0
    bent = search.bending.bend(rows, changes)["joint_angle_rad"].to_numpy()[:SAMPLES]
    assert bent.std() > ANGLE.std()
    assert bent.max() <= ANGLE.max() + 1e-9
