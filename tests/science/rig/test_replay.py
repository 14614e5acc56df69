"""Recordings as a rig: what a simulated machine recorded comes back exactly, and what is not there is refused."""

import numpy as np
import pandas as pd
import pytest
import yaml
from pydantic import ValidationError

from pipeline.plan import gather
from stages.science.rig.contract import RigError, tidy
from stages.science.rig.replay import ReplayRig
from stages.science.rig.trial import Trial
from tests.bags import write_bag, write_mcap
from tests.science.plant.machines import CONF, configured, other_machine, other_rig
from tests.science.rig.watching import execute_whole as execute
from tests.studies import read_stages, run_stage

DEFAULTS = {
    name: value
    for name, value in yaml.safe_load((CONF / "rig" / "replay.yaml").read_text()).items()
    if name not in ("_target_", "exoskeleton", "participants", "recordings")
}
STAGES = ["bank", "subsampling", "hardware", "protocol"]
ORDER = ["bank", "subsampling", "protocol", "hardware"]
SMALL = ["+protocol=default", "protocol.experiments=2", "bank.trajectories=3", "exoskeleton.trial_s=1"]
TABLES = {"free": "bank", "tracked": "hardware_recordings", "passive": "protocol_recordings"}
DERIVED = ["contraction", "contraction_velocity_per_s", "joint_velocity_rad_per_s"]


def make_trial(rig, kind="tracked", offset=0.0, number=None):
    """Return a trial whose commands vary with the muscle, time and offset."""
    ramp = 80.0 + offset + np.linspace(0.0, 20.0, rig.samples)[:, None] + 5.0 * np.arange(len(rig.muscles))
    who = {"tracked": next(iter(rig.participants)), "free": "experimenter", "passive": "nobody"}[kind]
    reference = np.full((rig.samples, len(rig.joints)), 0.5) if kind == "tracked" else None
    return Trial(kind, who, ramp, reference, number=number)


def record(rig, *trials, whole=False):
    """Return the recordings of these trials, of their lead-ins too or not, and their long rows."""
    with rig:
        told = [rig.execute(each, np.random.default_rng(k)) for k, each in enumerate(trials)]
    told = told if whole else [each.without_lead_in() for each in told]
    frames = [pd.DataFrame(tidy(each, rig)).assign(trial=k + 1) for k, each in enumerate(told)]
    return told, pd.concat(frames, ignore_index=True)


def replay(rig, paths, kind="tracked", columns=(), units=(), **changed):
    """Return a rig of the same machine that replays what lies at a path of one kind, or at those of all kinds."""
    given = paths if isinstance(paths, dict) else {kind: str(paths)}
    its = {"recordings": {"free": None, "tracked": None, "passive": None} | given}
    its |= {name: DEFAULTS[name] | dict(more) for name, more in (("columns", columns), ("units", units))}
    same = {"exoskeleton": rig.exoskeleton, "participants": rig.participants}
    return ReplayRig.model_validate(DEFAULTS | same | its | changed)


def same(found, told, rounded=()):
    for name in vars(told):
        if name in rounded:
            np.testing.assert_allclose(getattr(found, name), getattr(told, name), atol=1e-9, err_msg=name)
        else:
            np.testing.assert_array_equal(getattr(found, name), getattr(told, name), err_msg=name)


def refusal(rig, trial):
    with pytest.raises(RigError) as refused:
        execute(rig, trial)
    assert "\n" not in str(refused.value)
    return str(refused.value)


MACHINES = {
    "one joint": lambda: other_rig(other_machine([2], 100.0, 2.0)),
    "four joints": lambda: other_rig(other_machine([2, 2, 2, 2], 200.0, 1.0)),
}


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("kind", ["free", "tracked", "passive"])
@pytest.mark.parametrize("whole", [False, True])
def test_what_was_recorded_comes_back_exactly(tmp_path, machine, kind, whole):
    rig = MACHINES[machine]()
    trials = [make_trial(rig, kind, offset) for offset in (0.0, 7.0)]
    told, rows = record(rig, *trials, whole=whole)
    assert (rows["time_s"].min() < 0.0) == whole
    rows.to_parquet(tmp_path / "a.parquet")
    player = replay(rig, tmp_path / "a.parquet", kind)
    for trial, recording in zip(trials, told, strict=True):
        same(execute(player, trial), recording)


@pytest.fixture(scope="module")
def told():
    machine = configured().exoskeleton.model_copy(update={"trial_s": 1.0})
    rig = other_rig(machine)
    recordings, rows = record(rig, make_trial(rig), make_trial(rig, offset=7.0), make_trial(rig, offset=7.0))
    return rig, recordings, rows


