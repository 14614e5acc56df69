"""The rig that hides effects: its format, its honesty, the sizes of what it hides."""

import functools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from stages.benchmark.blinded_rig import __main__ as command
from stages.benchmark.blinded_rig.calibration import RATIOS, NominalFit
from stages.benchmark.blinded_rig.chain import STEP_S
from stages.benchmark.blinded_rig.dataset import simulate, write
from stages.benchmark.blinded_rig.effects import EFFECTS
from stages.benchmark.blinded_rig.effects.muscle import tendon_strain
from stages.benchmark.blinded_rig.kernels import bouc_wen, late_by, lugre_state
from stages.benchmark.blinded_rig.machine import DATA_SHEET, MUSCLES
from stages.benchmark.blinded_rig.scenarios import Scenario, load_cell_for
from stages.benchmark.blinded_rig.session import build_session, observe
from stages.benchmark.blinded_rig.signals import Signals

EXAMPLE = Path(__file__).resolve().parents[3] / "shared" / "data" / "exoskeleton_example"


@functools.cache
def observe_quietly():
    """Return a short session without noise, the load cell where all shows, and its readings with nothing hidden."""
    session = build_session(11, 4, "joint_end", noisy=False)
    return session, observe(session, ())


@pytest.fixture(scope="module")
def plain():
    return simulate(Scenario((), "medium", 5))


def regress(target, columns):
    basis = np.column_stack(columns)
    return float(np.std(target - basis @ np.linalg.lstsq(basis, target, rcond=None)[0]))


def force_gap(samples, muscle):
    rows = samples[samples["muscle"] == muscle]
    p, e, v = (rows[name].to_numpy() for name in ("pressure_kpa", "contraction", "contraction_velocity_per_s"))
    scaled = p / 100.0
    return regress(rows["force_n"].to_numpy(), [scaled, scaled * e, scaled * e * e, np.ones_like(e), e, e * e, v])


def pressure_gap(samples, muscle):
    rows = samples[samples["muscle"] == muscle]
    command_kpa = rows["pressure_command_kpa"].to_numpy().reshape(rows["trial"].nunique(), -1)

    def left(tau_s):
        keep = np.exp(-1.0 / (250.0 * tau_s))
        lagged = command_kpa[:, :1] + lfilter([0.0, 1.0 - keep], [1.0, -keep], command_kpa - command_kpa[:, :1])
        return regress(rows["pressure_kpa"].to_numpy(), [lagged.ravel(), np.ones(len(rows))])

    coarse = min(np.geomspace(0.02, 0.2, 24), key=left)
    return min(left(tau) for tau in coarse * np.linspace(0.9, 1.1, 21))


GAPS = {"pressure_kpa": pressure_gap, "force_n": force_gap}


def test_a_dataset_obeys_the_format_and_covers_a_wide_range(plain):
    samples, meta = plain.samples, plain.meta
    assert len(samples) == 16 * 4 * 1000
    assert not samples.isna().any().any()
    assert (samples["force_n"] >= 0.0).all()
    assert not samples.duplicated(["trial", "time_s", "muscle"]).any()
    for (_, muscle), rows in samples.groupby(["trial", "muscle"]):
        np.testing.assert_allclose(np.diff(rows["time_s"]), 1.0 / meta["sampling_rate_hz"], atol=1e-12)
        known = meta["muscles"][muscle]
        slope = known["sign"] * known["moment_arm_m"] / known["rest_length_m"]
        expected = known["contraction_at_angle_0"] + slope * rows["joint_angle_rad"]
        np.testing.assert_allclose(rows["contraction"], expected, atol=1e-12)
        assert {"pam1": "SFE", "pam2": "SFE", "pam3": "EFE", "pam4": "EFE"}[muscle] == known["joint"]
    assert np.all(np.diff(meta["trial_start_s"]) > meta["trial_s"])
    assert len(meta["trial_start_s"]) == meta["trials"] == 16
    for muscle, rows in samples.groupby("muscle"):
        assert rows["pressure_kpa"].quantile(0.01) < 100.0, muscle
        assert rows["pressure_kpa"].max() > (350.0 if DATA_SHEET[muscle].role == "agonist" else 450.0)
        assert np.ptp(rows["contraction"]) > 0.08
        assert (rows["contraction_velocity_per_s"].abs() < 0.005).mean() > 0.05, "some rest"


