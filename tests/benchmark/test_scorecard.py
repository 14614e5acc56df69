"""The scorecard: a small one of real sessions, and its counting on sessions whose answers are made up."""

import functools
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from statsmodels.stats.proportion import proportion_confint

from pipeline.errors import ConfigError
from stages.benchmark import scorecard
from stages.benchmark.blinded_rig.scenarios import default_catalogue, named_scenario
from stages.benchmark.blinded_rig.sessions import HiddenSessions
from stages.science.statistics.intervals import bound_median, bound_rate
from tests.benchmark.small_scorecard import scored as scored
from tests.studies import read_stages, run_stage

GROUPS = ("rig=hidden", "+blinded_suite=small")
GROUPS += tuple(f"+{name}=default" for name in ("discrepancy", "inverse_crime_check", "scorecard"))
SAID = {
    "transport_delay-strong-71": "transport_delay",
    "hysteresis-strong-73": "hysteresis",
    "sensor_drift-medium-77": "sensor_drift",
    "creep-medium-76": "creep",
    "none-75": "",
    "neighbour_pressure-strong-78": "",
}


@functools.cache
def study_of(*overrides):
    return read_stages(["blinded_suite", "inverse_crime_check", "scorecard"], *GROUPS, "rig.trials=12", *overrides)


@pytest.mark.slow
def test_a_small_scorecard(scored):
    tables = scored
    judged = tables["scorecard_sessions"].set_index("session")
    assert dict(judged["named"].str.split("+").str[0]) == SAID
    named = judged[judged["named"] != ""]
    assert (named["status"] == "named").all()
    assert named["right_muscles"].all()
    assert (named["closed_share"] > 0.8).all()
    assert (named["probability"] > 0.6).all()
    assert (named["further_gain"] > 0.0).all()
    assert not judged["worse"].any()
    assert judged.loc["none-75", "status"] == "no_discrepancy"
    outsider = judged.loc["neighbour_pressure-strong-78"]
    assert (outsider["status"], outsider["unexplained_channel"]) == ("unexplained", "force_n")
    assert outsider["after"] == outsider["before"]
    sums = tables["blind_ranking"].groupby("session")["probability"].sum()
    assert sums.to_numpy() == pytest.approx(1.0)
    assert tables["scorecard"].loc[tables["scorecard"]["n"] > 0, "met"].all()


def test_a_session_twice_is_refused(tmp_path):
    study, stages = study_of("blinded_suite.sessions=[none-1,none-1]")
    with pytest.raises(ConfigError, match="each name once"):
        run_stage(study, stages["blinded_suite"], tmp_path, {})


@pytest.mark.slow
def test_no_form_is_the_rig_s_own_unless_there_is_but_one(tmp_path):
    effects = "inverse_crime_check.effects=[sensor_drift,transport_delay,valve_asymmetry]"
    study, stages = study_of(effects, "rig.trials=10")
    found = run_stage(study, stages["inverse_crime_check"], tmp_path, {})["inverse_crime_check"]
    best = found[found["best"]].set_index("key")
    assert list(best.index) == ["transport_delay", "valve_asymmetry", "sensor_drift"]
    assert best.loc["transport_delay", "only_form"]
    assert not best["same_code"].any()
    assert best["share"].between(0.01, 0.5).loc[["valve_asymmetry", "sensor_drift"]].all()
    assert best.loc["transport_delay", "share"] < 0.05


