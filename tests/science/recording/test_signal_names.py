"""What signals are called: words, and the unit once."""

import pytest

from stages.science.recording.signal_names import label, name_signal, per_second


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("force_n", "force (N)"),
        ("pressure_kpa", "pressure (kPa)"),
        ("pressure_command_kpa", "command (kPa)"),
        ("contraction_velocity_per_s", "velocity (1/s)"),
        ("time_s", "time in the trial (s)"),
        ("speed_rad_per_s", "speed (rad/s)"),
        ("temp_degc", "temp (degC)"),
        ("torque_nm", "torque (N m)"),
        ("simulated pos_m", "simulated pos (m)"),
        ("p_cap_kpa - p_rod_kpa", "p cap - p rod (kPa)"),
        ("distance by contraction_velocity_per_s", "distance by velocity"),
        ("rate of p_cap_kpa - p_rod_kpa", "rate of p cap - p rod"),
        ("level", "level"),
    ],
)
def test_an_axis_says_a_signal_in_words_and_its_unit_once(name, said):
    assert label(name) == said
    words, unit = name_signal(name)
    assert said == (f"{words} ({unit})" if unit else words)


def test_a_unit_that_the_name_does_not_tell_can_be_given():
    assert label("contraction", "1") == "contraction (1)"
    assert label("rate of stroke_m", per_second("m")) == "rate of stroke (m/s)"
    assert [per_second(unit) for unit in ("rad/s", "N m", "")] == ["rad/s^2", "N m/s", "1/s"]
