"""The search on sessions whose truth the rig alone knows until each is searched.

In: a rig of whole sessions. Out, in parts, one a session: `blind_sessions` (what was said of each, and the gap that is
left beside what is left when the truth is told), `blind_truth` (what was hidden), `blind_named` (what was named) and
`blind_ranking` (each candidate of the first round).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
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
    "An effect that was named, on a muscle",
    {
        "session": column(str, "its name"),
        "order": column(int, "of addition", low=1),
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
    jobs = [Job(cfg.discrepancy, ctx, name, cfg.blinded_suite.further_trials) for name in names]
    with ctx.progress("sessions", len(jobs)) as advance:
        for job, key in zip(jobs, ctx.spread(Job.run, jobs), strict=True):
            ctx.record.include([key])
            advance(job.name)
    return ctx.record.collect()


@dataclass(frozen=True, eq=False)
class Job:
    """One session to be searched."""

    settings: DiscrepancySettings
    ctx: Context
    name: str
    further_trials: int

    def run(self) -> str:
        """Search the session, land its part and return the part's name."""
        self.ctx.record.part((self.name,), self.search)
        return self.ctx.record.name((self.name,))

    def search(self) -> dict[str, pd.DataFrame]:
        """Return the rows of this session."""
        recorded = self.ctx.device.record(self.name, self.further_trials)
        samples = recorded.samples
        first = samples["trial"].isin(np.unique(samples["trial"])[: -self.further_trials])
        tables = tabulate_session(samples[first], recorded.meta, self.name)
        outputs = build_muscle_channels(tables, self.settings)
        test = choose_verification(len(tables.measured_trials), self.settings.verification_share)
        judged = judge(outputs, test, self.settings, lambda *purpose: self.ctx.generator(self.name, *purpose))
        row: dict[str, Any] = {
            "session": self.name,
            "load_cell_site": str(tables.measured_session["load_cell_site"].iloc[0]),
        }
        whole = build_muscle_channels(tabulate_session(samples, recorded.meta, self.name), self.settings)
        further = list(range(whole[0].trials - self.further_trials, whole[0].trials))
        gain, low, high = judged.compare_further(whole, further, self.settings.level)
        row |= {"further_gain": gain, "further_gain_low": low, "further_gain_high": high}
        rows: dict[str, Any] = {
            BLIND_SESSIONS.name: [{**row, **self.measure(judged, recorded.truth)}],
            BLIND_TRUTH.name: _list_hidden(recorded.truth),
            BLIND_NAMED.name: [
                {**row, "not_excluded": row["indistinguishable_from"]} for row in list_named(judged.decision.effects)
            ],
            BLIND_RANKING.name: _list_ranking(judged, self.settings.search.most_confounded),
        }
        return {
            table.name: pd.DataFrame(rows[table.name]).assign(session=self.name).reindex(columns=list(table.columns))
            for table in blinded_suite.writes
        }

    def measure(self, judged: Judgement, truth: Mapping[str, Any]) -> dict[str, Any]:
        """Return what was said, and the gaps of the channels in which something was hidden, or of all."""
        hidden = truth["effects"]
        channels = {each["channel"] for each in hidden} or {output.channel for output in judged.outputs}
        where = judged.unexplained
        return {
            "kind": _classify_session(truth, {output.element for output in judged.outputs}),
            "asked": truth["scenario"]["magnitude"] if hidden else "none",
            "status": judged.decision.status,
            "unknown": min(judged.decision.unknown, 1.0),
            "unexplained_channel": where,
            "unexplained_share": judged.decision.remainders[where].share,
            "family": judged.decision.remainders[where].family,
            "before": judged.gap(judged.decision.steps[0], channels),
            "after": judged.gap(judged.decision.steps[-1], channels),
            "oracle": self.reach(judged, truth, channels),
            "floor": judged.floor(channels),
        }

    def reach(self, judged: Judgement, truth: Mapping[str, Any], channels: set[str]) -> float:
        """Return the gap that is left when the true names are told; nan where the library lacks one."""
        names = {str(each["name"]) for each in truth["effects"]}
        known = {form.name for output in judged.outputs for form in output.forms}
        if not names or not names <= known:
            return math.nan
        knowing = search_with_truth(judged, names, self.ctx.generator(self.name, "told"))
        return judged.gap(knowing.steps[-1], channels)


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
    rows = [row for row in rank_first(judged.found, judged.decision.doubt, most_confounded) if row["round"] == 1]
    return [
        {**row, "probability": min(row["probability"], 1.0), "place": place} for place, row in enumerate(rows, start=1)
    ]
