"""What every rig keeps to, on the configured arm and on others."""

from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.contract import RECORDING_COLUMNS, RigError, tidy
from stages.science.rig.limits import speed_samples
from stages.science.rig.reference import exchange_columns, replayed_trial, track
from stages.science.rig.replay import ReplayRig
from stages.science.rig.trial import CLIPPED_BY, STATUS, Trial
from stages.science.signals.bending import Bending
from stages.science.signals.lead_in import leave_out_lead_in
from tests.cpx_e.rig import describe_rig, emulate_rig
from tests.science.plant.machines import other_rig
from tests.science.rig.test_replay import replay
from tests.science.rig.watching import execute

ARMS = {"elbow": "festo_cpx", "arm": "festo_cpx_arm"}
"""Option of exoskeleton, and of rig that goes with it: one joint and four; each rig's own tests have two."""
RATE_HZ, TRIAL_S, LEAD_IN_S = 100.0, 1.0, 0.6
MOST = {"MAS-40": (250.0, 4000.0), "MAS-10": (700.0, 10000.0)}
"""What may be commanded, by type of muscle, kPa, and how fast that may change, kPa/s."""


@contextmanager
def run_simulated(arm):
    section = describe_rig(f"exoskeleton={arm}", f"exoskeleton.trial_s={TRIAL_S}", rig=ARMS[arm])
    yield other_rig(Exoskeleton.model_validate(section["exoskeleton"])).model_copy(update={"lead_in_s": LEAD_IN_S})


@contextmanager
def run_emulated(arm):
    chosen = f"exoskeleton={arm}", f"exoskeleton.trial_s={TRIAL_S}", f"rig.lead_in_s={LEAD_IN_S}"
    with emulate_rig(*chosen, rig=ARMS[arm]) as (_, rig):
        yield rig


@contextmanager
def run_replayed(arm):
    """A rig on what the simulated one recorded of the trials below."""
    with TemporaryDirectory() as folder, run_simulated(arm) as rig, rig:
        paths = {"free": [], "tracked": [], "passive": []}
        for number, trial in enumerate([*trials(rig), clipped(rig)]):
            path = Path(folder) / f"{number}.parquet"
            pd.DataFrame(tidy(rig.execute(trial, np.random.default_rng(number)), rig)).to_parquet(path)
            paths[trial.kind].append(str(path))
        yield replay(rig, paths, tolerance_kpa=900.0)


RIGS = {"sim": run_simulated, "replay": run_replayed, "festo_cpx": run_emulated}


@pytest.fixture(scope="module", params=[f"{rig}, {arm}" for rig in RIGS for arm in ARMS])
def rig(request):
    kind, arm = request.param.split(", ")
    with RIGS[kind](arm) as made:
        yield made


def command(rig, low=60.0, high=120.0):
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, 6.0, rig.samples))[:, None]
    return (low + (high - low) * share) * np.ones(len(rig.muscles))


def reference(rig):
    return 0.6 + 0.2 * np.sin(np.linspace(0.0, 3.0, rig.samples))[:, None] * np.ones(len(rig.joints))


def trials(rig):
    return [
        Trial("free", "experimenter", command(rig), label="a movement"),
        Trial("tracked", "p1", command(rig), reference(rig), label="a reference"),
        Trial("passive", "nobody", command(rig), label="nobody"),
    ]


@pytest.mark.parametrize("arm", ARMS)
def test_an_emulated_machine_moves_as_a_simulated_one(arm):
    with run_emulated(arm) as emulated, run_simulated(arm) as simulated:
        asked = np.full((emulated.samples, len(emulated.muscles)), 100.0)
        asked[30:70] += np.resize([20.0, 60.0, 10.0, 30.0], len(emulated.muscles))
        found, expected = (execute(rig, Trial("passive", "nobody", asked)) for rig in (emulated, simulated))
    off = np.abs(found.pressure_kpa - expected.pressure_kpa)
    assert 1.4826 * np.median(off, axis=0) == pytest.approx(0.4 * 2**0.5, rel=0.45)
    assert off.max() < 3.0
    assert np.abs(found.joint_angle_rad - expected.joint_angle_rad).max() < 0.005
    assert np.sqrt(((found.force_n - expected.force_n) ** 2).mean(axis=0)).max() < 4.5


