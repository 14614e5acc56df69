"""What is wrong with a sample, how a loop keeps its rate, and what a trial notes of one that does not."""

import signal

import numpy as np
import pandas as pd
import pytest

from stages.science.rig.festo.held_signals import hold_signals
from stages.science.rig.festo.logbook import Logbook
from stages.science.rig.festo.supervision import Sample, Supervisor
from stages.science.rig.limits import find_forbidden
from stages.science.rig.pacing import Tick, measure_pace, pace
from tests.cpx_e.rig import build_rig, describe_rig

RIG = build_rig(describe_rig(), 502)
CHANNELS = RIG.map_channels()
USUAL = (100.0, 300.0, 100.0, 300.0)


def make_supervisor(moved=True):
    return Supervisor(CHANNELS, RIG.device.counts, RIG.guard, moved)


def counts(generator, pressure=USUAL, force=(400.0, 100.0, 400.0, 100.0), angle=(0.5, 0.6)):
    """Counts of values with noise of some counts."""
    values = [
        *(value / 0.03125 for value in pressure),
        *(value / per for value, per in zip(force, (0.1, 0.025) * 2, strict=True)),
        *(value / 6.283185307e-4 for value in angle),
    ]
    return np.round(np.array(values) + generator.uniform(-8.0, 8.0, 10))


def look(supervisor, given, command=USUAL):
    """A sample a hundredth of a second after the one before."""
    supervisor.clock = getattr(supervisor, "clock", 0.0) + 0.01
    return supervisor.look(given, np.array(command), supervisor.clock)


def test_counts_become_values_and_commands_counts(generator):
    pressure, force, angle = CHANNELS.to_values(counts(generator))
    np.testing.assert_allclose(pressure, [100.0, 300.0, 100.0, 300.0], atol=0.3)
    np.testing.assert_allclose(force, [400.0, 100.0, 400.0, 100.0], atol=0.9)
    np.testing.assert_allclose(angle, [0.5, 0.6], atol=0.006)
    command = np.array([10.0, 20.0, 250.0, 700.0])
    np.testing.assert_allclose(0.03125 * np.array(CHANNELS.to_counts(command)), command, atol=0.016)


@pytest.mark.parametrize(("zero", "sign"), [(0.0, 1), (1234.0, 1), (4294967000.0, -1), (-5000.0, -1)])
def test_a_counter_is_read_across_its_wrap(zero, sign):
    section = describe_rig()
    section["encoders"]["SFE"] |= {"zero_count": zero, "sign": sign}
    channels = build_rig(section, 502).map_channels()
    for angle in (-0.1, 0.0, 1.3):
        raw = np.zeros(10)
        raw[8] = (zero + sign * angle / 6.283185307e-4) % 2**32
        assert channels.to_values(raw)[2][0] == pytest.approx(angle, abs=1e-3)


def test_a_steady_sample_is_well(generator):
    supervisor = make_supervisor()
    samples = [look(supervisor, counts(generator)) for _ in range(200)]
    assert {each.breach for each in samples} == {""}
    assert {word for each in samples for word in each.status} == {"ok"}


def test_a_vented_and_slack_muscle_stands_still_without_being_frozen(generator):
    supervisor = make_supervisor(moved=False)
    still = counts(generator, (0.0,) * 4, (0.0,) * 4)
    assert not any(look(supervisor, still, (0.0,) * 4).breach for _ in range(300))


@pytest.mark.parametrize(
    ("amiss", "commands", "borne", "words"),
    [
        ({2: 3200.0}, USUAL, 30, "pam3.pressure has not changed for 0.30 s (count 3200; rig.guard.frozen_s)"),
        ({5: -32768.0}, USUAL, 3, "pam2.force tells no value (count -32768)"),
        ({}, (200.0, 300.0, 100.0, 300.0), 49, "pam1 at 100 kPa while 200 kPa"),
        ({}, (5.0, 300.0, 100.0, 300.0), 49, "pam1 at 100 kPa while 5"),
    ],
)
def test_what_is_wrong_is_borne_only_for_so_long(generator, amiss, commands, borne, words):
    supervisor, told = make_supervisor(), []
    for _ in range(60):
        given = counts(generator)
        given[list(amiss)] = list(amiss.values())
        told.append(look(supervisor, given, commands).breach)
    assert told[:borne] == [""] * borne
    assert words in told[borne]


def test_a_pressure_may_take_its_time_after_a_step(generator):
    supervisor, stepped = make_supervisor(), (200.0, 100.0, 100.0, 300.0)
    for command in [USUAL] * 100 + [stepped] * 48:
        assert look(supervisor, counts(generator), command).breach == ""
    assert look(supervisor, counts(generator, stepped), stepped).breach == ""


