"""The search on sessions whose truth the rig alone knows until each is searched.

In: a rig of whole sessions. Out, in parts, one a session: `blind_sessions` (what was said of each, and the gap that is
left beside what is left when the truth is told), `blind_truth` (what was hidden), `blind_named` (what was named) and
`blind_ranking` (each candidate of the first round).
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.errors import ConfigError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.ranking import list_named, rank_first
from stages.science.discrepancy.settings import DiscrepancySettings, choose_verification
from stages.science.recording.datasets import tabulate_session
from stages.science.scorecard.judgement import Judgement, judge, search_with_truth

KINDS = ["none", "one_effect", "one_muscle", "two_effects", "outsider"]

BLIND_SESSIONS = Table(
    "blind_sessions",
    "What was said of a session",
    {
        "session": column(str, "its name"),
        "kind": column(str, "what was hidden in it", among=KINDS),
        "asked": column(str, "magnitude asked for"),
        "load_cell_site": column(str, "where tension is measured"),
        "status": column(str, "of the verdict", among=["no_discrepancy", "named", "unexplained"]),
        "unknown": column(float, "probability that something without a name is left", low=0, high=1),
        "unexplained_channel": column(str, "channel in which that is most probable"),
        "unexplained_share": column(float, "share of the gap that a flexible model still removes there"),
        "family": column(str, "without a name that removes it; empty where none was found"),
        "before": column(float, "gap on opened trials after the nominal fit, RMSE over range", low=0),
        "after": column(float, "the same with what was named", low=0),
        "oracle": column(float, "the same with the true names told; empty where the library lacks one", nullable=True),
        "floor": column(float, "the same, of what a flexible model leaves", low=0),
        "further_gain": column(float, "share of the squared gap on further trials that what was named removes"),
        "further_gain_low": column(float, "lower end of its interval, paired by trial"),
        "further_gain_high": column(float, "upper end of it"),
    },
    key=("session",),
)
BLIND_TRUTH = Table(
    "blind_truth",
    "An effect that was hidden in a session, on a muscle",
    {
        "session": column(str, "its name"),
        "order": column(int, "of the effects", low=1),
        "key": column(str, "of the effect on the rig"),
        "name": column(str, "of the effect"),
        "outsider": column(bool, "whether the library has no name for it"),
        "channel": column(str, "in which it shows"),
        "muscle": column(str, "that carries it"),
        "gap_over_floor": column(float, "gap that it leaves after the rig's own nominal fit, over the noise", low=0),
        "absorbed_share": column(float, "share of its change, squared, that the constants imitate", low=0, high=1.001),
        "reached": column(bool, "whether it is as large as asked"),
    },
    key=("session", "order", "muscle"),
)
BLIND_NAMED = Table(
    "blind_named",
    "An effect that was named or suspected, on a muscle",
    {
        "session": column(str, "its name"),
        "order": column(int, "of addition, of those suspected after the named", low=1),
        "suspected": column(bool, "whether it was not confirmed, and not named"),
        "name": column(str, "of the effect"),
        "form": column(str, "its form"),
        "channel": column(str, "in which it was seen"),
        "muscle": column(str, "that carries it"),
        "probability": column(float, "when it was added", low=0, high=1),
        "not_excluded": column(str, "names that the data do not exclude, by comma"),
    },
    key=("session", "order", "muscle"),
)
BLIND_RANKING = Table(
    "blind_ranking",
    "A candidate of the first round of a session's search",
    {
        "session": column(str, "its name"),
        "place": column(int, "in the ranking", low=1),
        "name": column(str, "of the effect; none, or unknown"),
        "probability": column(float, "sums to 1", low=0, high=1),
        "absorbed": column(bool, "whether the constants imitate it"),
    },
    key=("session", "name"),
)


class BlindedSuite(Section):
    """Config group ``blinded_suite``."""

    sessions: Annotated[list[str], Field(min_length=1)] | None
    further_trials: Annotated[int, Field(ge=2)]


class Config(Section):
    """What this stage reads."""

    rig: Target
    discrepancy: DiscrepancySettings
    blinded_suite: BlindedSuite
    seed: int


@stage(BLIND_SESSIONS, BLIND_TRUTH, BLIND_NAMED, BLIND_RANKING, stream="blind_tests")
def blinded_suite(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Search every session of the catalogue, and only then look what was hidden."""
    names = cfg.blinded_suite.sessions or list(ctx.device.catalogue())
    if len(set(names)) < len(names):
        raise ConfigError("blinded_suite.sessions: expected each name once; leave out what is there twice")
    return ctx.land_each("sessions", partial(_search, cfg, ctx), {name: (name,) for name in names})


