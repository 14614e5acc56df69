"""Features of a recording's past, against closed forms."""

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from stages.science.muscle_models.inputs import FEATURES, InputConstants, ModelSettings

CONSTANTS = InputConstants(stop_width=0.02, stop_ratio=4.0, highpass_s=0.5, direction_per_s=0.1)
STEP_S = 0.01


def make_recording(contraction, pressure=None, trajectory=0, muscle="pam1"):
    time_s = STEP_S * np.arange(len(contraction))
    return pd.DataFrame(
        {
            "trajectory": trajectory,
            "muscle": muscle,
            "time_s": time_s,
            "pressure_kpa": np.full(len(time_s), 100.0) if pressure is None else pressure,
            "contraction": contraction,
            "contraction_velocity_per_s": np.gradient(contraction, STEP_S),
        }
    )


def extend(recording, *inputs):
    return ModelSettings(inputs=list(inputs), constants=CONSTANTS).extend(recording, ["trajectory"])


@pytest.mark.parametrize(
    ("name", "width"),
    [("contraction_stop_narrow", 0.005), ("contraction_stop", 0.02), ("contraction_stop_wide", 0.08)],
)
def test_a_stop_follows_contraction_after_a_reversal_and_ends_at_its_width(name, width):
    there, back = np.linspace(0.1, 0.2, 51), np.linspace(0.2, 0.1, 51)[1:]
    found = extend(make_recording(np.concatenate([there, back])), name)[name].to_numpy()
    moved = np.concatenate([there - 0.1, width - (0.2 - back)])
    np.testing.assert_allclose(found[:51], np.minimum(moved[:51], width), atol=1e-12)
    np.testing.assert_allclose(found[51:], np.maximum(moved[51:], -width), atol=1e-12)


def test_a_high_pass_forgets_a_step_with_its_time_constant():
    contraction, pressure = np.full(200, 0.1), np.full(200, 100.0)
    contraction[50:], pressure[50:] = 0.15, 160.0
    found = extend(make_recording(contraction, pressure), "contraction_highpass", "pressure_highpass")
    left = np.where(np.arange(200) < 50, 0.0, np.exp(-STEP_S * (np.arange(200) - 49) / 0.5))
    np.testing.assert_allclose(found["contraction_highpass"], 0.05 * left, atol=1e-12)
    np.testing.assert_allclose(found["pressure_highpass_kpa"], 60.0 * left, atol=1e-9)


def test_direction_and_rate_are_of_the_instant():
    contraction, pressure = 0.1 + 0.05 * STEP_S * np.arange(100), 100.0 - 20.0 * STEP_S * np.arange(100)
    found = extend(make_recording(contraction, pressure), "direction", "pressure_rate")
    np.testing.assert_allclose(found["direction"], np.tanh(0.5), rtol=1e-9)
    np.testing.assert_allclose(found["pressure_rate_kpa_per_s"], -20.0, rtol=1e-9)


def test_every_trial_and_muscle_begins_anew(generator):
    walks = [0.1 + np.cumsum(0.005 * generator.standard_normal(80)) for _ in range(4)]
    places = [(0, "pam1"), (0, "pam2"), (1, "pam1"), (1, "pam2")]
    recordings = [make_recording(walk, None, *place) for walk, place in zip(walks, places, strict=True)]
    features = [name for name, each in FEATURES.items() if each.follow is not None]
    together = extend(pd.concat(recordings, ignore_index=True), *features)
    alone = pd.concat([extend(each, *features) for each in recordings], ignore_index=True)
    pd.testing.assert_frame_equal(together, alone)


def test_measured_inputs_leave_a_recording_as_it_is():
    recording = make_recording(np.linspace(0.1, 0.2, 10))
    assert extend(recording, "contraction", "pressure") is recording


@pytest.mark.parametrize(
    ("inputs", "told"),
    [(["pressure", "pressure"], r"set model\.inputs=\[pressure\]"), (["weight"], "should be"), ([], "at least 1")],
)
def test_inputs_that_make_no_sense_are_refused(inputs, told):
    with pytest.raises(ValidationError, match=told):
        ModelSettings(inputs=inputs, constants=CONSTANTS)
