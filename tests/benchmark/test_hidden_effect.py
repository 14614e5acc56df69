"""The demonstration: a rig hides an effect under seal, the search runs, the seal is opened."""

import json
from hashlib import sha256

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import InputError
from stages.benchmark.blinded_rig.dataset import write
from stages.benchmark.blinded_rig.sessions import HiddenSessions
from tests.benchmark.test_verdicts import judge_session
from tests.studies import read_stages, run_stage

STAGES = [
    "blinded_session",
    "further_trials",
    "measurement",
    "locate_gap",
    "name_effect",
    "amend_model",
    "explain_remainder",
]
STAGES += ["verify_gap", "unblinding"]
MUSCLES = "+measurement=muscles"
DEFAULT = ("+discrepancy=default", "+explain_remainder=default", "+propose_trial=default", "+next_trials=2")
RIG = HiddenSessions(5, None, None, None, 3)


@pytest.fixture(scope="module")
def session():
    return RIG.record()


@pytest.fixture(scope="module")
def whole():
    """The study of the whole demonstration, and its stages."""
    return read_stages(STAGES, "rig=hidden", "rig.trials=3", "seed=5", MUSCLES, "+measured=null", *DEFAULT)


@pytest.fixture(scope="module")
def recorded(whole, tmp_path_factory):
    study, stages = whole
    folder = tmp_path_factory.mktemp("sealed")
    tables = run_stage(study, stages["blinded_session"], folder, {})
    columns = list(stages["further_trials"].writes[0].columns)
    tables["further_recordings"] = pd.DataFrame(columns=columns)
    return {**tables, **run_stage(study, stages["measurement"], folder, tables)}


def test_the_seal_tells_nothing_but_whether_the_truth_was_changed(session, recorded):
    truth = json.dumps(session.truth, sort_keys=True)
    assert recorded["seal"]["sha256"].item() == sha256(truth.encode()).hexdigest()
    text = " ".join(frame.astype(str).to_csv() for frame in recorded.values() if len(frame) < 1000)
    assert not any(name in text for name in ("friction", "hysteresis", "creep", *RIG.hidden.effects))


def test_a_session_is_measured_as_its_folder_would_be(session, recorded, tmp_path):
    write(session, tmp_path / "session")
    study, stages = read_stages(["measurement"], MUSCLES, f"+measured={tmp_path / 'session'}", "+rig.none=1", "~rig")
    read = run_stage(study, stages["measurement"], tmp_path, {})
    for name in ("measured", "measured_muscles"):
        pd.testing.assert_frame_equal(read[name], recorded[name], check_exact=False, rtol=1e-12)
    starts = [frame["measured_trials"]["start_s"] for frame in (read, recorded)]
    np.testing.assert_allclose(*starts, atol=1e-9)
    assert read["measured_session"].drop(columns="source").equals(recorded["measured_session"].drop(columns="source"))


def opened(whole, recorded, folder, named, status="named", further=2):
    study, stages = whole
    muscles = ["pam1", "pam2", "pam3", "pam4"]
    channels = pd.DataFrame({"channel": "force_n", "muscle": muscles, "gap_over_floor": 2.0})
    rows = [{"order": 1, "name": n, "channel": "force_n", "muscle": m, "probability": 0.8} for n, m in named]
    said = pd.DataFrame(rows, columns=["order", "name", "channel", "muscle", "probability"])
    tables = {
        "seal": recorded["seal"],
        "further_trials": pd.DataFrame(index=range(further)),
        "channels": channels,
        "decision": pd.DataFrame({"status": [status]}),
        "named_effects": said.assign(indistinguishable_from="capstan_friction"),
        "verification": pd.DataFrame({"simulation": "measured upstream", "gap": [0.03, 0.02, 0.01]}),
    }
    found = run_stage(study, stages["unblinding"], folder, tables)
    return found["comparison_with_truth"].set_index("muscle"), " ".join(found["outcome"]["outcome"])


def test_what_was_named_is_compared_muscle_by_muscle(session, whole, recorded, tmp_path):
    (hidden,) = session.truth["effects"]
    assert hidden["channel"] == "force_n"
    first, *others = hidden["muscles"]
    compared, told = opened(whole, recorded, tmp_path, [(hidden["name"], first)])
    assert compared.loc[first, "right"]
    assert not compared.loc[others, "right"].any()
    assert compared.loc[first, "hidden_gap_over_floor"] == pytest.approx(hidden["gap_over_floor"][first], rel=0.02)
    assert "which is right." in told
    assert "from 3 % of the range to 2 %; the noise floor is 1 %" in told
    assert "which is wrong." in opened(whole, recorded, tmp_path, [("leakage", first)])[1]
    compared, told = opened(whole, recorded, tmp_path, [], "unexplained", further=1)
    assert (compared["named"] == "").all()
    assert "without a name in the library" in told
    assert "which is wrong, as it has one" in told
    assert "Of 2 further trials 1 were recorded" in told
    assert "from 3 % of the range to 3 %" in told


def test_another_truth_than_the_sealed_one_is_refused(whole, recorded, tmp_path):
    other = {**recorded, "seal": recorded["seal"].assign(sha256="0" * 64)}
    with pytest.raises(InputError, match="another truth"):
        opened(whole, other, tmp_path, [])


@pytest.mark.slow
def test_the_amended_simulator_is_identified_and_the_scorecard_says_what_the_verdict_does(pamid):
    result = pamid("experiment=hidden_effect", "seed=3", "budget=tiny", "rig.trials=6", "figures=[png]")
    assert result.returncode == 0, result.stderr
    assert "as sealed before the search" in " ".join(result.stdout.split())
    (run,) = pamid.runs
    verdict = json.loads((run / "verdict.json").read_text())
    judged = judge_session(HiddenSessions(3, None, None, None, 6).record(), 6)
    said = judged.decision
    assert said.status == verdict["status"] == "named"
    assert [each.name for each in said.effects] == [each["name"] for each in verdict["effects"]]
    assert said.effects[0].p_value == pytest.approx(verdict["effects"][0]["p_value"])
    assert judged.gap(said.steps[-1], verdict["gap"]["channels"]) == pytest.approx(verdict["gap"]["after"])
    assert judged.floor(verdict["gap"]["channels"]) == pytest.approx(verdict["gap"]["noise_floor"])
    result = pamid(f"plant={run / 'documents' / 'amended.yaml'}", "budget=tiny", "figures=[]")
    assert result.returncode == 0, result.stderr