@pytest.mark.skipif(not EXAMPLE.exists(), reason=f"{EXAMPLE} is absent")
def test_the_format_is_that_of_the_example(plain):
    example = pd.read_parquet(EXAMPLE / "samples.parquet")
    meta = json.loads((EXAMPLE / "meta.json").read_text())
    assert list(example.columns) == list(plain.samples.columns)
    assert set(meta) == set(plain.meta)
    assert all(meta[name] == plain.meta[name] for name in ("muscles", "nominal", "timing"))


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    asked = Scenario(("creep",), "weak", 2, trials=3)
    for name in ("a", "b"):
        write(simulate(asked), tmp_path / name)
    for name in ("{}/samples.parquet", "{}/meta.json", "{}.truth.json"):
        assert (tmp_path / name.format("a")).read_bytes() == (tmp_path / name.format("b")).read_bytes()
    other = simulate(Scenario(("creep",), "weak", 3, trials=3)).samples
    assert not np.allclose(other["force_n"], pd.read_parquet(tmp_path / "a/samples.parquet")["force_n"])


@pytest.mark.parametrize("seed", range(5))
def test_nuisances_alone_stay_near_the_floor(seed):
    varied, ideal = (NominalFit(build_session(seed, 6, "joint_end", varied=flag)) for flag in (True, False))
    for channel in GAPS:
        assert np.all(varied.floor[channel] / ideal.floor[channel] < 1.05)
    assert not np.array_equal(varied.without.force_n, ideal.without.force_n)


def test_magnitudes_are_hit_by_an_independent_fit():
    short = simulate(Scenario((), "medium", 5, trials=8)).samples
    for key, magnitude in (*(("hysteresis", each) for each in RATIOS), ("valve_asymmetry", "medium")):
        hidden = simulate(Scenario((key,), magnitude, 5, ("pam1", "pam4"), trials=8))
        gap = GAPS[EFFECTS[key].channel]
        for muscle in ("pam1", "pam4"):
            ratio = gap(hidden.samples, muscle) / gap(short, muscle)
            assert ratio == pytest.approx(RATIOS[magnitude], rel=0.04)
            assert hidden.truth["effects"][0]["gap_over_floor"][muscle] == pytest.approx(ratio, rel=0.03)
        untouched = ~short["muscle"].isin(["pam1", "pam4"])
        pd.testing.assert_frame_equal(hidden.samples[untouched], short[untouched], check_exact=True)


@pytest.mark.parametrize("key", ["sensor_offset", "sensor_gain_pressure", "leakage"])
def test_what_the_constants_absorb_is_told(key):
    told = simulate(Scenario((key,), "strong", 4, trials=6)).truth["effects"][0]
    assert not told["reached"]
    assert all(share > 0.99 for share in told["absorbed_share"].values())
    assert all(ratio < 1.2 for ratio in told["gap_over_floor"].values())


@pytest.mark.parametrize("key", [key for key, effect in EFFECTS.items() if effect.site == "cable"])
def test_a_load_cell_at_the_muscle_sees_no_cable(key):
    session = build_session(3, 2, "muscle_tip")
    with_it = observe(session, ((EFFECTS[key], np.full(4, EFFECTS[key].largest)),))
    np.testing.assert_array_equal(with_it.force_n, observe(session, ()).force_n)
    assert load_cell_for((key,), 3) == "joint_end"


def test_a_delay_shifts_the_pressure():
    session, without = observe_quietly()
    late = observe(session, ((EFFECTS["transport_delay"], np.full(4, 0.040)),))
    np.testing.assert_allclose(late.pressure_kpa[..., 20:], without.pressure_kpa[..., 10:-10], atol=1e-6)
    ramp = np.broadcast_to(np.arange(50.0), (1, 1, 50)).copy()
    np.testing.assert_allclose(late_by(ramp, np.array([2.25]))[0, 0, 5:], np.arange(5.0, 50.0) - 2.25)