@pytest.fixture
def play(told, tmp_path):
    """Return a rig that replays rows of a file, by default those that were told."""

    def play(rows=told[2], suffix="parquet", **settings):
        path = tmp_path / f"a.{suffix}"
        rows.to_csv(path, index=False) if suffix == "csv" else rows.to_parquet(path)
        return replay(told[0], path, **settings)

    return play


@pytest.mark.parametrize(
    ("change", "suffix", "settings", "trial", "place"),
    [
        (lambda rows: rows.sort_values(["trial", "time_s", "muscle"]), "csv", {}, {}, 0),
        (None, "parquet", {}, {"offset": 7.0, "number": 1}, 1),  # of equal commands that of the trial's number
        (None, "parquet", {}, {"offset": 7.0, "number": 2}, 2),
        (None, "parquet", {"match": "order"}, {"offset": 99.0, "number": 2}, 2),
        (None, "parquet", {"match": "order"}, {"offset": 99.0, "number": 0}, 0),
        (None, "parquet", {"match": {"tracked": "order"}}, {"offset": 99.0, "number": 1}, 1),
        (
            lambda rows: rows.assign(kind=rows["trial"].map({1: "free", 2: "tracked", 3: "passive"})),
            "parquet",
            {"kind": "passive", "match": "order"},
            {"kind": "passive", "number": 0},
            2,
        ),
    ],
)
def test_the_recording_of_a_trial_is_found(play, told, change, suffix, settings, trial, place):
    rig, recordings, rows = told
    player = play(change(rows) if change else rows, suffix, **settings)
    same(execute(player, make_trial(rig, **trial)), recordings[place])


def test_how_samples_were_taken_is_carried(play, told):
    rig, _, rows = told
    late = rows.assign(late_s=0.002)
    late.loc[late["time_s"] == 0.4, "status"] = "frozen"
    late.loc[late["time_s"] == 0.4, "clipped_by"] = "rate"
    found = execute(play(late, "csv"), make_trial(rig))
    assert set(found.status[100]) == {"frozen"}
    assert set(found.clipped_by[100]) == {"rate"}
    assert (found.status == "frozen").sum() == 4
    assert set(found.late_s) == {0.002}


@pytest.mark.parametrize(
    ("trial", "changed", "settings", "message"),
    [
        (
            {"offset": 4.0},
            {},
            {},
            "within 1 kPa RMS, got a.parquet, trial 2 at 3 kPa as the nearest; add a recording of it, raise ",
        ),
        (
            {},
            {"shown": 1.8},
            {"columns": {"reference_rad": "shown"}},
            "whose reference is within 0.5 rad RMS, got a.parquet, trial 1 at 1.3 rad as the nearest",
        ),
        ({}, {"participant": "somebody"}, {}, "expected a recording of p1, got some of somebody"),
        ({"number": 3}, {}, {"match": "order"}, "expected recording 4 in order, got 3 of tracked trials"),
        ({}, {}, {"match": "order"}, "nothing numbers it"),
        ({"kind": "free"}, {}, {}, "got none; set rig.recordings.free=PATH"),
    ],
)
def test_what_was_not_recorded_is_refused(play, told, trial, changed, settings, message):
    rig, _, rows = told
    assert message in refusal(play(rows.assign(**changed), **settings), make_trial(rig, **trial))


def test_a_command_that_is_near_enough_or_was_clipped_is_no_difference(play, told):
    rig, _, rows = told
    assert execute(play(tolerance_kpa=3.5), make_trial(rig, offset=4.0)).pressure_command_kpa[0, 0] == 87.0
    rows = rows.copy()
    rows.loc[rows["muscle"] == "pam1", ["pressure_command_kpa", "clipped_by"]] = [50.0, "pressure"]
    assert set(execute(play(rows), make_trial(rig)).pressure_command_kpa[:, 0]) == {50.0}


def test_a_folder_holds_a_trial_in_each_file_by_name(tmp_path, told):
    rig, recordings, rows = told
    for number, own in rows.groupby("trial"):
        own.drop(columns="trial").to_csv(tmp_path / f"run_{number}.csv", index=False)
    player = replay(rig, tmp_path, match="order")
    same(execute(player, make_trial(rig, number=1)), recordings[1])


def test_what_follows_from_the_encoder_may_be_missing(play, told):
    rig, recordings, rows = told
    player = play(rows.drop(columns=[*DERIVED, "status", "clipped_by", "late_s"]))
    same(execute(player, make_trial(rig)), recordings[0], DERIVED)