class Said:
    """Frames of made-up sessions."""

    def __init__(self):
        self.sessions, self.truth, self.named, self.ranking = [], [], [], []

    def add(
        self,
        kind,
        hidden,
        named,
        *,
        status=None,
        channel="force_n",
        gap=2.5,
        probability=0.9,
        further=(0.4, 0.6),
        suspected=(),
    ):
        session, lost = f"s{len(self.sessions)}", status == "unexplained"
        status = status or ("named" if named else "no_discrepancy")
        row = {"session": session, "kind": kind, "asked": "medium", "load_cell_site": "joint_end", "status": status}
        row |= {"unknown": 0.9 * lost, "unexplained_channel": channel, "family": "memory" * lost}
        row |= {"unexplained_share": 0.5, "before": 8.0, "after": 3.0, "floor": 1.0}
        row |= {"oracle": np.nan if kind in ("none", "outsider") else 2.0, "further_gain": float(np.mean(further))}
        self.sessions.append(row | {"further_gain_low": further[0], "further_gain_high": further[1]})
        for order, (name, muscles) in enumerate(hidden, start=1):
            facts = {"key": name, "name": name, "outsider": kind == "outsider", "channel": "force_n", "reached": True}
            size = {"gap_over_floor": gap, "absorbed_share": 0.5}
            self.truth += [{"session": session, "order": order, **facts, **size, "muscle": m} for m in muscles]
        for order, (name, muscles) in enumerate(named, start=1):
            facts = {"name": name, "form": "f", "channel": "force_n", "probability": probability, "not_excluded": ""}
            facts["suspected"] = False
            self.named += [{"session": session, "order": order, **facts, "muscle": m} for m in muscles]
        for order, (name, doubtful) in enumerate(suspected, start=len(named) + 1):
            facts = {"name": name, "form": "f", "channel": "force_n", "probability": doubtful, "not_excluded": ""}
            self.named.append({"session": session, "order": order, **facts, "muscle": "pam1", "suspected": True})
        for place, (name, p) in enumerate((("none", 0.1), ("hysteresis", 0.9)), start=1):
            listed = {"session": session, "place": place, "name": name, "probability": p, "absorbed": False}
            self.ranking.append(listed)

    def score(self, folder):
        study, stages = study_of()
        frames = (self.sessions, self.truth, self.named, self.ranking)
        tables = {
            table.name: table.check(pd.DataFrame(rows, columns=list(table.columns)), "made up")
            for table, rows in zip(stages["blinded_suite"].writes, frames, strict=True)
        }
        with patch.object(scorecard, "RESAMPLES", 100):
            return run_stage(study, stages["scorecard"], folder, tables)


TWO = ["pam1", "pam2"]


def value(found, measure, size="all"):
    return found["scorecard"].set_index(["measure", "magnitude"]).loc[(measure, size)]


def test_names_count_by_class_and_by_themselves_and_what_the_constants_absorb_apart(tmp_path):
    said = Said()
    said.add("one_effect", [("hysteresis", TWO)], [("hysteresis", TWO)])
    said.add("one_effect", [("coulomb_friction", TWO)], [("stribeck_friction", TWO)])
    said.add("one_effect", [("creep", TWO)], [("hysteresis", TWO), ("creep", TWO)])
    said.add("one_effect", [("creep", TWO)], [])
    said.add("one_effect", [("creep", TWO)], [], status="unexplained")
    said.add("one_effect", [("creep", TWO)], [("creep", TWO)], gap=6.0)
    said.add("one_effect", [("sensor_gain", TWO)], [], gap=1.05)
    said.add("one_effect", [("sensor_gain", TWO)], [("creep", TWO)], gap=1.05)
    found = said.score(tmp_path)
    medium = value(found, "named first, or its class", "medium")
    assert (medium["n"], medium["value"], medium["met"]) == (5, 0.4, False)
    assert (medium["low"], medium["high"]) == pytest.approx(proportion_confint(2, 5, method="wilson"))
    assert value(found, "named first, by its own name", "medium")["value"] == 0.2
    assert value(found, "named first, or its class", "strong")["value"] == 1.0
    assert value(found, "named first, or its class", "weak")["n"] == 0
    assert value(found, "closed, median", "medium")["value"] == pytest.approx(5 / 6)
    cells = found["scorecard_cells"].set_index(["hidden", "magnitude"])
    assert cells.loc[("creep", "medium"), "said_instead"] == "hysteresis+creep 1, no_discrepancy 1, unexplained 1"
    assert cells.loc[("creep", "medium"), "unexplained"] == 1
    assert list(found["scorecard_sessions"]["magnitude"])[-2:] == ["absorbed", "absorbed"]
    for measure in ("absorbed, misnamed", "absorbed, listed so or nothing found"):
        assert value(found, measure)["value"] == 0.5
    assert not value(found, "absorbed, misnamed")["met"]


def test_faults_and_muscles(tmp_path):
    said = Said()
    said.add("none", [], [])
    said.add("none", [], [("creep", TWO)])
    said.add("none", [], [], status="unexplained")
    said.add("outsider", [("bulge", TWO)], [], status="unexplained")
    said.add("outsider", [("bulge", TWO)], [], status="unexplained", channel="pressure_kpa")
    said.add("outsider", [("bulge", TWO)], [("creep", TWO)], probability=0.7)
    said.add("outsider", [("bulge", TWO)], [("creep", TWO)], probability=0.85)
    said.add("one_muscle", [("creep", ["pam1"])], [("creep", ["pam1"])])
    said.add("one_muscle", [("creep", ["pam1"])], [("creep", TWO)])
    said.add("two_effects", [("creep", TWO), ("hysteresis", TWO)], [("hysteresis", TWO), ("creep", TWO)])
    said.add("two_effects", [("creep", TWO), ("hysteresis", TWO)], [("hysteresis", TWO)])
    found = said.score(tmp_path)
    shares = {
        "nothing hidden, something named": 1 / 3,
        "nothing hidden, unexplained": 1 / 3,
        "not in the library, named with confidence": 1 / 4,
        "not in the library, unexplained": 1 / 2,
        "not in the library, unexplained in its channel": 1 / 4,
        "one muscle, named there alone": 1 / 2,
        "two effects, both named": 1 / 2,
    }
    assert {measure: value(found, measure)["value"] for measure in shares} == pytest.approx(shares)
    bins = found["reliability"].set_index("from_probability")
    assert bins.loc[0.9, "n"] == 6
    assert bins.loc[0.9, "right"] == pytest.approx(5 / 6)
    assert bins.loc[0.7, "right"] == 0.0
    expected = (6 * abs(0.9 - 5 / 6) + 0.7 + 0.85) / 8
    row = value(found, "calibration error of what was said")
    assert row["value"] == pytest.approx(expected)
    assert row["low"] < expected < row["high"]