@pytest.mark.parametrize(("moved", "words"), [(False, ""), (True, "SFE.encoder has not changed for")])
def test_encoders_stand_still_where_nobody_moves(generator, moved, words):
    supervisor = make_supervisor(moved)
    for _ in range(200):
        given = counts(generator)
        given[8:] = [800.0, 900.0]
        told = look(supervisor, given).breach
    assert words in told
    assert bool(told) == moved


def test_the_last_value_is_held_where_there_is_none(generator):
    supervisor, given = make_supervisor(), counts(generator)
    look(supervisor, counts(generator))
    given[5] = -32768.0
    sample = look(supervisor, given)
    assert sample.force_n[1] == pytest.approx(100.0, abs=0.9)
    assert sample.status.tolist() == ["ok", "invalid", "ok", "ok"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pressure": (301.0, 300.0, 100.0, 300.0)}, "pam1 at 301 kPa, ceiling 300.0 kPa"),
        ({"force": (400.0, 100.0, 400.0, 710.0)}, "pam4 at 710 N, ceiling 700.0 N"),
        ({"angle": (-0.3, 0.6)}, "rad, limits -0.25 and 1.55 rad"),
        ({"angle": (0.5, 1.52)}, "EFE at 1.5"),
    ],
)
def test_what_passes_a_limit_ends_the_trial_at_once(generator, changes, words):
    sample = look(make_supervisor(), counts(generator, **changes))
    assert words in sample.breach
    assert "over" in sample.status


def test_a_joint_that_is_too_quick_ends_the_trial(generator):
    quick, slower = make_supervisor(), make_supervisor()
    told = [look(quick, counts(generator, angle=(0.2 + 0.09 * k, 0.6))).breach for k in range(8)]
    assert "SFE at" in told[-1]
    assert "limit 8.0 rad/s" in told[-1]
    assert not any(look(slower, counts(generator, angle=(0.2 + 0.05 * k, 0.6))).breach for k in range(8))


def bank(angle, command=100.0):
    time_s = np.arange(50) / 100.0
    return pd.concat(
        pd.DataFrame({"time_s": time_s, "joint_angle_rad": angle(time_s, n)}).assign(
            trajectory=n, muscle=name, pressure_command_kpa=command
        )
        for n in range(3)
        for name in RIG.muscles
    ).reset_index(drop=True)


def forbidden(samples):
    return list(find_forbidden(samples, "trajectory", RIG.exoskeleton, RIG.guard, RIG.limits))


def test_a_bank_beyond_limits_is_told_where():
    assert forbidden(bank(lambda t, n: 0.5 + 0.2 * np.sin(t + n))) == []
    far = forbidden(bank(lambda t, n: 0.5 + (1.1 * (t > 0.3) if n == 1 else 0.0 * t)))
    assert far[0].startswith("trajectory 1 asks for joint SFE at 1.6 rad, permitted -0.25 to 1.55, at 0.31 s (1 of 3")
    assert any("rad/s, permitted 8.0" in each for each in far)
    high = forbidden(bank(lambda t, n: 0.5 + 0.0 * t, command=300.0))
    assert high == [
        f"trajectory 0 asks for muscle {name} at 300 kPa, permitted 0.0 to 250.0, at 0.00 s (3 of 3 ask for such)"
        for name in ("pam1", "pam3")
    ]


def test_a_rig_refuses_a_bank_in_one_line():
    with pytest.raises(ValueError, match=r"within the rig's limits: .* change rig.limits and rig.guard$") as caught:
        RIG.check_bank(bank(lambda t, n: 2.0 + 0.0 * t), "trajectory")
    assert "\n" not in str(caught.value)


def test_ticks_keep_to_time_and_missed_ones_are_left_out(turned):
    begun = turned.now_s()
    ticks = []
    for tick in pace(20, 0.01):
        ticks.append((tick.index, turned.now_s() - begun))
        assert tick.late_s == pytest.approx(0.005 if tick.index == 9 else 0.0, abs=1e-6)
        if tick.index == 5:
            turned.sleep(0.045)
    indices, at_s = np.array(ticks).T
    assert list(indices) == [*range(6), *range(9, 20)]
    np.testing.assert_allclose(at_s, np.where(indices == 9, 0.095, 0.01 * indices), atol=1e-6)


def test_the_pace_is_measured_on_samples_that_were_taken():
    rows = pd.DataFrame({"muscle": "pam1", "time_s": np.arange(100) / 100.0, "late_s": 0.0, "status": "ok"})
    rows.loc[50, "late_s"], rows.loc[70, "status"] = 0.006, "missed"
    found = measure_pace(pd.concat([rows, rows.assign(muscle="pam2")]), [])
    assert (found.samples, found.overruns) == (100, 2)
    assert found.p50_s == pytest.approx(0.01)
    assert found.p99_s > 0.015
    assert "2 of 100 samples overrun (2.00 %)" in str(found)