def test_friction_states_settle_at_their_levels_and_hysteresis_does_not_depend_on_the_rate():
    steady = np.full((1, 1, 4000), 0.05)
    assert lugre_state(steady, np.array([1e-3]), 0.0, 0.02, STEP_S)[0, 0, -1] == pytest.approx(1.0)
    slow = lugre_state(steady / 100.0, np.array([1e-5]), 1.0, 0.02, STEP_S)[0, 0, -1]
    assert slow == pytest.approx(1.0 + np.exp(-((5e-4 / 0.02) ** 2)))
    assert bouc_wen(steady, np.array([0.01]), 1.5, STEP_S)[0, 0, -1] == pytest.approx(1.0, abs=1e-6)
    phase = np.linspace(0.0, 4.0 * np.pi, 8001)
    path = np.broadcast_to(0.03 * np.sin(phase), (1, 1, phase.size))
    slow, fast = (
        bouc_wen(np.gradient(path, step_s, axis=-1), np.array([0.01]), 1.5, step_s) for step_s in (1e-3, 1.25e-4)
    )
    np.testing.assert_allclose(slow, fast, atol=1e-9)
    assert np.trapezoid(slow[0, 0, 4000:], path[0, 0, 4000:]) > 0.05


def test_the_tendon_is_in_equilibrium():
    machine, strain = observe_quietly()[0].machine, np.full((4, 1, 1), 0.04)
    pressure, joint_side = np.full((4, 1, 3), 350.0), np.broadcast_to([0.04, 0.1, 0.17], (4, 1, 3))
    nothing = np.empty(0)
    signals = Signals(machine, STEP_S, nothing, nothing, nothing, nothing, acting_kpa=pressure, contraction=joint_side)
    shortened = EFFECTS["series_elasticity"].act(signals, strain)
    tension = machine.static_force(pressure, shortened)
    np.testing.assert_allclose(shortened - joint_side, strain * tendon_strain(tension / signals.full_n), rtol=1e-6)
    assert np.all(shortened > joint_side)


def test_no_noise_where_none_is_asked_for():
    noisy, quiet = (simulate(Scenario(("bulge",), "medium", 6, trials=2, noisy=flag)) for flag in (True, False))
    assert noisy.truth["effects"] == quiet.truth["effects"]
    off = noisy.samples["pressure_kpa"] - quiet.samples["pressure_kpa"]
    assert 0.5 < off.std() < 2.0


def test_the_command_writes_a_folder_and_seals_the_truth_beside_it(tmp_path, capsys):
    words = [str(tmp_path / "d"), "effect=hysteresis", "magnitude=strong", "seed=3", "muscles=pam1", "trials=2"]
    assert command.main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d", "d.truth.json"]
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["meta.json", "samples.parquet"]
    assert "hysteresis" not in (tmp_path / "d/meta.json").read_text()
    truth = json.loads((tmp_path / "d.truth.json").read_text())
    assert truth["effects"][0]["muscles"] == ["pam1"]
    assert set(truth["effects"][0]["size"]) == {"pam1"} < set(MUSCLES)
    before = (tmp_path / "d.truth.json").read_bytes()
    assert command.main(words) == 2
    assert "nothing is written over" in capsys.readouterr().err
    assert (tmp_path / "d.truth.json").read_bytes() == before


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("effect=histeresis", "unknown effect 'histeresis'"),
        ("muscles=pam9", "unknown muscle 'pam9'"),
        ("magnitude=huge", "weak, medium, strong"),
        ("seed=-1", "whole number"),
        ("trials=0", "need a trial"),
        ("sead=1", "not understood"),
        ("catalogue=alien", "foreign_scoring"),
        ("effect=valve_lag+leakage", "both replace the valve"),
    ],
)
def test_nonsense_gets_one_line(word, says, tmp_path, capsys):
    assert command.main([str(tmp_path / "d"), word]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_list_names_every_effect(capsys):
    assert command.main(["--list"]) == 0
    listed = capsys.readouterr().out
    assert all(key in listed for key in EFFECTS)
    assert "354 scenarios" in listed