def test_units_and_names_are_those_of_the_file(play, told):
    rig, recordings, rows = told
    foreign = rows.assign(t_ms=1000.0 * rows["time_s"], F=rows["force_n"] / 1000.0).drop(columns=["time_s", "force_n"])
    given = {"columns": {"time_s": "t_ms", "force_n": "F"}, "units": {"time_s": "ms", "force_n": "kN"}}
    found = execute(play(foreign, "csv", **given), make_trial(rig))
    np.testing.assert_allclose(found.force_n, recordings[0].force_n)
    player = play(foreign, "csv", columns={"force_n": "F"})
    message = refusal(player, make_trial(rig))
    assert message.startswith(f"{player.recordings.tracked[0]}: no column time_s; ")
    assert "say which with rig.columns.time_s=NAME, or set rig.rate_hz" in message


def at(rows, trial, *samples):
    count = (rows["time_s"] * 250.0).round()
    return rows.index[(rows["trial"] == trial) & count.isin(samples)]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda rows: rows.drop(index=at(rows, 2, 100, 101)),
            "trial 2: column time_s: nothing for 2 samples before rows 1100, 1348, 1596 and 1 more; record it anew, or "
            "set rig.resample=true, which marks what is missing",
        ),
        (
            lambda rows: pd.concat([rows, rows.loc[at(rows, 2, 100)]]),
            "trial 2: column time_s: rows 3000, 3001, 3002 and 1 more repeat an earlier one (trial 2, muscle pam1, ",
        ),
        (
            lambda rows: rows.iloc[[1, 0, *range(2, len(rows))]],
            "trial 1: column time_s: time goes back in row 1 (trial 1, muscle pam1); sort the rows",
        ),
        (
            lambda rows: rows.assign(force_n=rows["force_n"].mask(rows.index == 5)),
            "trial 1: column force_n: expected a value in every row, got none in row 5; set rig.resample=true",
        ),
        (
            lambda rows: rows.assign(time_s=2.0 * rows["time_s"]),
            "trial 1: column time_s: expected the exoskeleton's 250 Hz, got 125 Hz; set rig.resample=true, or",
        ),
        (
            lambda rows: rows[rows["time_s"] < 0.6],
            "trial 1: expected the 250 samples of a trial, got 150; set exoskeleton.trial_s=0.6",
        ),
        (
            lambda rows: rows[rows["muscle"] != "pam4"],
            "trial 1: column muscle: expected rows of every muscle, got none of pam4",
        ),
        (
            lambda rows: rows.assign(pressure_kpa=rows["pressure_kpa"] / 100.0),
            "a.csv: column pressure_kpa: expected values in kPa, got none above",
        ),
        (lambda rows: rows.assign(status="fine"), "trial 1: column status: expected isin(['ok', 'missed', 'late', "),
    ],
)
def test_what_is_wrong_with_a_recording_is_one_line(play, tmp_path, told, spoil, message):
    rig, _, rows = told
    found = refusal(play(spoil(rows), "csv"), make_trial(rig))
    assert found.startswith(str(tmp_path / "a.csv"))
    assert message in found


def test_resampling_marks_gaps_and_holds_what_was_before(play, told):
    rig, recordings, rows = told
    found = execute(play(rows.drop(index=at(rows, 1, 100, 101)), "csv", resample=True), make_trial(rig))
    assert (found.status == "missed").all(axis=1).nonzero()[0].tolist() == [100, 101]
    np.testing.assert_array_equal(found.force_n[101], recordings[0].force_n[99])
    np.testing.assert_array_equal(found.force_n[102:], recordings[0].force_n[102:])
    message = refusal(play(rows.drop(index=at(rows, 1, *range(100, 120))), "csv", resample=True), make_trial(rig))
    assert "trial 1: column time_s: nothing for 0.08 s, first from 0.4 s of the trial on" in message


@pytest.mark.parametrize("whole", [False, True])
def test_resampling_changes_rate_and_length(tmp_path, whole):
    quick = other_rig(other_machine([2], 200.0, 2.0))
    slow = other_rig(other_machine([2], 100.0, 1.5))
    (recording,), rows = record(quick, make_trial(quick), whole=whole)
    rows = rows[rows["time_s"] > -0.995]  # begins between two samples of the slow machine
    recording = recording.cut(slice(2 * whole, 500))
    rows.to_parquet(tmp_path / "a.parquet")
    command = recording.without_lead_in().pressure_command_kpa[:300:2]
    trial = Trial("tracked", "p1", command, np.full((150, 1), 0.5))
    found = execute(replay(slow, tmp_path / "a.parquet", resample=True), trial)
    lead = 99 * whole
    np.testing.assert_array_equal(found.time_s, np.arange(-lead, 150) / 100.0)
    np.testing.assert_array_equal(found.force_n, recording.force_n[: 2 * lead + 300 : 2])
    short = other_rig(other_machine([2], 100.0, 2.5))
    message = refusal(replay(short, tmp_path / "a.parquet", resample=True), make_trial(short))
    assert "nothing for 0.5 s, first from 2 s" in message


