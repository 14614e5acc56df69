"""Records of a motion that nothing drives, of signals beside the plant's, and of inputs with gaps."""

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.report_text import describe_forgotten
from stages.science.output_channels.whole_record_channel import build_whole_records
from stages.science.plant.record_plant import read_initial_state
from tests.science.discrepancy.searches import DISCREPANCY, look
from tests.science.discrepancy.simulated_records import build_records, tabulate
from tests.science.plant.machines import read_plant

STEP_S, HERTZ, DAMPING, NOISE_RAD = 0.01, 1.1, 0.02, 0.004
RELEASES, SAMPLES = 8, 600


def release(generator, friction):
    """An angle from a release at rest, by Euler's rule in a hundred steps from sample to sample."""
    omega, angle, rate, found = 2.0 * np.pi * HERTZ, generator.choice([-1, 1]) * generator.uniform(0.6, 1.2), 0.0, []
    for _ in range(SAMPLES):
        found.append(angle)
        for _ in range(100):
            pull = omega**2 * (angle + friction * np.tanh(rate / 0.02)) + 2.0 * DAMPING * omega * rate
            rate -= 0.01 * STEP_S * pull
            angle += 0.01 * STEP_S * rate
    return np.array(found) + NOISE_RAD * generator.standard_normal(SAMPLES)


def release_all(generator, friction):
    """Return the channel of some releases, two blocks each."""
    rows, blocks = [], []
    for k in range(RELEASES):
        time, half = np.arange(SAMPLES) * STEP_S, SAMPLES // 2
        signal = {"record": f"run{k}", "time_s": time, "signal": "angle_rad", "value": release(generator, friction)}
        rows.append(pd.DataFrame(signal))
        blocks += [{"record": f"run{k}", "start_s": start * STEP_S, "samples": half} for start in (0, half)]
    plant = read_plant("second_order", input="nothing", output="angle_rad")
    return build_whole_records(pd.concat(rows), pd.DataFrame(blocks), plant, DISCREPANCY.detection)


@pytest.mark.parametrize("seed", range(4))
def test_how_a_bent_motion_begins_is_told_within_its_errors(seed):
    generator = np.random.default_rng(seed)
    time = np.arange(50) * STEP_S
    heads = [0.8 * np.cos(6.9 * time) + NOISE_RAD * generator.standard_normal(50) for _ in range(200)]
    begun = read_initial_state(heads, STEP_S)
    assert ((begun.value - 0.8) / begun.value_error).std() < 1.5  # as the samples that count were chosen by them
    assert (begun.rate == 0.0).mean() > 0.94  # what is within three errors of rest is at rest
    assert begun.value_error.mean() < NOISE_RAD


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "names"), [(0.03, ["coulomb_friction"]), (0.0, [])])
def test_the_friction_of_a_free_decay_is_named_and_its_damping_is_none(friction, names, generator):
    output = release_all(generator, friction)
    found, _ = look(output)
    verdict = decide(found, DISCREPANCY, generator)
    assert [each.name for each in verdict.effects] == names
    left = np.sqrt(verdict.steps[-1][0].raw.sum() / output.present.sum())
    assert left == pytest.approx(NOISE_RAD, rel=0.25)


def drive_lag(generator, samples=4000):
    command = np.cumsum(generator.standard_normal(samples)) / 20.0
    pressure, answer = 0.0, np.empty(samples)
    for k in range(samples):
        answer[k] = pressure
        pressure += 0.02 / 0.3 * (50.0 * command[k] - pressure)
    return {"command_v": command, "pressure_kpa": answer + 0.2 * generator.standard_normal(samples)}


def test_signals_that_the_plant_does_not_name_are_looked_at_beside_it_unless_they_stand_still(generator):
    signals = drive_lag(generator) | {"room_degc": np.linspace(20.0, 21.0, 4000), "still_v": np.full(4000, 3.0)}
    output = build_records(*tabulate(signals, 0.02), read_plant("first_order"))
    assert [each.name for each in output.drivers() if not each.own] == ["room_degc"]
    assert "command_v" in [each.name for each in output.drivers() if each.own]


def test_samples_that_a_gap_leaves_unjudged_are_counted_and_told(generator):
    signals = drive_lag(generator)
    signals["command_v"][1000:1100] = np.nan
    output = build_records(*tabulate(signals, 0.02), read_plant("first_order"))
    lost = output.measured.size - int(output.present.sum())
    assert output.forgotten == lost > 0
    (told,) = describe_forgotten(output, output.plant, 0.02)
    assert told.startswith(
        f"Of {output.measured.size} samples of pressure_kpa, {lost} are not judged: after a value of command_v"
    )
    assert describe_forgotten(output, output.plant, 0.9) == []
