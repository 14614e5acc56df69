import re

import numpy as np
import pytest

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.contract import tidy
from stages.science.rig.excitation import (
    Durations,
    FreeMovements,
    Movement,
    MovementKind,
    Pressure,
    Range,
    check_levels,
    check_ranges,
    move_freely,
)
from stages.science.rig.limits import PressureLimit
from stages.science.rig.trial import Trial
from tests.science.plant.machines import configured, other_machine

RANGES = {
    "pam4": Range(low=50.0, high=600.0),
    "pam1": Range(low=20.0, high=200.0),
    "pam3": Range(low=20.0, high=150.0),
    "pam2": Range(low=80.0, high=500.0),
}


def make_pressure(ranges=RANGES, hold=(0.3, 1.2), transition=(0.2, 0.8), step_share=0.25):
    return Pressure(
        range_kpa=ranges,
        hold_s=Durations(low=hold[0], high=hold[1]),
        transition_s=Durations(low=transition[0], high=transition[1]),
        step_share=step_share,
    )


def test_draws_each_muscle_within_its_own_range_whatever_the_order_of_the_ranges(generator):
    rig = configured()
    command = np.concatenate([make_pressure().draw(rig, generator) for _ in range(30)])
    for column, name in enumerate(rig.muscles):
        low, high = RANGES[name].low, RANGES[name].high
        assert command[:, column].min() >= low
        assert command[:, column].max() <= high
        assert np.ptp(command[:, column]) > 0.9 * (high - low)


def test_the_mean_level_is_that_of_what_is_drawn(generator):
    rig, pressure = configured(), make_pressure(hold=(0.1, 0.3), transition=(0.02, 0.1), step_share=0.5)
    runs, trials = 0, 40
    for _ in range(trials):
        command = pressure.draw(rig, generator)
        still = np.abs(np.diff(command, axis=0)) < 1e-9
        runs += (still[1:] & ~still[:-1]).sum() + still[0].sum()
    drawn_s = trials * rig.samples * len(rig.muscles) / rig.sampling_rate_hz / runs
    assert drawn_s == pytest.approx(pressure.mean_level_s, rel=0.05)
    assert pressure.mean_level_s == pytest.approx(0.2 + 0.5 * 0.06, rel=1e-12)


def test_records_what_the_rig_returns_for_a_free_trial_of_the_experimenter():
    movements = FreeMovements(seed=1, trajectories=3, kinds=None, pressure=make_pressure())
    with configured() as rig:
        found = movements.record(2, rig, np.random.default_rng(7), "bank 2")
        generator = np.random.default_rng(7)
        trial = Trial("free", "experimenter", movements.pressure.draw(rig, generator))
        expected = tidy(rig.execute(trial, generator), rig)
    assert list(found) == ["trajectory", *expected]
    assert (found["trajectory"] == 2).all()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"trajectories": 12501},
            "there.trajectories: expected at most 12500 movements of 1000 samples and 4 muscles, as 50000000 rows "
            "still fit in memory, got 12501; lower it, exoskeleton.trial_s or exoskeleton.sampling_rate_hz",
        ),
        (
            {"pressure": make_pressure(hold=(0.0, 0.001), transition=(0.0, 0.0))},
            "there.pressure.hold_s: expected levels that, with transition_s, last a sample (0.004 s) on average, got "
            "0.0005 s; raise there.pressure.hold_s.high or there.pressure.transition_s.high",
        ),
        (
            {"pressure": make_pressure({name: RANGES[name] for name in ("pam1", "pam3")})},
            "there.pressure.range_kpa: expected a range for every muscle, none for pam2, pam4",
        ),
    ],
)
def test_what_does_not_fit_the_machine_is_refused_by_the_key_of_the_section(change, told):
    section = {"seed": 1, "trajectories": 12500, "kinds": None, "pressure": make_pressure()}
    movements = FreeMovements(**(section | change))
    with pytest.raises(ValueError, match=f"^{re.escape(told)}$"):
        movements.check_against(configured().exoskeleton, "there")


@pytest.mark.parametrize(
    ("ranges", "told"),
    [
        ({**RANGES, "pam5": RANGES["pam1"]}, "there: no muscle 'pam5'; did you mean 'pam4'?"),
        ({**RANGES, "pam1": Range(low=0.0, high=0.0)}, "there.pam1.high: expected more than 0, as a vented muscle"),
    ],
)
def test_ranges_are_those_of_muscles_that_pull(ranges, told):
    with pytest.raises(ValueError, match=f"^{re.escape(told)}"):
        check_ranges(ranges, configured().exoskeleton, "there")


def test_levels_end_at_the_rigs_limits_or_else_at_the_muscles():
    exoskeleton: Exoskeleton = configured().exoskeleton
    limits, tight = (
        {
            "MAS-40": PressureLimit(low_kpa=0.0, high_kpa=200.0, slew_kpa_per_s=1e4),
            "MAS-10": PressureLimit(low_kpa=low, high_kpa=600.0, slew_kpa_per_s=1e4),
        }
        for low in (50.0, 60.0)
    )
    wide, widest = ({**RANGES, "pam4": Range(low=50.0, high=high)} for high in (700.0, 900.0))
    check_levels(RANGES, exoskeleton, limits, "there")
    check_levels(wide, exoskeleton, None, "there")
    for ranges, those, told in (
        (RANGES, tight, "low: expected at least the 60.0 kPa of rig.limits.MAS-10.low"),
        (wide, limits, "high: expected at most the 600.0 kPa of rig.limits.MAS-10.high"),
        (widest, None, "high: expected at most the 800.0 kPa of max_pressure_kpa of pa"),
    ):
        with pytest.raises(ValueError, match=f"^there.pam4.{told}"):
            check_levels(ranges, exoskeleton, those, "there")