def test_shapes_are_known_before_connecting(rig):
    assert rig.samples == round(RATE_HZ * TRIAL_S)
    assert rig.sampling_rate_hz == RATE_HZ
    assert len(rig.muscle_joints) == len(rig.muscles)
    assert set(rig.muscle_joints) == set(rig.joints)
    assert {"p1", "p2", "experimenter"} <= set(rig.people)
    assert not rig.connected


def test_trials_of_all_three_kinds_follow_each_other_in_one_block(rig, generator):
    given = [*trials(rig), trials(rig)[2]]
    with rig:
        assert rig.connected
        wholes = [rig.execute(trial, generator) for trial in given]
    assert not rig.connected
    recordings = [each.without_lead_in() for each in wholes]
    for trial, whole, found in zip(given, wholes, recordings, strict=True):
        lead = round(getattr(rig, "lead_in_s", whole.lead / RATE_HZ) * RATE_HZ)
        np.testing.assert_allclose(whole.time_s, np.arange(-lead, rig.samples) / RATE_HZ, atol=1e-12)
        if lead:
            assert (whole.pressure_kpa[0] < 2.0).all()
            assert set(whole.clipped_by[:lead].ravel()) == {"ramp"}
            np.testing.assert_allclose(whole.pressure_command_kpa[lead - 1], trial.pressure_command_kpa[0])
        frame = tidy(found, rig)
        assert list(frame) == list(RECORDING_COLUMNS)
        assert len(frame["time_s"]) == rig.samples * len(rig.muscles)
        np.testing.assert_allclose(found.time_s, np.arange(rig.samples) / RATE_HZ)
        assert set(found.status.ravel()) <= set(STATUS)
        assert set(found.clipped_by.ravel()) <= set(CLIPPED_BY)
        taken = ((found.status == "ok") & (found.clipped_by == "")).all(axis=1)
        assert taken.sum() > 20
        np.testing.assert_allclose(found.pressure_command_kpa[taken], trial.pressure_command_kpa[taken])
        assert np.abs(found.pressure_kpa[taken] - trial.pressure_command_kpa[taken]).max() < 40.0
        if trial.reference_rad is not None:
            assert np.corrcoef(found.joint_angle_rad[:, 0], trial.reference_rad[:, 0])[0, 1] > 0.5
    assert np.abs(recordings[-2].pressure_kpa - recordings[-1].pressure_kpa).max() < 40.0


def test_whatever_ends_the_block_releases(rig, generator):
    with pytest.raises(RigError, match="is not connected"):
        rig.execute(trials(rig)[0], generator)
    for wrong in (
        Trial("free", "experimenter", command(rig)[1:]),
        Trial("free", "experimenter", command(rig)[:, 1:] if len(rig.muscles) > 2 else np.ones((rig.samples, 5))),
        Trial("free", "nobody here", command(rig)),
        Trial("tracked", "p1", command(rig), np.ones((rig.samples, len(rig.joints) + 1))),
    ):
        with pytest.raises(ValueError, match=r"this rig (takes|knows)"), rig:
            rig.execute(wrong, generator)
        assert not rig.connected
    for error in (KeyboardInterrupt(), ZeroDivisionError(), SystemExit(1)):
        with pytest.raises(type(error)), rig:
            raise error
        assert not rig.connected
    with rig:
        assert rig.connected


def movement(rig, number, command_kpa):
    """A movement of a bank, as rows of references."""
    joint = [list(rig.joints).index(name) for name in rig.muscle_joints]
    columns = {
        "trajectory": number,
        "time_s": np.tile(np.arange(rig.samples) / RATE_HZ, len(joint)),
        "muscle": np.repeat(list(rig.muscles), rig.samples),
        "pressure_command_kpa": command_kpa.T.ravel(),
        "joint_angle_rad": reference(rig)[:, joint].T.ravel(),
    }
    return pd.DataFrame(columns)