def test_a_signal_waits_until_the_muscles_are_down():
    seen = []
    before = [signal.signal(each, lambda number, _: seen.append(number)) for each in (signal.SIGTERM, signal.SIGINT)]
    try:
        with hold_signals() as held:
            signal.raise_signal(signal.SIGTERM)
            assert held.name == "SIGTERM"
            assert seen == []
        assert seen == [signal.SIGTERM]
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with pytest.raises(KeyboardInterrupt):  # noqa: SIM117 (raised on leaving the inner block)
            with hold_signals():
                signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGTERM, before[0])
        signal.signal(signal.SIGINT, before[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s["channels"].pop("pam2"), "channels: none for pam2, only for pam1, pam3, pam4; add channels.pam2"),
        (lambda s: s["encoders"].pop("EFE"), "encoders: none for EFE"),
        (
            lambda s: s["channels"]["pam1"]["command"].update(sign=-1, zero_count=8000.0),
            "channels.pam1.command: expected at most 30.0 kPa (guard.vented_kpa) for an output of 0",
        ),
        (
            lambda s: s["channels"]["pam2"]["command"].update(zero_count=-8000.0),
            "to which the watchdog sets it, got 250 kPa; correct zero_count (-8000.0) or sign",
        ),
        (lambda s: s["channels"]["pam1"]["force"].update(module=1), "the position of a 4AI, got 1, which is 4AO"),
        (lambda s: s["channels"]["pam1"]["force"].update(module=9), "got 9, which is no module"),
        (lambda s: s["channels"]["pam1"]["force"].update(channel=1), "pam1.force and channels.pam2.force: expected a"),
        (lambda s: s["device"].update(watchdog_s=0.05), "greater than or equal to 0.1"),
        (lambda s: s["device"].update(reply_s=0.3), "reply_s: expected less than watchdog_s"),
        (lambda s: s["device"].update(modules=["4AO", "EP"]), "modules: expected EP first and only there"),
        (lambda s: s["guard"]["ceilings"].pop("MAS-10"), "guard.ceilings: none for MAS-10"),
        (lambda s: s["guard"]["ceilings"]["MAS-40"].update(pressure_kpa=250.0), "more than the 250.0 kPa that"),
        (lambda s: s["guard"]["joints"].pop("SFE"), "guard.joints: none for SFE"),
        (lambda s: s["co_contraction_kpa"].pop("SFE"), "co_contraction_kpa: none for joint SFE"),
        (
            lambda s: s["channels"]["pam1"]["command"].update(kpa_per_count=0.001),
            "expected counts from -32768 to 32767 for all that may be commanded, got 250000 for 250.0 kPa",
        ),
        (
            lambda s: s["channels"]["pam3"]["force"].update(zero_count=4000.0, sign=-1),
            "up to the ceiling of 2500.0 (guard.ceilings), got -21000; it would not be noticed",
        ),
        (lambda s: s.update(lead_in_s=0.01), "lead_in_s: expected at least 0.0781 s, in whose filling_share pam1"),
    ],
)
def test_a_rig_that_cannot_work_is_refused(change, message):
    section = describe_rig()
    change(section)
    with pytest.raises(ValueError, match=r".*") as caught:
        build_rig(section, 502)
    assert message in str(caught.value)


def test_the_speed_is_that_of_the_real_time_between_samples(generator):
    supervisor = make_supervisor()
    at_s = [0.0, 0.01, 0.02, 0.08, 0.09, 0.10]
    told = [supervisor.look(counts(generator, angle=(0.2 + 5.0 * t, 0.6)), np.zeros(4), t) for t in at_s]
    assert {each.breach for each in told} == {""}
    assert told[-1].joint_velocity_rad_per_s[0] == pytest.approx(5.0, abs=0.5)


def test_a_sample_that_is_late_by_more_than_a_period_says_so_unless_a_sensor_is_amiss():
    command = np.full((60, 4), 100.0)
    logbook = Logbook(RIG, 0, command, np.full(command.shape, ""), None)
    sample = Sample(np.ones(4), np.ones(4), np.zeros(2), np.zeros(2), np.array(["ok", "ok", "ok", "held"]), "")
    late_s = 0.01 * np.array([0.5, 1.5, *[0.0] * 58])
    for index, late in enumerate(late_s):
        logbook.note(Tick(index, 0.01 * index), late, sample, (command[index], np.array("")))
    taken = logbook.collect()
    assert taken.status.tolist() == [[word] * 3 + ["held"] for word in ("ok", "late", *["ok"] * 58)]
    np.testing.assert_array_equal(taken.late_s, late_s)