@pytest.mark.parametrize("machine", [configured().exoskeleton, other_machine([1, 3], 100.0, 1.0)])
def test_machines_with_other_muscles_are_served(machine):
    ranges = dict.fromkeys(machine.muscle_names, RANGES["pam1"])
    FreeMovements(seed=1, trajectories=40, kinds=None, pressure=make_pressure(ranges)).check_against(machine, "there")


def test_free_movements_span_the_share_of_each_joints_range_about_its_middle(generator):
    machine = configured().exoskeleton
    times = {"shortest_move_s": 0.2, "longest_move_s": 0.2, "shortest_rest_s": 0.1, "longest_rest_s": 0.1}
    movement = Movement(**times, range_share=0.5)
    angle = np.concatenate([move_freely(movement, machine, 2000, generator) for _ in range(4)])
    for column, joint in enumerate(machine.joints):
        middle, width = (joint.lower_rad + joint.upper_rad) / 2.0, joint.upper_rad - joint.lower_rad
        assert np.abs(angle[:, column] - middle).max() <= width / 4.0
        assert np.ptp(angle[:, column]) > 0.45 * width


def make_kinds(**kinds):
    common = {
        "range_ratio": 1.0,
        "duration_ratio": 1.0,
        "rest_ratio": 1.0,
        "pressures": "independent",
        "instruction": "move",
    }
    return {name: MovementKind(**(common | each)) for name, each in kinds.items()}


def test_kinds_of_movement_differ_from_natural_ones_as_they_say():
    kinds = make_kinds(
        natural={"share": 0.16},
        small={"share": 0.14, "range_ratio": 0.2},
        slow={"share": 0.14, "duration_ratio": 20.0, "rest_ratio": 20.0},
        held={"share": 0.14, "pressures": "constant"},
        wide={"share": 0.14, "range_ratio": 2.0},
        resting={"share": 0.14, "rest_ratio": 100.0},
        opposed={"share": 0.14, "pressures": "opposed"},
    )
    movements = FreeMovements(seed=1, trajectories=28, kinds=kinds, pressure=make_pressure())
    span, speed, swing = ({name: [] for name in kinds} for _ in range(3))
    with configured() as rig:
        for trajectory in range(28):
            found = movements.record(trajectory, rig, np.random.default_rng(trajectory), "bank")
            name = next(each for each in kinds if kinds[each] == movements.find_kind(trajectory))
            its = found["time_s"] >= 0.0
            angle, command = (found[each][its].reshape(4, -1) for each in ("joint_angle_rad", "pressure_command_kpa"))
            span[name].append(np.ptp(angle, axis=1).mean())
            speed[name].append(np.abs(found["joint_velocity_rad_per_s"][its]).mean())
            swing[name].append(np.ptp(command, axis=1).max())
            if name == "opposed":
                assert np.corrcoef(command) == pytest.approx(np.outer([1, -1, 1, -1], [1, -1, 1, -1]), abs=0.01)
    assert {len(each) for each in span.values()} == {4}
    assert np.mean(span["small"]) < 0.5 * np.mean(span["natural"])
    assert np.mean(speed["slow"]) < 0.5 * np.mean(speed["natural"])
    assert max(swing["held"]) < 0.05 * min(swing["natural"])
    assert np.mean(span["wide"]) > 1.05 * np.mean(span["natural"])
    assert np.mean(speed["resting"]) < 0.7 * np.mean(speed["natural"])


def test_co_contracted_pressures_rise_and_fall_together_within_each_muscles_range(generator):
    (kind,) = make_kinds(held={"share": 1.0, "pressures": "together"}).values()
    ranges = [RANGES[name] for name in configured().muscles]
    drawn = make_pressure().draw(configured(), generator)
    found = kind.shape(drawn, ranges, [True, False, True, False])
    shares = (found - [each.low for each in ranges]) / [each.high - each.low for each in ranges]
    np.testing.assert_allclose(found[:, 0], drawn[:, 0], rtol=1e-12)
    np.testing.assert_allclose(shares, np.repeat(shares[:, :1], 4, axis=1), atol=1e-12)
    assert np.ptp(shares) > 0.3


def test_any_first_part_of_a_set_has_the_shares_of_its_kinds():
    kinds = make_kinds(rare={"share": 0.1}, usual={"share": 0.6}, other={"share": 0.3})
    movements = FreeMovements(seed=1, trajectories=100, kinds=kinds, pressure=make_pressure())
    found = [movements.find_kind(each) for each in range(100)]
    for kind in kinds.values():
        counted = np.cumsum([each == kind for each in found])
        assert np.abs(counted - kind.share * np.arange(1, 101)).max() <= 1.0
    with pytest.raises(ValueError, match=r"kinds: expected shares that add up to 1, got 0\.9"):
        FreeMovements(seed=1, trajectories=3, kinds=make_kinds(a={"share": 0.9}), pressure=make_pressure())