def _search(cfg: Config, ctx: Context, name: str) -> dict[str, pd.DataFrame]:
    """Return the rows of a session."""
    settings, further_trials = cfg.discrepancy, cfg.blinded_suite.further_trials
    recorded = ctx.device.record(name, further_trials)
    samples = recorded.samples
    first = samples["trial"].isin(np.unique(samples["trial"])[:-further_trials])
    tables = tabulate_session(samples[first], recorded.meta, name)
    outputs = build_muscle_channels(tables, settings)
    test = choose_verification(len(tables.measured_trials), settings.verification_share)
    judged = judge(outputs, test, settings, lambda *purpose: ctx.generator(name, *purpose))
    whole = build_muscle_channels(tabulate_session(samples, recorded.meta, name), settings)
    further = list(range(whole[0].trials - further_trials, whole[0].trials))
    gain, low, high = judged.compare_further(whole, further, settings.level)
    row = {
        "load_cell_site": str(tables.measured_session["load_cell_site"].iloc[0]),
        "further_gain": gain,
        "further_gain_low": low,
        "further_gain_high": high,
        **_measure(judged, recorded.truth, ctx.generator(name, "told")),
    }
    named, suspected = judged.decision.effects, judged.decision.suspected
    said = list_named([*named, *suspected], judged.found.rounds)
    rows: dict[str, Any] = {
        BLIND_SESSIONS.name: [row],
        BLIND_TRUTH.name: _list_hidden(recorded.truth),
        BLIND_NAMED.name: [
            {**each, "not_excluded": each["indistinguishable_from"], "suspected": each["order"] > len(named)}
            for each in said
        ],
        BLIND_RANKING.name: _list_ranking(judged, settings.report.most_confounded),
    }
    return {
        table.name: pd.DataFrame(rows[table.name]).assign(session=name).reindex(columns=list(table.columns))
        for table in blinded_suite.writes
    }


def _measure(judged: Judgement, truth: Mapping[str, Any], generator: np.random.Generator) -> dict[str, Any]:
    """Return what was said, and the gaps of the channels in which something was hidden, or of all.

    The gap with the true names told is nan where the library lacks one.
    """
    hidden, decision, oracle = truth["effects"], judged.decision, math.nan
    channels = {each["channel"] for each in hidden} or {output.channel for output in judged.outputs}
    names = {str(each["name"]) for each in hidden}
    if names and names <= {form.name for output in judged.outputs for form in output.forms}:
        oracle = judged.gap(search_with_truth(judged, names, generator).steps[-1], channels)
    where = judged.unexplained
    return {
        "kind": _classify_session(truth, {output.element for output in judged.outputs}),
        "asked": truth["scenario"]["magnitude"] if hidden else "none",
        "status": decision.status,
        "unknown": min(decision.unknown, 1.0),
        "unexplained_channel": where,
        "unexplained_share": decision.remainders[where].share,
        "family": decision.remainders[where].family,
        "before": judged.gap(decision.steps[0], channels),
        "after": judged.gap(decision.steps[-1], channels),
        "oracle": oracle,
        "floor": judged.floor(channels),
    }


def _classify_session(truth: Mapping[str, Any], muscles: set[str]) -> str:
    hidden = truth["effects"]
    if len(hidden) != 1:
        return "two_effects" if hidden else "none"
    if hidden[0]["outsider"]:
        return "outsider"
    return "one_effect" if set(hidden[0]["muscles"]) == muscles else "one_muscle"


def _list_hidden(truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    kept = ("key", "name", "outsider", "channel", "reached")
    return [
        {
            "order": order,
            **{name: each[name] for name in kept},
            "muscle": muscle,
            "gap_over_floor": each["gap_over_floor"][muscle],
            "absorbed_share": each["absorbed_share"][muscle],
        }
        for order, each in enumerate(truth["effects"], start=1)
        for muscle in each["muscles"]
    ]


def _list_ranking(judged: Judgement, most_confounded: float) -> list[dict[str, Any]]:
    rows = [row for row in rank_first(judged.found, judged.decision, most_confounded) if row["round"] == 1]
    return [{**row, "place": place} for place, row in enumerate(rows, start=1)]
