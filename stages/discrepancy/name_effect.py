"""Which effect is missing: every candidate fitted together with the nominal constants, judged on trials left out.

In: what was measured, which trials are fitted, and the nominal fit. Out: `ranking` (each candidate's probability, round
by round, with ``none`` and ``unknown`` among them), `decision` (what is said), `named_effects` (those that trials left
out of the fit confirm, in the order added), `suspected_effects` (the others), `unexplained` (what nothing named takes
away) and `steps` (constants and parameters after each addition).
"""

from typing import Any, get_args

import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.dataset import DatasetTables, build_dataset
from stages.science.discrepancy.decision import Status, decide
from stages.science.discrepancy.ranking import list_named, list_steps, rank_first
from stages.science.discrepancy.restoring import NominalTables, restore_states
from stages.science.discrepancy.search import search
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.figures.verified_gap import draw_candidate_ranking
from stages.science.plant.machine import Machine

RANKING = Table(
    "ranking",
    "A candidate in a round of the search",
    {
        "round": column(int, "of the search", low=1),
        "name": column(
            str,
            "of the effect; none: nothing is missing; static_map, memory: a family without a name; unknown: another",
        ),
        "form": column(str, "its forms, most probable on each muscle; empty where it is no effect"),
        "site": column(str, "where it acts; empty where it is no effect"),
        "probability": column(float, "that it is there, in this round; sums to 1", low=0, high=1),
        "heldout_gap": column(
            float, "RMSE over range, root mean square over channels, trials left out", percent=True, low=0
        ),
        "gap_over_floor": column(float, "gap over noise floor, root mean square over channels", low=0),
        "absorbed_share": column(float, "share of its change that the constants imitate", percent=True, low=0, high=1),
        "absorbed": column(bool, "whether so much that it cannot be named"),
    },
    key=("round", "name"),
    brief=("round", "name", "site", "probability", "heldout_gap"),
    minor=("probability", 0.01),
)
DECISION = Table(
    "decision",
    "What is said of the dataset",
    {
        "status": column(str, "of the verdict", among=list(get_args(Status))),
        "missing": column(float, "probability that something is missing", low=0, high=1),
        "blind": column(bool, "whether so much counts as noise, or is not simulated, that a gap would not be seen"),
    },
)
EFFECT_COLUMNS = {
    "order": column(int, "of addition", low=1),
    "round": column(int, "of the search that added it; 0 where exact values show it", low=0),
    "name": column(str, "of the effect"),
    "form": column(str, "its form"),
    "site": column(str, "where it acts"),
    "channel": column(str, "in which it was seen"),
    "muscle": column(str, "that carries it"),
    "probability": column(float, "when it was added", low=0, high=1),
    "shown": column(bool, "whether exact values of what was measured show it"),
    "p_value": column(float, "of no fall of the gap of trials left out of the fit by it, signs flipped", low=0, high=1),
    "indistinguishable_from": column(str, "names that these data do not exclude, by comma"),
}
NAMED_EFFECTS = Table("named_effects", "An effect that stands, on a muscle", EFFECT_COLUMNS, key=("order", "muscle"))
SUSPECTED_EFFECTS = Table(
    "suspected_effects",
    "An effect that the search added and left-out trials do not confirm, or that is not probable, on a muscle",
    EFFECT_COLUMNS,
    key=("order", "muscle"),
)
UNEXPLAINED = Table(
    "unexplained",
    "What is left in a channel after all that was named",
    {
        "channel": column(str, "measured channel"),
        "share": column(
            float, "share of the initial gap above the floor that a flexible model, or the family, still removes"
        ),
        "probability": column(float, "that it is more than the limit, and matters", low=0, high=1),
        "family": column(str, "without a name that explains it: static_map, memory, or empty"),
        "line_hz": column(float, "frequency of an oscillation in all trials", unit="Hz", low=0, nullable=True),
        "imitated": column(float, "that what was named leaves more than one effect's forms differ by", low=0, high=1),
    },
    key=("channel",),
)
STEPS = Table(
    "steps",
    "A value of the model after a number of additions",
    {
        "step": column(int, "effects added", low=0),
        "channel": column(str, "measured channel"),
        "muscle": column(str, "muscle, or name of the machine"),
        "effect": column(str, "that the value belongs to; empty for a nominal constant"),
        "form": column(str, "its form"),
        "parameter": column(str, "name of the value"),
        "value": column(float, "fitted", unit="as named"),
    },
    key=("step", "channel", "muscle", "effect", "parameter"),
)


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    plant: Machine
    seed: int


@stage(RANKING, DECISION, NAMED_EFFECTS, SUSPECTED_EFFECTS, UNEXPLAINED, STEPS, stream="name_effect")
def name_effect(cfg: Config, tables: DatasetTables, nominal: NominalTables, ctx: Context) -> dict[str, pd.DataFrame]:
    """Name what is missing, add it, and repeat until what is left is noise or has no name."""
    settings = cfg.discrepancy
    dataset = build_dataset(cfg.plant, tables, tables.trial_parts, settings)
    states = restore_states(dataset, nominal)
    found = search(states, settings.search, ctx.generator("trials"), ctx.divide)
    decision = decide(found, settings, ctx.generator("unexplained"))
    left = [
        {"channel": channel, **each._asdict(), "probability": each.unknown, "imitated": each.ambiguous}
        for channel, each in decision.remainders.items()
    ]
    rows: list[list[Any]] = [
        rank_first(found, decision, settings.report.most_confounded),
        [{name: getattr(decision, name) for name in DECISION.columns}],
        list_named(decision.effects, found.rounds),
        list_named(decision.suspected, found.rounds),
        left,
        list_steps(decision.steps),
    ]
    both = zip(name_effect.writes, rows, strict=True)
    written = {table.name: pd.DataFrame(kept, columns=list(table.columns)) for table, kept in both}
    ranking = written[RANKING.name]
    ctx.figure(
        "ranking",
        draw_candidate_ranking(ranking[ranking["round"] == 1]),
        "First round: the probability of the candidates that change something, and the gap with each on trials left "
        "out of its fit.",
    )
    return written
