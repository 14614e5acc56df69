"""Readings that are repeated, stuck, or far from those around are told, and sound ones are not."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.odd_readings import find_apart, note_odd_readings


def make_signal(generator, samples=4000):
    time_s = 0.005 * np.arange(samples)
    return time_s, 20.0 * np.sin(2.0 * np.pi * 0.7 * time_s) + 0.1 * generator.standard_normal(samples)


def note(time_s, values, record="a"):
    return note_odd_readings(pd.DataFrame({"record": record, "time_s": time_s, "force_n": values}), ["force_n"])


def test_sound_readings_of_a_sensor_a_command_and_an_encoder_are_not_noted(generator):
    time_s, values = make_signal(generator)
    assert note(time_s, values) == []
    assert note(time_s, np.where(np.sin(time_s) > 0.0, 3.0, 1.0)) == []
    assert note(time_s, np.round(values)) == []
    resting = np.round(np.where(time_s < 10.0, values, 1.2), 1)
    assert note(time_s, resting) == []
    assert note(time_s, np.full(len(time_s), 3.0)) == []


def test_what_is_read_every_so_many_samples_is_late_by_half_of_that(generator):
    time_s, values = make_signal(generator)
    ((signal, told),) = note(time_s, np.repeat(values[::20], 20))
    assert signal == "force_n"
    assert told.startswith("each reading is repeated 20 times")
    assert "it is 0.0475 s late" in told


def test_what_is_stuck_is_told_with_its_times_and_an_end_of_the_scale_is_not(generator):
    time_s, values = make_signal(generator)
    frozen = np.where((time_s >= 5.0) & (time_s < 8.0), values[1000], values)
    (told,) = note(time_s, frozen)
    assert told[1].startswith("600 equal readings of")
    assert "from 5 to 7.995 s" in told[1]
    assert note(time_s, np.minimum(values, 15.0)) == []


@pytest.mark.parametrize("count", [1, 25])
def test_single_readings_far_from_those_around_are_found_where_they_are(generator, count):
    time_s, values = make_signal(generator)
    places = np.sort(generator.choice(np.arange(10, 3990, 10), count, replace=False))
    values[places] += generator.choice([-50.0, 50.0], count)
    np.testing.assert_array_equal(find_apart(values), places)
    (told,) = note(time_s, values, ["a"] * 2000 + ["b"] * 2000)[:1]
    assert "far from those around, by up to " in told[1]
    assert told[1].endswith(("of record a", "of record b"))


@pytest.mark.parametrize(("factor", "noted"), [(1e-3, True), (1e3, True), (0.05, False)])
def test_a_record_in_another_unit_is_told(generator, factor, noted):
    time_s, values = make_signal(generator, 1000)
    frames = [
        pd.DataFrame({"record": name, "time_s": time_s, "force_n": values * (factor if name == "c" else 1.0)})
        for name in "abcd"
    ]
    told = note_odd_readings(pd.concat(frames), ["force_n"])
    wanted = [("force_n", f"range in record c {factor:.2g} times that in most: is it in another unit?")]
    assert told == (wanted if noted else [])