BAG_COLUMNS = {
    "pressure_kpa": "/muscles.position[{muscle}]",
    "pressure_command_kpa": "/muscles.velocity[{muscle}]",
    "force_n": "/muscles.effort[{muscle}]",
    "joint_angle_rad": "/joints.position[{joint}]",
}


@pytest.mark.parametrize("machine", ["one joint", "four joints"])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap", "json"])
def test_bags_are_replayed(tmp_path, machine, storage):
    rig = MACHINES[machine]()
    (recording,), _ = record(rig, make_trial(rig))
    times = np.round(recording.time_s * 1e9).astype(int)
    fields = {"position": "pressure_kpa", "velocity": "pressure_command_kpa", "effort": "force_n"}
    muscles = {name: getattr(recording, each) for name, each in fields.items()}
    joints = {"position": recording.joint_angle_rad}
    topics = {"/muscles": (list(rig.muscles), times, muscles), "/joints": (list(rig.joints), times, joints)}
    if storage == "json":
        messages = {
            topic: [
                (int(time), {"name": names} | {each: values[k].tolist() for each, values in fields.items()})
                for k, time in enumerate(times)
            ]
            for topic, (names, times, fields) in topics.items()
        }
        path = write_mcap(tmp_path / "one.mcap", messages)
    else:
        path = write_bag(tmp_path / "one", topics, storage)
    found = execute(replay(rig, path, columns=BAG_COLUMNS), make_trial(rig))
    same(found, recording, DERIVED)


def test_some_recordings_are_needed_and_names_are_known(tmp_path, told):
    rig, _, rows = told
    rows.to_parquet(tmp_path / "a.parquet")
    with pytest.raises(ValidationError, match="expected the path of recorded trials, got none"):
        replay(rig, {})
    with pytest.raises(ValidationError, match="expected the path of a file or folder"):
        replay(rig, tmp_path / "gone.parquet")
    with pytest.raises(ValidationError, match="columns: no column 'force'; "):
        replay(rig, tmp_path / "a.parquet", columns={"force": "F"})


def run_study(folder, *overrides):
    study, stages = read_stages(STAGES, *SMALL, *overrides)
    tables = {}
    for name in ORDER:
        tables.update(run_stage(study, stages[name], folder, tables))
    return tables


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Tables of a simulated study, and the overrides that replay it."""
    folder = tmp_path_factory.mktemp("recorded")
    tables = run_study(folder)
    paths = {kind: folder / f"{name}.parquet" for kind, name in TABLES.items()}
    for kind, path in paths.items():
        tables[TABLES[kind]].to_parquet(path)
    return tables, ["rig=replay", *(f"rig.recordings.{kind}={path}" for kind, path in paths.items())]


@pytest.mark.parametrize(
    "chosen",
    [
        ["rig.match=command"],
        ["rig.match={free: order, tracked: order, passive: order}", "bank.seed=99"],  # so that other ones are asked for
    ],
)
def test_a_study_is_replayed_from_its_own_tables(recorded, tmp_path, chosen):
    told, overrides = recorded
    found = run_study(tmp_path, *overrides, *chosen)
    for name in TABLES.values():
        pd.testing.assert_frame_equal(found[name], told[name])
    executed_by = told["executed_by"].assign(rig="ReplayRig", real=True)
    pd.testing.assert_frame_equal(found["executed_by"], executed_by)


def test_the_bytes_of_recordings_count_in_freshness(recorded, tmp_path):
    told, overrides = recorded
    path = tmp_path / "movements.parquet"
    told["bank"].to_parquet(path)
    study, stages = read_stages(STAGES, *SMALL, *overrides, f"rig.recordings.free=[{path}]")
    before = gather(study, stages["bank"], {})
    told["bank"].iloc[:-1].to_parquet(path)
    after = gather(study, stages["bank"], {})
    key = "rig.recordings.free.0/movements.parquet"
    assert before.inputs[key] != after.inputs[key]
    assert before.measured