def test_a_model_that_is_worse_counts_where_its_interval_says_so_and_two_names_where_there_is_one_cause(tmp_path):
    said = Said()
    said.add("one_effect", [("creep", TWO)], [("creep", TWO)], further=(-0.4, -0.1))
    said.add("one_effect", [("creep", TWO)], [("creep", TWO), ("hysteresis", TWO)], further=(-0.4, 0.1))
    said.add("one_effect", [("creep", TWO)], [], status="unexplained", further=(0.0, 0.0))
    said.add("outsider", [("bulge", TWO)], [("creep", TWO), ("hysteresis", TWO)])
    said.add("two_effects", [("creep", TWO), ("hysteresis", TWO)], [("hysteresis", TWO), ("creep", TWO)])
    found = said.score(tmp_path)
    worse, two = value(found, "amended, worse on further trials"), value(found, "one cause, two names")
    assert (worse["n"], worse["value"], worse["met"]) == (4, 1 / 4, False)
    assert (two["n"], two["value"]) == (3, 2 / 3)


def test_what_is_suspected_counts_only_among_the_probabilities_that_are_said(tmp_path):
    said = Said()
    said.add("one_effect", [("creep", TWO)], [], status="unexplained", suspected=[("creep", 0.75), ("leakage", 0.01)])
    said.add("none", [], [], suspected=[("hysteresis", 0.75)])
    found = said.score(tmp_path)
    bins = found["reliability"].set_index("from_probability")
    assert (bins["n"].sum(), bins.loc[0.7, "n"], bins.loc[0.7, "right"]) == (2, 2, 0.5)
    assert value(found, "nothing hidden, something named")["value"] == 0.0
    assert not found["scorecard_sessions"]["named"].any()


def test_intervals_of_medians_hold_them():
    rng = np.random.default_rng(5)
    held = []
    for _ in range(600):
        _, low, high = bound_median(rng.exponential(size=15), 0.95)
        held.append(low <= np.log(2.0) <= high)
    assert 0.94 < np.mean(held) < 0.99
    assert np.isnan(bound_median(np.array([]), 0.95)).all()
    assert np.isnan(bound_rate(np.array([], dtype=bool), 0.95)).all()


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("scorecard.classes.0.names=[creep]", "at least 2 items"),
        ("scorecard.reliability_edges=[0.5,0.5,1.0]", "expected growing numbers"),
        ("+scorecard.targets.closed.huge=0.5", "no magnitude 'huge'"),
        ("rig.effect=histeresis", "unknown effect 'histeresis'"),
        ("rig.muscles=[pam9]", "unknown muscle 'pam9'"),
    ],
)
def test_nonsense_is_refused(override, told):
    with pytest.raises(ConfigError, match=told):
        study_of(override)


def test_a_name_gives_its_session_back_and_the_small_scorecard_has_seeds_of_its_own():
    for each in default_catalogue():
        assert named_scenario(each.name) == each
        assert each.seed not in {named_scenario(name).seed for name in SAID}
    for wrong in ("hysteresis-huge-1", "histeresis-weak-1", "hysteresis-weak", "none-x"):
        with pytest.raises(ValueError, match="names no session"):
            named_scenario(wrong)


def test_what_is_hidden_is_drawn_by_the_seed():
    drawn = [HiddenSessions(seed, None, None, None, 16).hidden for seed in range(40)]
    assert drawn == [HiddenSessions(seed, None, None, None, 16).hidden for seed in range(40)]
    assert len({each.effects for each in drawn}) > 6
    assert 5 < sum(len(each.muscles) == 1 for each in drawn) < 25
    assert HiddenSessions(3, "none", None, None, 16).hidden.effects == ()