def test_exchanged_pressures_are_applied_within_every_limit(rig, generator):
    """Two movements in each of which one side of a joint pulls; exchanged, both would, but for a ceiling."""
    if hasattr(rig, "co_contraction_kpa"):
        rig = rig.model_copy(update={"co_contraction_kpa": dict.fromkeys(rig.joints, 200.0)})
    pulls = np.array([muscle.role == "agonist" for muscle in rig.exoskeleton.muscles])
    low, high = command(rig, 40.0, 60.0), command(rig, 180.0, 240.0)
    movements = [np.where(pulls, high, low), np.where(pulls, low, 2.0 * high)]
    references = pd.concat([movement(rig, number, each) for number, each in enumerate(movements)])
    rig.check_bank(references, "trajectory")
    sources = {name: 1 - int(pull) for name, pull in zip(rig.muscles, pulls, strict=True)}
    asked = np.where(pulls, *movements)
    rows = exchange_columns(references, 0, sources)
    np.testing.assert_array_equal(replayed_trial(rows, rig, "p1", "").pressure_command_kpa, asked)
    with rig:
        recorded = leave_out_lead_in(track(rows, rig, "p1", "exchanged", generator))
    if isinstance(rig, ReplayRig):
        return  # it found the nearest that there was
    applied = np.column_stack(
        [recorded.loc[recorded["muscle"] == name, "pressure_command_kpa"] for name in rig.muscles]
    )
    assert (applied <= [MOST[muscle.type][0] for muscle in rig.exoskeleton.muscles]).all()
    ceilings = getattr(rig, "co_contraction_kpa", {})
    held = {rig.muscle_joints[m] for m in np.flatnonzero(np.abs(applied - asked).max(axis=0) > 1e-9)}
    assert held == {name for name in rig.joints if ceilings.get(name, np.inf) < 240.0}
    for joint in rig.joints:
        sides = [(np.array(rig.muscle_joints) == joint) & (pulls == pull) for pull in (True, False)]
        lower = np.min([applied[:, each].max(axis=1) for each in sides], axis=0)
        assert (lower <= ceilings.get(joint, np.inf)).all()


def test_bent_movements_are_within_every_limit(rig, generator):
    """However much is added, the rig takes it and applies it as it is, but for a ceiling on co-contraction."""
    low, high = command(rig, 40.0, 60.0), command(rig, 180.0, 240.0)
    steps = low.copy()
    steps[50:] += 30.0
    references = pd.concat([movement(rig, number, each) for number, each in enumerate([low, high, steps])])
    joints = dict(zip(rig.muscles, rig.muscle_joints, strict=True))
    bending = Bending.read(references, joints, rig.samples, speed_samples(RATE_HZ))
    size = {**dict.fromkeys(rig.joints, 0.4), **dict.fromkeys(rig.muscles, 300.0)}
    changes = {name: its * generator.standard_normal(6) for name, its in size.items()}
    rows = bending.bend(references[references["trajectory"] == 2], changes)
    rig.check_bank(rows, "trajectory")
    asked = replayed_trial(rows, rig, "p1", "").pressure_command_kpa
    assert np.ptp(asked, axis=0).min() > 100.0
    if isinstance(rig, ReplayRig):
        return  # it has no recording of it
    with rig:
        recorded = leave_out_lead_in(track(rows, rig, "p1", "bent", generator))
    for name, its in zip(rig.muscles, asked.T, strict=True):
        found = recorded[recorded["muscle"] == name]
        assert set(found["clipped_by"]) <= {"", "co_contraction"}
        as_asked = (found["clipped_by"] == "").to_numpy()
        np.testing.assert_allclose(found["pressure_command_kpa"][as_asked], its[as_asked], atol=1e-9)


def clipped(rig):
    asked = command(rig)
    asked[50:, pulling(rig)] = 900.0
    return Trial("passive", "nobody", asked)


def pulling(rig):
    """The agonist of the first joint, and the antagonist of the second if there is one."""
    return [0, 3] if len(rig.joints) > 1 else [0]


def test_what_clipped_the_command_is_recorded(rig, generator):
    asked = clipped(rig).pressure_command_kpa
    with rig:
        found = rig.execute(clipped(rig), generator).without_lead_in()
    pulled = pulling(rig)
    kinds = [rig.exoskeleton.muscles[each].type for each in pulled]
    high, slew = np.array([MOST[each] for each in kinds]).T
    applied, clipped_by = found.pressure_command_kpa[:, pulled], found.clipped_by[:, pulled]
    np.testing.assert_allclose(np.diff(applied, axis=0).max(axis=0), slew / RATE_HZ)
    assert (applied[70:] == high).all()
    assert set(clipped_by[:50].ravel()) == {""}
    assert set(clipped_by[50]) == {"rate"}
    assert set(clipped_by[70:].ravel()) == {"pressure"}
    assert (found.pressure_kpa[:, pulled] < high + 5.0).all()
    calm = np.delete(np.arange(len(rig.muscles)), pulled)
    np.testing.assert_allclose(found.pressure_command_kpa[:, calm], asked[:, calm])
